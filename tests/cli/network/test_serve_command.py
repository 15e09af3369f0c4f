"""`hexctl serve`, `status` and `estop` as a user meets them: bad input, what they print, how they end."""

import json
import signal
import socket
from contextlib import ExitStack, nullcontext, suppress
from pathlib import Path
from types import SimpleNamespace

import pytest

from hexctl import run
from hexctl.backends.mock import MockServos
from hexctl.cli.main import exit_code
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import Link
from tests.server.processes import RECORDED, free_port, hexctl, program, served

pytestmark = pytest.mark.realtime

REFUSED = [
    (["serve", "--backend", "zenoh"], ["--backend", "zenoh", "sim, mavlink, dynamixel, feetech, lx16a, "]),
    (["serve", "--backend", "warp"], ["backend", "'warp'"]),
    (["serve", "--robot", "bob"], ["robot", "'bob'"]),
    (["serve", "--backend", "mock", "--world", "flat"], ["--world", "mock", "sim"]),
    (["serve", "--backend", "mock", "--failed-leg", "5"], ["--failed-leg", "mock", "sim"]),
    (["serve", "--failed-leg", "9"], ["--failed-leg", "9", "1..6"]),
    (["serve", "--failure", "limp"], ["--failure", "5:limp"]),
    (["serve", "--failure", "5:limp@8"], ["--failure", "5:limp@8", "hexctl sim fail"]),
    (["serve", "--connect", "/dev/null"], ["--connect", "sim", "mavlink"]),
    (["serve", "--backend", "mavlink", "--seed", "5"], ["--seed", "5", "mavlink"]),
    (["serve", "--seed", "-1"], ["--seed", "-1"]),
    (["serve", "--sit-after", "nan"], ["--sit-after", "nan", "1 to 3600"]),
    (["serve", "--sit-after", "0"], ["--sit-after", "0", "1 to 3600"]),
    (["serve", "--ros-drive"], ["--ros-drive", "got it; allowed: with --ros"]),
    (["serve", "--ros-domain", "3"], ["--ros-domain", "3", "allowed: with --ros"]),
    (["serve", "--ros", "--ros-domain", "500"], ["--ros-domain", "500", "0..232"]),
    (["serve", "--ros", "--ros-namespace", "a b"], ["--ros-namespace", "'a b'", "letters"]),
    (["serve", "--ros", "tls/localhost:7447"], ["--ros", "tcp/HOST:PORT"]),
    (["serve", "--ros", "tcp/10.0.0.5:7447"], ["--ros", "beyond this computer", "--insecure"]),
    (["serve", "--ros", "--listen", "tcp/127.0.0.1:7447"], ["--listen", "7447", "7448"]),
    (["status", "--watch", "--json"], ["--watch", "--json"]),
    (["run", "--backend", "zenoh", "--seed", "3"], ["--seed", "zenoh", "sim"]),
    (["run", "--backend", "zenoh", "--realtime"], ["--realtime", "zenoh", "sim"]),
    (["run", "--connect", "tcp/127.0.0.1:1"], ["--connect", "sim", "zenoh"]),
]


@pytest.mark.parametrize(("arguments", "words"), REFUSED, ids=lambda value: " ".join(value)[:40])
def test_refused_in_one_line(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    for word in words:
        assert word in printed.err


def test_a_view_without_a_viewers_certificate_is_refused_before_anything_is_served(tmp_path: Path) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    options = (
        "--view",
        "--listen",
        f"tls/127.0.0.1:{free_port()}",
        "--keys",
        str(tmp_path / "keys" / "robot"),
    )
    answer = hexctl("serve", "--backend", "mock", *options)
    assert answer.returncode == 2
    assert "allowed here: viewer or controller" in answer.stderr
    assert len(answer.stderr.splitlines()) == 1


def test_an_address_that_is_taken_is_said_in_one_line() -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        answer = hexctl("serve", "--backend", "mock", "--listen", endpoint)
    assert answer.returncode == 3
    assert len(answer.stderr.splitlines()) == 1
    assert endpoint in answer.stderr


def test_without_options_it_would_serve_at_the_usual_port() -> None:
    with ExitStack() as stack:
        with suppress(OSError):  # another program has it already
            stack.enter_context(socket.create_server(("127.0.0.1", 7447)))
        answer = hexctl("serve")
    assert answer.returncode == 3
    assert "cannot listen at tcp/127.0.0.1:7447: already in use" in answer.stderr


@pytest.mark.parametrize("method", ["connect", "read"])
def test_own_servos_that_raise_end_it_as_a_fault_in_one_line(
    method: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("no such register")

    class Driver(MockServos):
        pass

    setattr(Driver, method, broken)
    monkeypatch.setattr("tests.server.recorded.RecordedServos", Driver)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert exit_code(["serve", "--backend", RECORDED, "--listen", endpoint]) == 3
    (*_, line) = capsys.readouterr().err.splitlines()
    assert line == f"hexctl: the servos failed: Driver.{method} raised ZeroDivisionError: no such register"


def test_servos_of_a_robot_file_that_are_only_simulated_are_mentioned(tmp_path: Path) -> None:
    listen = f"tcp/127.0.0.1:{free_port()}"
    with program(tmp_path, "robot", "hexctl", "serve", "--robot", "lukas", "--listen", listen) as robot:
        robot.wait_for("simulated; its servos are served with --backend feetech")
    with served(tmp_path, "--robot", "lukas", backend="sim") as asked:
        assert "its servos are served with" not in asked.said()


def test_a_walk_that_is_stopped_before_it_begins_leaves_the_robot_as_it_is(tmp_path: Path) -> None:
    with served(tmp_path) as robot:
        done = run(backend="zenoh", connect=robot.endpoint, stop_requested=lambda: True)
        assert (done.trial.stopped, len(done.log)) == ("requested", 0)
        status = robot.status()
        assert (status["posture"], status["commands"]["accepted"]) == ("idle", 0)
        assert not len(robot.log().joint_positions_rad)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGUSR1, signal.SIGIO])
