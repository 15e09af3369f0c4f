"""`hexctl run` as a user calls it, and when the robot, the link or the disk fails."""

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any

import pytest

from hexctl.backends import mock
from hexctl.cli.main import exit_code
from hexctl.recording import recording
from hexctl.recording.rrd import ROOM_BYTES
from tests.adapt.walking import stored_session
from tests.backends.fake_time import FakeTime
from tests.cli.kits import Kit
from tests.cli.terminals import OnTerminal

SHORT = ["run", "--no-record", "--duration", "3"]

#: The contract of `run --json` (design: the command line).
JSON_KEYS = {
    "gait",
    "failed_leg",
    "failure",
    "duration_s",
    "distance_m",
    "deviation_m",
    "yaw_change_deg",
    "ideal_yaw_change_deg",
    "self_rotation_deg",
    "status",
    "stopped",
    "ticks",
    "overruns",
    "clipped_ticks",
    "tick_us",
    "realtime_factor",
    "recording",
}

#: A second is enough for the slowest machine to get on; a hang must not hang the suite.
PATIENCE_S = 60.0


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0) -> dict[str, Any]:
    assert exit_code([*arguments, "--json"]) == code
    printed = capsys.readouterr()
    assert printed.err == ""
    assert len(printed.out.splitlines()) == 1
    outcome: dict[str, Any] = json.loads(printed.out, parse_constant=lambda name: pytest.fail(name))
    return outcome


def test_json_keeps_the_contract(capsys: pytest.CaptureFixture[str]) -> None:
    outcome = run_json(capsys, *SHORT, "--gait", "57", "--failure", "2:weak:0.5")
    assert set(outcome) >= JSON_KEYS
    assert outcome["gait"]["slots"] == [4, 2, 3, 5, 1, 6]
    assert outcome["gait"]["code"] == 57
    assert (outcome["failed_leg"], outcome["failure"]) == (2, "weak:0.5")
    assert set(outcome["deviation_m"]) == {"final", "mean", "max", "signed"}
    assert set(outcome["tick_us"]) == {"p50", "p99", "max"}
    assert outcome["duration_s"] == pytest.approx(3.0)
    assert outcome["status"] == "ok"


@pytest.mark.slow
def test_the_same_seed_gives_the_same_walk(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = [*SHORT, "--world", "rough", "--seed", "7"]
    first, again = run_json(capsys, *arguments), run_json(capsys, *arguments)
    other = run_json(capsys, *SHORT, "--world", "rough", "--seed", "8")
    for key in ("distance_m", "deviation_m", "yaw_change_deg", "clipped_ticks", "ticks"):
        assert first[key] == again[key]
    assert first["deviation_m"] != other["deviation_m"]


@pytest.mark.slow
def test_runs_that_begin_together_all_have_a_recording(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hexctl", "run", "--duration", "0.5", "--json"]
    environment = {**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])}
    walks = [
        subprocess.Popen(
            command, cwd=tmp_path, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
        )
        for _ in range(3)
    ]
    printed = [walk.communicate(timeout=120) for walk in walks]
    assert [walk.returncode for walk in walks] == [0, 0, 0], printed
    assert len({json.loads(out)["recording"] for out, _ in printed}) == 3


def test_an_arc_is_not_measured_by_the_straight_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code([*SHORT, "--turn", "20", "--heading", "0", "--amplitude", "0.08"]) == 0
    printed = capsys.readouterr().out
    assert "in an arc" in printed
    assert "% of ideal (60.0)" in printed
    assert "soft start" not in printed


def test_heading_is_where_the_body_goes(capsys: pytest.CaptureFixture[str]) -> None:
    outcome = run_json(capsys, *SHORT, "--gait", "tripod", "--heading", "137")
    assert outcome["distance_m"] > 0.9 * 2 * 0.1485
    assert outcome["deviation_m"]["final"] < 0.02


@pytest.mark.slow
def test_turn_alone_turns_in_place_and_with_heading_is_blended(capsys: pytest.CaptureFixture[str]) -> None:
    in_place = run_json(capsys, *SHORT, "--turn", "-20")
    assert in_place["yaw_change_deg"] < -0.6 * 20 * 2
    assert in_place["ideal_yaw_change_deg"] == pytest.approx(-20 * 3)
    assert abs(in_place["distance_m"]) < 0.05
    blended = run_json(capsys, *SHORT, "--turn", "10", "--heading", "0", "--amplitude", "0.08")
    assert blended["yaw_change_deg"] > 0.6 * 10 * 2
    assert blended["distance_m"] > 0.1


