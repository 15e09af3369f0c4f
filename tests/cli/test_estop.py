"""`hexctl estop`: what it prints, and the stop that is sent before the command line is loaded."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, Self

import pytest

from hexctl.cli.interrupts import NOT_CONFIRMED
from hexctl.cli.network import early_stop, estop_command
from hexctl.cli.network.early_stop import begin_stop, place_of, take_stop
from hexctl.client.stop_client import StopResult
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.wire.links import Link, load_link
from tests.cli.conftest import Call
from tests.server.processes import ROOT, free_port, served, wait_until
from tests.server.test_link_faults import stopped


class StoppedRobot:
    """In place of a robot: it rests, and has kept the stop or not."""

    kept, echoed = True, False

    def __init__(self, *, again: bool, connect: str | None, link: str | None, **given: Any) -> None:
        self.link = load_link(link, connect=connect, **given)

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def wait_for_rest(self, *, identity_s: float = 0.0) -> StopResult:
        """Result of a stop by datagram."""
        return StopResult(
            stopped="estop",
            stop_id="0011223344556677",
            at_rest=True,
            on_disk=self.kept,
            robot="ant",
            ways=("datagram",),
            took_s=0.01,
            rested_s=0.3,
            answers=(),
            echoed=self.echoed,
        )


@pytest.mark.parametrize(("kept", "echoed"), [(True, False), (False, False), (True, True)])
def test_a_stop_says_whether_it_is_kept_and_whether_the_robot_rests(
    monkeypatch: pytest.MonkeyPatch, call: Call, kept: bool, echoed: bool
) -> None:
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "kept", kept)
    monkeypatch.setattr(StoppedRobot, "echoed", echoed)
    printed = call("estop")
    assert printed.out.startswith("stopped (estop), ")
    assert ("at rest" in printed.out + printed.err) is not echoed, "its servos report no angles"
    assert ("a restart of hexctl serve ends it" in printed.err) is not kept


@pytest.mark.parametrize(
    ("error", "words", "code"),
    [
        (RobotFaultError("does it hang?"), "does it hang? ", 3),
        (InputError(f"{argument('credentials')}: is for 'viewer'"), "--keys: is for 'viewer'. ", 2),
        (KeyboardInterrupt(), "interrupted. ", 130),
    ],
)
def test_a_stop_that_failed_ends_with_what_the_operator_has_to_do(
    monkeypatch: pytest.MonkeyPatch, call: Call, error: BaseException, words: str, code: int
) -> None:
    def fail(_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "wait_for_rest", fail)
    assert call("estop", code=code).err == f"hexctl: {words}{NOT_CONFIRMED}\n"


def test_a_ready_stop_that_ctrl_c_ends_says_that_it_has_stopped_nothing(
    monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(estop_command, "_wait_for_a_press", interrupt)
    assert call("estop --ready", code=130).err.endswith(f"{NOT_CONFIRMED}\n")


def test_the_command_that_clears_it_leads_to_the_same_robot(
    monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    command = "hexctl estop --clear --connect tls/ant.local:7448 --keys 'my keys' when"
    assert command in call("estop --connect tls/ant.local:7448 --keys", "my keys").out


def test_a_link_file_that_has_gone_meanwhile_is_no_error_of_a_stop(
    monkeypatch: pytest.MonkeyPatch, call: Call, tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("endpoint: tcp/127.0.0.1:7448\n", encoding="utf-8")
    result = StoppedRobot.wait_for_rest

    def remove(robot: StoppedRobot, **_: object) -> StopResult:
        file.unlink()
        return result(robot)

    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "wait_for_rest", remove)
    assert "hexctl estop --clear --connect tcp/127.0.0.1:7448 when" in call("estop --link", str(file)).out


@pytest.mark.slow
def test_that_nothing_listens_is_said_while_the_robot_is_still_tried(call: Call) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    lines = call("estop --connect", endpoint, code=3).err.splitlines()
    assert len(lines) == 2
    for line in lines:
        assert line.startswith(f"hexctl: nothing listens at {endpoint}; ")
        assert line.endswith(NOT_CONFIRMED)


def test_what_stops_is_what_there_is_now() -> None:
    assert estop_command._what_stops(keys=True, gamepads=0) == "any key stops it"
    assert estop_command._what_stops(keys=True, gamepads=1) == "any key or any button of a gamepad stops it"
    assert estop_command._what_stops(keys=False, gamepads=2) == "any button of a gamepad stops it"
    assert "NOTHING HERE STOPS IT" in estop_command._what_stops(keys=False, gamepads=0)


def test_nothing_is_printed_where_it_would_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    with os.fdopen(read, "rb"), os.fdopen(write, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        assert estop_command._takes_text()
        fcntl.fcntl(write, fcntl.F_SETFL, os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while True:
                os.write(write, bytes(4096))
        assert not estop_command._takes_text()
        os.read(read, 1 << 20)
        assert estop_command._takes_text()


ANT, BEE = "tls/ant.local:7448", "tcp/127.0.0.1:7449"

#: Arguments that are understood early.
UNDERSTOOD: tuple[list[str], ...] = (
    [],
    ["--json"],
    ["--connect", BEE],
    [f"--connect={ANT}", "--insecure"],
    ["--connect", ANT, "--keys", "my keys", "--json"],
    ["--keys", "other"],
)

#: Content of `hexctl.toml`, and variables.
SETTINGS: tuple[tuple[str, dict[str, str]], ...] = (
    ("", {}),
    (f'connect = "{ANT}"\nkeys = "keys"\n', {}),
    (f'connect = "{BEE}"\nkeys = "keys"\n[estop]\nconnect = "{ANT}"\njson = true\n', {}),
    (f'[commands.estop]\nconnect = "{ANT}"\nkeys = "~/keys"\n', {"HEXCTL_CONNECT": BEE}),
    ('keys = "keys"\nlink = "lab.yaml"\n', {"HEXCTL_ESTOP_KEYS": "from here"}),
    ('[estop]\nlink = "lab.yaml"\nkeys = "keys"\n', {}),
)


class FoundPlace(StoppedRobot):
    """In place of a stop: it notes where it would have been sent."""

    found: Link | None = None

    def __enter__(self) -> Self:
        FoundPlace.found = self.link
        raise RobotFaultError("not sent")


@pytest.mark.parametrize("arguments", UNDERSTOOD)
@pytest.mark.parametrize(("file", "variables"), SETTINGS)
def test_it_goes_where_the_command_line_would_send_it(
    call: Call,
    monkeypatch: pytest.MonkeyPatch,
    tmp_path: Path,
    arguments: list[str],
    file: str,
    variables: dict[str, str],
) -> None:
    (tmp_path / "hexctl.toml").write_text(file, encoding="utf-8")
    (tmp_path / "lab.yaml").write_text(f"endpoint: {ANT}\n", encoding="utf-8")
    for name, text in variables.items():
        monkeypatch.setenv(name, text)
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", FoundPlace)
    place = place_of(arguments)
    call("estop", *arguments, code=3)
    if place is None:
        assert "link" in file
    else:
        assert FoundPlace.found == load_link(**place)


@pytest.mark.parametrize(
    "arguments",
    [
        ["--help"],
        ["--clear"],
        ["--ready", "--connect", BEE],
        ["--link", "lab"],
        ["--connect"],
        ["--connect", "--json"],
        ["--connect", BEE, "--connect", ANT],
        ["--conn", BEE],
        ["somewhere"],
        ["--connect="],
        ["connect", BEE],
        ["--json=yes"],
    ],
)
def test_arguments_in_doubt_are_left_to_the_command_line(arguments: list[str]) -> None:
    assert place_of(arguments) is None


def test_the_tab_key_and_wrong_settings_stop_nothing_early(monkeypatch: pytest.MonkeyPatch) -> None:
    assert place_of([]) is not None
    monkeypatch.setenv("_HEXCTL_COMPLETE", "complete_bash")
    assert place_of([]) is None
    monkeypatch.delenv("_HEXCTL_COMPLETE")
    Path("hexctl.toml").write_text("connect = 7\n", encoding="utf-8")
    assert place_of([]) is None


def test_a_stop_is_taken_once_and_by_its_own_place_only(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(early_stop, "CONFIRM_S", 0.0)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    place = {"connect": endpoint, "credentials": None, "insecure": False, "link": None}
    begin_stop(["--connect", endpoint])
    stop = take_stop(place)
    assert stop is not None
    stop.end_datagrams()
    assert take_stop(place) is None
    begin_stop(["--connect", endpoint])
    assert take_stop({**place, "connect": f"tcp/127.0.0.1:{free_port()}"}) is None
    begin_stop(["--connect", "nowhere"])
    assert take_stop(place) is None, "the command says what is wrong"


#: A command whose command line is never loaded.
STUCK = """
import sys, time
class Stuck:
    def find_spec(self, name, path=None, target=None):
        if name == "typer":
            time.sleep(600.0)
sys.meta_path.insert(0, Stuck())
from hexctl.cli.entry import main
main()
"""


@contextmanager
def stuck(*arguments: str) -> Iterator[None]:
    """Run the command as far as the loading of its command line."""
    words = [sys.executable, "-c", STUCK, *arguments]
    process = subprocess.Popen(words, cwd=ROOT, env={**os.environ, "HEXCTL_SETTINGS": "none"})
    try:
        yield
    finally:
        process.kill()
        process.wait()


@pytest.mark.realtime
def test_the_robot_is_stopped_before_the_command_line_is_loaded(tmp_path: Path) -> None:
    with served(tmp_path) as robot, stuck("estop", "--connect", robot.endpoint):
        wait_until(lambda: stopped(robot) == "estop", "the stop")