def test_it_ends_softly_when_asked(tmp_path: Path, number: signal.Signals) -> None:
    with served(tmp_path, backend="mock") as robot:
        assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
        robot.wait_for("STOPPED: estop")
        robot.signal(number)
        assert robot.wait() == 0
        assert "Traceback" not in robot.said()


@pytest.mark.parametrize("json_option", [(), ("--json",)])
def test_a_stop_whose_fault_is_still_there_is_not_cleared(
    json_option: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = {"stopped": "fault: no power", "robot": "ant", "backend": "mock"}
    robots = SimpleNamespace(clear=lambda **_: [answer], link=Link())
    monkeypatch.setattr("hexctl.client.remote.remote_robots", lambda *_, **__: nullcontext(robots))
    assert exit_code(["estop", "--clear", *json_option]) == 3
    printed = capsys.readouterr().out
    assert "fault: no power" in printed
    assert ("not cleared, it is still stopped" in printed) is not bool(json_option)


@pytest.mark.parametrize(
    ("cleared", "said"), [(None, "no stop was in force"), ({"id": "ab", "since_s": 2.0}, "cleared; ")]
)
def test_a_clear_says_whether_there_was_a_stop(
    cleared: object, said: str, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    answer = {"stopped": None, "cleared": cleared, "robot": "ant", "backend": "mock"}
    robots = SimpleNamespace(clear=lambda **_: [answer], link=Link())
    monkeypatch.setattr("hexctl.client.remote.remote_robots", lambda *_, **__: nullcontext(robots))
    assert exit_code(["estop", "--clear"]) == 0
    assert capsys.readouterr().out.startswith(said)


def test_what_status_says_is_one_json_object_or_a_table(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot:
        said = json.loads(hexctl("status", "--json", "--connect", robot.endpoint).stdout)
        assert said["robot"] == "ant"
        assert said["stopped"] is None
        assert said["insecure"] is False
        table = hexctl("status", "--connect", robot.endpoint).stdout
        assert "ant" in table
        assert "0 executed" in table


def test_watching_ends_with_an_interrupt(tmp_path: Path) -> None:
    with (
        served(tmp_path, backend="mock") as robot,
        program(tmp_path, "watch", "hexctl", "status", "--watch", "--connect", robot.endpoint) as watch,
    ):
        watch.wait_for("posture")
        watch.signal(signal.SIGINT)
        assert watch.wait() == 0


def test_a_walk_over_the_link_says_what_a_walk_in_process_says(tmp_path: Path) -> None:
    options = ("--gait", "tripod", "--duration", "2", "--json", "--no-record")
    with served(tmp_path, backend="sim") as robot:
        far = hexctl("run", "--backend", "zenoh", "--connect", robot.endpoint, *options)
        assert far.returncode == 0, far.stderr
    there, here = json.loads(far.stdout), json.loads(hexctl("run", *options).stdout)
    assert there.keys() == here.keys()
    assert there["status"] == here["status"] == "ok"
    assert there["distance_m"] == pytest.approx(here["distance_m"], abs=0.02)
    # Grid points that a busy machine skipped are counted, not lost.
    assert there["ticks"] + there["overruns"] == pytest.approx(here["ticks"], abs=3)


def test_with_certificates_controllers_command_and_viewers_look(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    assert hexctl("keys", "new", str(keys)).returncode == 0
    endpoint = f"tls/127.0.0.1:{free_port()}"
    serve = ("serve", "--backend", "mock", "--listen", endpoint, "--keys", str(keys))
    with program(tmp_path, "robot", "hexctl", *serve) as robot:
        robot.wait_for("certificates")
        here = ("--connect", endpoint, "--keys")
        walk = ("run", "--backend", "zenoh", "--no-record", "--duration", "0.5", "--json")
        assert hexctl(*walk, *here, str(keys)).returncode == 0
        status = hexctl("status", "--json", *here, str(keys / "viewer"))
        assert json.loads(status.stdout)["secured"] is True
        for command in (walk, ("estop",)):
            refused = hexctl(*command, *here, str(keys / "viewer"))
            assert refused.returncode == 2
            assert "is for 'viewer'; allowed here: controller" in refused.stderr
        assert hexctl("estop", *here, str(keys / "controller")).returncode == 0
        stranger = hexctl("status", "--connect", endpoint.replace("tls", "tcp"))
        assert stranger.returncode == 3
        assert "--keys" in stranger.stderr