def test_a_world_file_may_set_one_key(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = tmp_path / "ice.yaml"
    world.write_text("friction: 0.02\n")
    on_ice = run_json(capsys, *SHORT, "--world", str(world))
    flat = run_json(capsys, *SHORT)
    assert on_ice["distance_m"] < 0.9 * flat["distance_m"]


def test_the_summary_says_how_it_went_and_how_to_look(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code(["run", "--duration", "2", "--failed-leg", "4"]) == 0
    printed = capsys.readouterr().out
    (recording,) = (tmp_path / "runs").iterdir()
    for word in ("slots 1,4,1,4,1,4", "off line", "status     ok", f"hexctl view runs/{recording.name}"):
        assert word in printed
    assert recording.stat().st_size > 10_000


def test_a_terminal_shows_progress_before_the_robot_is_loaded_and_the_result_at_the_end(
    tmp_path: Path,
) -> None:
    shown = OnTerminal(["--duration", "1"], tmp_path, command="run", variables={"TERM": "xterm"})
    try:
        shown.wait("loading")
        assert shown.code() == 0
        text = shown.wait("next: hexctl view")
    finally:
        shown.end()
    assert text.index("loading") < text.index("1 of 1 s") < text.index("ant in world flat")


def test_two_runs_at_once_leave_two_recordings(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    for _ in range(2):
        assert exit_code(["run", "--duration", "1"]) == 0
    assert len(list((tmp_path / "runs").iterdir())) == 2


@pytest.fixture
def _no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    """Give the mock robot a clock that does not wait."""
    monkeypatch.setattr(mock, "WallClock", lambda: FakeTime().clock())


@pytest.mark.usefixtures("_no_waiting")
def test_the_mock_knows_no_position(capsys: pytest.CaptureFixture[str]) -> None:
    outcome = run_json(capsys, "run", "--backend", "mock", "--no-record", "--duration", "0.1")
    assert outcome["status"] == "ok"
    assert outcome["distance_m"] is None
    assert outcome["deviation_m"]["final"] is None


@pytest.mark.usefixtures("_no_waiting")
def test_servos_of_your_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "kit.py").write_text(
        "from hexctl.backends.mock import MockServos\nclass KitServos(MockServos):\n    '''A kit.'''\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    outcome = run_json(capsys, "run", "--backend", "kit:KitServos", "--no-record", "--duration", "0.1")
    assert outcome["backend"] == "kit:KitServos"
    assert outcome["status"] == "ok"


def test_a_fall_is_an_abort(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    world = tmp_path / "top_heavy.yaml"
    world.write_text("payload_kg: 6\npayload_position_m: [0.5, 0.0, 0.3]\n")
    outcome = run_json(capsys, *SHORT, "--world", str(world), code=4)
    assert outcome["status"] == "fell"


@pytest.mark.realtime
def test_ctrl_c_stops_softly_and_keeps_the_recording(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hexctl", "run", "--realtime", "--duration", "600", "--json"]
    numbers = (signal.SIGINT, signal.SIGTERM)
    paths = [tmp_path / f"{number.name}.rrd" for number in numbers]
    with ExitStack() as running:
        processes = [
            subprocess.Popen(
                [*command, "--record", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
            )
            for path in paths
        ]
        for process in processes:
            running.callback(process.wait)
            running.callback(process.kill)
        for number, path, process in zip(numbers, paths, processes, strict=True):
            _wait_until_it_walks(path, process)
            os.kill(process.pid, number)
        ends = [process.communicate(timeout=PATIENCE_S) for process in processes]
    for path, process, (printed, complaints) in zip(paths, processes, ends, strict=True):
        assert process.returncode == 130
        assert complaints == ""
        outcome = json.loads(printed)
        assert outcome["status"] == "aborted"
        assert 0 < outcome["duration_s"] < 600
        assert path.stat().st_size > 10_000


def _wait_until_it_walks(path: Path, process: "subprocess.Popen[str]") -> None:
    """Wait until some of the walk, which begins after a second in the stance, is in the recording."""
    sizes: set[int] = set()
    deadline_s = time.monotonic() + PATIENCE_S
    while len(sizes) < 5:
        assert time.monotonic() < deadline_s
        assert process.poll() is None
        size = -1
        with suppress(FileNotFoundError):  # it is tried first whether the file can be written
            size = path.stat().st_size
        if size >= 0 and size not in sizes:
            sizes.add(size)
            # The scene is written in several pieces at once; the walk follows one block a second.
            time.sleep(0.5)
        time.sleep(0.02)


KITS = "tests.cli.kits"


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Kit, "made", [])


def _run(kit: str, *more: str, duration_s: int = 3) -> int:
    return exit_code(["run", "--backend", f"{KITS}:{kit}", "--duration", str(duration_s), *more])


def _one_line(captured: str) -> str:
    (line,) = captured.splitlines()
    return line


def _strict(text: str) -> dict[str, Any]:
    """The one JSON object of a text, which knows no NaN."""
    outcome: dict[str, Any] = json.loads(_one_line(text), parse_constant=lambda name: pytest.fail(name))
    return outcome


@pytest.mark.parametrize(("kit", "reason"), [("Sick", "fault"), ("Lost", "pose lost")])
def test_a_fault_of_the_robot_is_a_result_that_says_why(
    kit: str, reason: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(kit, "--no-record", duration_s=8) == 3
    printed = capsys.readouterr()
    assert f"status     aborted ({reason})" in printed.out
    assert printed.err == ""
    assert _run(kit, "--no-record", "--json", duration_s=8) == 3
    outcome = _strict(capsys.readouterr().out)
    assert (outcome["status"], outcome["stopped"]) == ("aborted", reason)
    assert 0 < outcome["duration_s"] < 8


@pytest.mark.parametrize("kit", ["PipeBreaks", "PortBreaks"])
@pytest.mark.parametrize("more", [[], ["--no-record"], ["--json"]], ids=["recorded", "not recorded", "json"])
def test_a_link_that_breaks_in_the_walk_is_one_line(
    kit: str, more: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(kit, *more) == 3
    printed = capsys.readouterr()
    assert "status" not in printed.out, "there is no result"
    assert "the link to the robot failed" in _one_line(printed.err)
    assert [made.closed for made in Kit.made] == [1]
    if "--no-record" not in more:
        (path,) = (tmp_path / "runs").iterdir()
        assert path.stat().st_size > 10_000, "what was walked is kept"


@pytest.mark.parametrize(("kit", "word"), [("NoPipe", "Broken pipe"), ("NoPort", "/dev/ttyUSB7")])
def test_a_robot_that_cannot_be_reached_is_one_line_and_leaves_nothing(
    kit: str, word: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert _run(kit) == 3
    printed = capsys.readouterr()
    assert printed.out == ""
    line = _one_line(printed.err)
    assert "the robot cannot be reached" in line
    assert word in line
    assert list(tmp_path.iterdir()) == [], "no recording of a walk that never was"
    assert [made.closed for made in Kit.made] == [1]


@pytest.mark.realtime
@pytest.mark.parametrize("command", ["run", "diagnose"])
def test_ctrl_c_before_the_first_command_commands_nothing_and_leaves_nothing(
    command: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "walk.rrd"
    assert exit_code([command, "--backend", f"{KITS}:Interrupting", "--record", str(path)]) == 130
    printed = capsys.readouterr()
    assert printed.out == ""
    assert _one_line(printed.err) == "hexctl: interrupted before the robot was commanded"
    assert [(made.closed, len(made.sent)) for made in Kit.made] == [(1, 0)]
    assert list(tmp_path.iterdir()) == []


def test_a_robot_that_turns_before_it_walks_says_so_first(capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("Kit", "--no-record", "--failed-leg", "5", "--self-rotation", "rear", "--json") == 0
    line = _one_line(capsys.readouterr().err)
    assert line == "hexctl: turns until leg 5 trails, then walks 3 s; Ctrl-C stops it"


def test_a_kit_in_good_health_walks(capsys: pytest.CaptureFixture[str]) -> None:
    assert _run("Kit", "--no-record", "--gait", "tripod", "--turn", "5", "--json") == 0
    assert _strict(capsys.readouterr().out)["stopped"] is None
    assert [made.closed for made in Kit.made] == [1]


def test_a_file_where_the_recordings_go_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "runs").write_text("mine")
    assert _run("Kit") == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    line = _one_line(printed.err)
    for word in ("runs is a file, not a folder", "--record FILE", "--no-record"):
        assert word in line
    assert (tmp_path / "runs").read_text() == "mine"
    assert all(not made.sent for made in Kit.made), "nothing moved"


@pytest.mark.parametrize("block_ticks", [1, 2000], ids=["in the walk", "at its end"])
def test_a_recording_that_fails_costs_neither_the_walk_nor_its_result(
    block_ticks: int, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def fail(_: object) -> Iterator[None]:
        yield
        raise RuntimeError("no space\nleft")

    monkeypatch.setattr(recording, "BLOCK_TICKS", block_ticks)
    monkeypatch.setattr(recording, "send_parts", fail)
    assert _run("Kit", "--turn", "5", "--json") == 3
    printed = capsys.readouterr()
    outcome = _strict(printed.out)
    assert (outcome["status"], outcome["duration_s"]) == ("ok", pytest.approx(3))
    assert "the walk is done, its recording is not whole: no space\\nleft" in _one_line(printed.err)


FULL_DISK = """
import resource, signal, sys
from hexctl.cli.main import exit_code
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[1]), int(sys.argv[1])))
sys.exit(exit_code(["run", "--duration", "20", "--json"]))
"""


@pytest.mark.slow
def test_a_disk_without_room_is_said_before_the_walk(tmp_path: Path) -> None:
    done = _run_on_a_small_disk(tmp_path, ROOM_BYTES - 1)
    assert done.returncode == 3, done.stderr
    assert done.stdout == ""
    assert "cannot be written (File too large)" in _one_line(done.stderr)
    assert not list(tmp_path.glob("runs/*"))


def _run_on_a_small_disk(folder: Path, size_bytes: int) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(size_bytes)],
        cwd=folder,
        env={**os.environ, "RUST_LOG": "off"},
        capture_output=True,
        text=True,
        timeout=120,
        check=False,
    )


@pytest.mark.slow
def test_a_full_disk_costs_neither_the_walk_nor_its_result(tmp_path: Path) -> None:
    done = _run_on_a_small_disk(tmp_path, ROOM_BYTES)
    assert done.returncode == 3, done.stderr
    assert _strict(done.stdout)["status"] == "ok"
    line = _one_line(done.stderr)
    assert "its recording is not whole" in line
    assert ".rrd" in line


CURRENT_FOLDER_KIT = """
from hexctl.backends.clock import WallClock
from hexctl.backends.mock import MockServos


class KitTime:
    now_s = 0.0

    def now(self):
        return self.now_s

    def sleep(self, duration_s):
        self.now_s += max(duration_s, 1e-9)


class KitServos(MockServos):
    def __init__(self, robot):
        super().__init__(robot, clock=WallClock(time=KitTime()))
"""


@pytest.mark.parametrize(
    "program",
    [[str(Path(sys.executable).with_name("hexctl"))], [sys.executable, "-m", "hexctl"]],
    ids=["installed", "module"],
)
def test_servos_in_the_current_folder_are_found(program: list[str], tmp_path: Path) -> None:
    if not Path(program[0]).exists():
        pytest.skip("hexctl is not installed beside this Python")
    (tmp_path / "kit_of_this_folder.py").write_text(CURRENT_FOLDER_KIT)
    arguments = [
        "run",
        "--backend",
        "kit_of_this_folder:KitServos",
        "--no-record",
        "--duration",
        "1",
        "--json",
    ]
    done = subprocess.run(
        [*program, *arguments], cwd=tmp_path, capture_output=True, text=True, timeout=120, check=False
    )
    assert done.returncode == 0, done.stderr
    assert _strict(done.stdout)["backend"] == "kit_of_this_folder:KitServos"


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (["--then", "wave"], ["--then", "'wave'", "wave@10"]),
        (["--then", "wave@soon"], ["--then", "wave@soon", "wave@10"]),
        (["--then", "lope@0.3"], ["--then", "'lope@0.3'", "tripod", "auto"]),
        (["--gait", "lope"], ["gait", "'lope'", "tripod", "auto"]),
        (["--then", "lope@0.3"], ["best (with a failed leg)"]),
        (["--then", "best@0.3"], ["--then", "'best@0.3'", "allowed: with a failed leg"]),
        (["--gait", "lope"], ["best (with a failed leg)"]),
        (["--then", "wave@0.9", "--then", "demo@0.5"], ["--then", "wave@0.9", "demo@0.5", "ascend"]),
        (["--then", "wave@0.5", "--then", "demo@.5"], ["--then", "wave@0.5", "demo@.5", "ascend"]),
        (["--then", "wave@5"], ["--then", "wave@5", "before 1 s"]),
        (["--tuck", "7"], ["--tuck", "7", "1..6"]),
        (["--tuck", "five"], ["--tuck", "'five'"]),
        (["--tuck", "1,2,3,4"], ["--tuck: got 1,2,3,4", "(5, 6)", "-177 mm", "above 0", "--stance-shift"]),
        (["--tuck", "1,2,3,4,5"], ["--tuck: got 1,2,3,4,5", "(6)", "no static margin"]),
        (["--stance-shift", "1"], ["--stance-shift", "'1'", "0.02,-0.01"]),
        (["--stance-shift", "0.9,0"], ["--stance-shift", "0.9", "0.2"]),
        (["--body-raise", "0.5"], ["--body-raise", "0.5", "0.2"]),
        (["--swing-share", "0.7"], ["--swing-share", "0.7", "0.5"]),
        (["--trim", "2"], ["--trim", "hold auto", "hold heading"]),
        (["--trim", "50", "--hold", "heading"], ["--trim", "50", "45"]),
    ],
)
def test_a_posture_or_a_change_that_cannot_be_is_one_line(
    given: list[str], said: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["run", "--no-record", "--duration", "1", *given]) == 2
    line = _one_line(capsys.readouterr().err)
    for part in said:
        assert part in line


def test_a_walk_changes_its_gait_in_stride_and_stands_up_off_a_dead_leg(
    capsys: pytest.CaptureFixture[str],
) -> None:
    options = ["--failed-leg", "1", "--self-rotation", "none", "--gait", "auto", "--then", "wave@3"]
    assert exit_code(["run", "--no-record", "--duration", "6", "--json", *options]) == 0
    outcome = _strict(capsys.readouterr().out)
    assert (outcome["status"], outcome["hold"], outcome["gait"]["name"]) == ("ok", "line", "auto")
    assert outcome["gait"]["posture"] == {"body_raise": 0.012, "shift": [0.0, 0.0], "tucked_legs": []}
    assert outcome["gait"]["then"] == ["wave@3"]
    options = [*options[:-2], "--body-raise", "0"]
    assert exit_code(["run", "--no-record", "--duration", "1", "--json", *options]) == 0
    outcome = _strict(capsys.readouterr().out)
    assert outcome["gait"]["posture"]["body_raise"] == 0, "as asked for"


@pytest.mark.slow
def test_the_summary_says_what_was_held(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["run", "--no-record", "--duration", "3"]) == 0
    assert "held       the line, by position and yaw" in capsys.readouterr().out
    assert exit_code(["run", "--no-record", "--duration", "1", "--hold", "none"]) == 0
    assert "held       nothing\n" in capsys.readouterr().out
    assert exit_code(["run", "--no-record", "--duration", "1", "--turn", "10"]) == 0
    assert "held       nothing: a turn and an arc have no line\n" in capsys.readouterr().out


def test_a_robot_without_a_pose_at_the_start_says_why_it_holds_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    world = tmp_path / "blind.yaml"
    world.write_text("lost_poses: 0.95\n", encoding="utf-8")
    options = ["run", "--no-record", "--duration", "1", "--world", str(world), "--seed", "1"]
    why = "neither position nor yaw was measured at rest before the walk"
    assert exit_code(options) == 0
    assert f"held       nothing: {why}\n" in capsys.readouterr().out
    assert exit_code([*options, "--json"]) == 0
    outcome = _strict(capsys.readouterr().out)
    assert (outcome["hold"], outcome["hold_caveat"]) == ("none", why)


def test_the_best_gait_is_told_and_walked_and_where_none_is_known_that_is_said(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    words = ["run", "--gait", "best", "--failed-leg", "2", "--duration", "1", "--no-record", "--json"]
    assert exit_code(words) == 0
    printed = capsys.readouterr()
    assert json.loads(printed.out)["hold"] == "line"
    assert printed.err.startswith("hexctl: gait ")
    assert "the best by the prior ant-locked-none-30s-line.npz" in printed.err
    assert exit_code([*words, "--failure", "2:missing"]) == 2
    assert "--gait: got best, and there is no prior for such walks" in (err := capsys.readouterr().err)
    assert "allowed: auto" in err
    assert len(err.splitlines()) == 1


def test_the_best_gait_of_a_session_is_that_of_its_baseline_where_no_trial_is_better(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    session = stored_session(tmp_path / "runs", 0.03, tripod=0.01)
    words = ["run", "--failed-leg", "2", "--duration", "1", "--no-record", "--json"]
    assert exit_code([*words, "--gait", f"best:{session}"]) == 0
    printed = capsys.readouterr()
    assert (session in printed.err, json.loads(printed.out)["gait"]["name"]) == (True, "tripod")
    assert exit_code([*words, "--gait", "wave", "--then", f"best:{session}@0.5"]) == 0
    line = _one_line(capsys.readouterr().err)
    assert "0.5 s" in line
    assert "tripod" in line


def test_a_self_rotation_without_a_failed_leg_is_said_to_change_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert exit_code([*SHORT[:-1], "0.5", "--self-rotation", "front"]) == 0
    line = _one_line(capsys.readouterr().err)
    assert "--self-rotation front changes nothing" in line
    for quiet in (["--self-rotation", "none"], ["--self-rotation", "front", "--failed-leg", "2"]):
        assert exit_code([*SHORT[:-1], "0.5", *quiet]) == 0
        assert capsys.readouterr().err == ""


def test_the_summary_names_a_posture_that_is_not_the_usual_one(capsys: pytest.CaptureFixture[str]) -> None:
    posture = ["--body-raise", "0.01", "--stance-shift", "0,0.02", "--tuck", "2,5", "--swing-share", "0.25"]
    assert exit_code([*SHORT[:-1], "0.5", *posture]) == 0
    (row,) = [line for line in capsys.readouterr().out.splitlines() if line.startswith("posture")]
    assert row == (
        "posture    body 1 % of its size higher; over its feet +0 % of its size forward, "
        "+2 % of its size to the left; tucked legs: 2, 5; feet "
        "in the air for 25 % of a cycle"
    )
    assert exit_code([*SHORT[:-1], "0.5"]) == 0
    assert "posture" not in capsys.readouterr().out


@pytest.mark.slow
def test_a_leg_dies_and_the_text_says_what_was_noticed_and_done(capsys: pytest.CaptureFixture[str]) -> None:
    walk = ["run", "--gait", "tripod", "--failure", "5:locked@3", "--duration", "5", "--no-record"]
    assert exit_code(walk) == 0
    said = capsys.readouterr().out
    assert "failed     leg 5 locked at 3 s" in said
    assert "detected   leg 5 locked at 3." in said
    assert "changed to slots" in said
    assert exit_code([*walk, "--policy", "stop"]) == 4
    said = capsys.readouterr().out
    assert "stopped" in said
    assert "aborted (leg 5 locked)" in said
    assert exit_code([*walk, "--policy", "walk-on"]) == 0
    assert "walked on" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--failure", "locked@3"), "--failure: got 'locked@3'; allowed: LEG:KIND such as 5:limp"),
        (("--failure", "5:asleep@3"), "locked, limp"),
        (("--failure", "5:stuck:femur:10@3"), "it jams where it is"),
        (("--failure", "5:locked@31"), "before 30 s"),
        (("--failure", "9:limp@3"), "--failure: got '9:limp@3'; allowed: a leg, 1..6"),
        (("--failure", "9limp"), "--failure: got '9limp'; allowed: LEG"),
        (("--heal", "9@3"), "--heal: got '9@3'; allowed: LEG@SECONDS"),
        (("--heal", "5"), "LEG@SECONDS"),
        (("--failure", "5:locked@3", "--backend", "mock"), "--failure: got 5:locked@3 with --backend mock"),
        (("--heal", "5@8", "--backend", "zenoh"), "--heal: got 5@8 with --backend zenoh"),
        (("--heal", "5@31"), "--heal: got 5@31; allowed: before 30 s"),
        (
            ("--heal", "5@5"),
            "--heal: got 5@5, when leg 5 is whole; allowed: after it failed, such as --failure",
        ),
        (("--policy", "hope"), "walk-on, stop, glide"),
        (("--policy", ""), "--policy: got ''; allowed: walk-on, stop, glide"),
        (("--policy", "stop", "--recover"), "one or the other"),
    ],
)
def test_a_failure_or_policy_that_cannot_be_is_one_line(
    arguments: tuple[str, ...], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["run", "--no-record", *arguments]) == 2
    assert message in _one_line(capsys.readouterr().err)


def test_a_walk_that_came_nowhere_without_a_leg_proposes_the_stable_gait(
    capsys: pytest.CaptureFixture[str],
) -> None:
    asked = ["--failure", "2:limp,5:locked", "--duration", "4", "--no-record"]
    assert exit_code(["run", *asked]) == 0
    assert "next: the same with --gait auto" in capsys.readouterr().out
    assert exit_code(["run", *asked, "--gait", "auto"]) == 0
    assert "--gait auto" not in capsys.readouterr().out
