"""`hexctl run` as a user calls it, and when the robot, the link or the disk fails."""

import json
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from unittest.mock import ANY

import pytest

from hexctl.cli.render.run_output import summary
from hexctl.recording import recording
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.rrd import ROOM_BYTES
from tests.cli.conftest import Call, Output
from tests.cli.kits import Kit
from tests.cli.terminals import FULL_DISK, OnTerminal, run_program, wait_until_it_grows
from tests.vision.test_place import saved

#: A hang must not hang the suite.
PATIENCE_S = 60.0

KITS = "tests.cli.kits"


@pytest.fixture
def walk(call: Call) -> Call:
    """Walk a kit."""

    def walked(kit: str, *more: str, duration_s: int = 3, code: int = 0) -> Output:
        words = ("--backend", f"{KITS}:{kit}", "--duration", str(duration_s), *more)
        return call("run", *words, code=code)

    return walked


@pytest.mark.parametrize(("kit", "reason"), [("Sick", "fault"), ("Lost", "pose lost")])
def test_a_fault_of_the_robot_is_a_result_that_says_why(kit: str, reason: str, walk: Call) -> None:
    printed = walk(kit, "--no-record", duration_s=8, code=3)
    assert f"status     aborted ({reason})" in printed.out
    assert printed.err == ""
    outcome = walk(kit, "--no-record", "--json", duration_s=8, code=3).json
    assert (outcome["status"], outcome["stopped"]) == ("aborted", reason)
    assert 0 < outcome["duration_s"] < 8


@pytest.mark.parametrize(("kit", "word"), [("NoPipe", "Broken pipe"), ("NoPort", "/dev/ttyUSB7")])
def test_a_robot_that_cannot_be_reached_is_one_line_and_leaves_nothing(
    kit: str, word: str, tmp_path: Path, walk: Call
) -> None:
    assert word in walk(kit, code=3).refusal
    assert list(tmp_path.iterdir()) == [], "no recording of a walk that never was"
    assert [made.closed for made in Kit.made] == [1]


@pytest.mark.parametrize("command", ["run", "diagnose"])
def test_ctrl_c_before_the_first_command_commands_nothing_and_leaves_nothing(
    command: str, tmp_path: Path, call: Call
) -> None:
    path = tmp_path / "walk.rrd"
    assert call(command, "--backend", f"{KITS}:Interrupting", "--record", str(path), code=130).refusal
    assert [(made.closed, len(made.sent)) for made in Kit.made] == [(1, 0)]
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("block_ticks", [1, 2000], ids=["in the walk", "at its end"])
def test_a_recording_that_fails_costs_neither_the_walk_nor_its_result(
    block_ticks: int, monkeypatch: pytest.MonkeyPatch, walk: Call
) -> None:
    def fail(_: object) -> Iterator[None]:
        yield
        raise RuntimeError("no space\nleft")

    monkeypatch.setattr(recording, "BLOCK_TICKS", block_ticks)
    monkeypatch.setattr(recording, "send_parts", fail)
    printed = walk("Kit", "--turn", "5", "--json", code=3)
    assert (printed.json["status"], printed.json["duration_s"]) == ("ok", pytest.approx(3))
    assert "no space\\nleft" in printed.line


def test_a_robot_without_a_pose_at_the_start_says_why_it_holds_nothing(call: Call) -> None:
    Path("blind.yaml").write_text("lost_poses: 0.95\n", encoding="utf-8")
    outcome = call("run --no-record --duration 0.2 --world blind.yaml --seed 1 --json").json
    assert (outcome["hold"], outcome["hold_caveat"]) == ("none", ANY)


def test_the_best_gait_is_told_and_walked_and_where_none_is_known_that_is_said(call: Call) -> None:
    words = "run --gait best --duration 1 --no-record --json"
    printed = call(words, "--failed-leg", "2")
    assert printed.json["hold"] == "line"
    assert "ant-locked-none-30s-line.npz" in printed.err
    assert "--gait" in call(words, "--failure", "2:missing", code=2).line


def test_a_self_rotation_without_a_failed_leg_is_said_to_change_nothing(walk: Call) -> None:
    for more, noted in (([], True), (["--failed-leg", "2"], False)):
        printed = walk("Kit", "--no-record", "--self-rotation", "front", *more, duration_s=1)
        assert ("--self-rotation front changes nothing" in printed.err) is noted


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "code", "texts"),
    [
        ("", 0, ("failed     leg 5 locked at 3 s", "detected   leg 5 locked at 3.", "changed to slots")),
        ("--recovery stop", 4, ("stopped", "aborted (leg 5 locked)")),
        ("--recovery walk-on", 0, ("walked on", "next: the same with --recovery glide")),
    ],
)
def test_a_leg_dies_and_the_text_says_what_was_noticed_and_done(
    options: str, code: int, texts: tuple[str, ...], call: Call
) -> None:
    walk = "run --gait tripod --failure 5:locked@3 --duration 5 --no-record"
    out = call(walk, *options.split(), code=code).out
    assert all(text in out for text in texts), out


def test_a_walk_without_a_leg_that_is_slow_or_misses_its_line_names_the_next_step(call: Call) -> None:
    outcome = call("run --no-record --duration 1 --failure 5:locked --json").quiet_json
    assert "--gait auto" in str(summary(outcome)[-1])
    assert "--gait auto" not in str(summary({**outcome, "options": {"gait": "auto"}})[-1])
    on_course = {**outcome, "distance_m": outcome["ideal_distance_m"]}
    assert not any("next: " in str(part) for part in summary(on_course))
    assert "--gait auto" in str(summary({**on_course, "status": "no_progress"})[-1])
    missed = {**on_course, "deviation_m": {**outcome["deviation_m"], "signed": -0.2}}
    assert "hexctl adapt" in str(summary(missed)[-1])


def test_a_fall_is_an_abort(call: Call) -> None:
    Path("top_heavy.yaml").write_text("payload_kg: 6\npayload_position_m: [0.5, 0.0, 0.3]\n")
    words = "run --no-record --duration 3 --world top_heavy.yaml --json"
    assert call(words, code=4).json["status"] == "fell"


@pytest.mark.parametrize("record", [["--record", "walk.rrd"], ["--no-record", "--json"]])
def test_a_link_that_breaks_in_the_walk_is_a_line_after_that_of_the_recording(
    record: list[str], walk: Call
) -> None:
    printed = walk("PortBreaks", *record, code=3)
    assert "status" not in printed.out, "there is no result"
    assert [made.closed for made in Kit.made] == [1]
    assert len(printed.err.splitlines()) == (2 if "--record" in record else 1)
    if "--record" in record:
        assert "recorded until then: walk.rrd; to repeat it, give another --record" in printed.err
        assert len(read_trial("walk.rrd")) > 50


def test_a_link_that_breaks_before_the_first_command_leaves_no_recording(tmp_path: Path, walk: Call) -> None:
    assert walk("BreaksAtOnce", "--record", "walk.rrd", code=3).line
    assert list(tmp_path.iterdir()) == []


@pytest.mark.realtime
def test_ctrl_c_stops_softly_and_keeps_the_recording(tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    command = [sys.executable, "-m", "hexctl", "run", "--realtime", "--duration", "600", "--json"]
    with subprocess.Popen(
        [*command, "--record", str(path)], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as process:
        try:
            wait_until_it_grows(path)
            process.send_signal(signal.SIGTERM)
            printed, complaints = process.communicate(timeout=PATIENCE_S)
        finally:
            process.kill()
    assert (process.returncode, complaints) == (130, "")
    outcome = json.loads(printed)
    assert outcome["status"] == "aborted"
    assert 0 < outcome["duration_s"] < 600
    assert path.stat().st_size > 10_000


@pytest.mark.realtime
def test_a_terminal_shows_progress_and_the_result_at_the_end(tmp_path: Path) -> None:
    arguments = ("--duration", "1")
    with OnTerminal(tmp_path, *arguments, command="run", variables={"TERM": "xterm"}) as shown:
        shown.wait("loading")
        assert shown.code() == 0
        text = shown.wait("next: hexctl view")
    assert text.index("loading") < text.index("1 of 1 s") < text.index("ant in world flat")


@pytest.mark.slow
@pytest.mark.parametrize("room", [True, False], ids=["full in the walk", "full before it"])
def test_a_full_disk_is_said_before_the_walk_or_costs_neither_it_nor_its_result(
    room: bool, tmp_path: Path
) -> None:
    limit = str(ROOM_BYTES - (not room))
    done = run_program(FULL_DISK, limit, "run", "--duration", "20", "--json", RUST_LOG="off")
    assert done.returncode == 3, done.stderr
    printed = Output(done.stdout, done.stderr)
    assert printed.line
    if room:
        assert printed.json["status"] == "ok"
    else:
        assert (printed.out, list(tmp_path.glob("runs/*"))) == ("", [])


OWN_KIT = """
from hexctl.backends.mock import MockServos
class KitServos(MockServos):
    pass
"""


@pytest.mark.slow
def test_servos_in_the_current_folder_are_found_by_the_program_that_is_installed(tmp_path: Path) -> None:
    program = Path(sys.executable).with_name("hexctl")
    if not program.exists():
        pytest.skip("hexctl is not installed next to this Python")
    (tmp_path / "own_kit.py").write_text(OWN_KIT)
    words = ["run", "--backend", "own_kit:KitServos", "--no-record", "--duration", "0.2", "--json"]
    done = subprocess.run([program, *words], capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    outcome = Output(done.stdout, done.stderr).json
    assert (outcome["backend"], outcome["status"]) == ("own_kit:KitServos", "ok")
    assert (outcome["distance_m"], outcome["deviation_m"]["final"]) == (None, None), "it knows no position"


WALK = "run --gait tripod --duration 6 --no-record --json"


@pytest.mark.slow
def test_a_walk_ends_softly_inside_the_circle_around_its_start(call: Call) -> None:
    free = call(WALK).json
    assert (free["status"], free["stopped"]) == ("ok", None)
    radius_m = free["distance_m"] / 2
    kept = call(WALK, "--arena", str(radius_m)).json
    assert (kept["status"], kept["stopped"]) == ("cut_short", "arena")
    assert 0 < kept["distance_m"] < radius_m
    assert call(WALK, "--arena", str(2 * free["distance_m"])).json["status"] == "ok"


def test_the_floor_of_a_simulation_is_none_that_a_camera_sees(tmp_path: Path, call: Call) -> None:
    refusal = call(WALK, "--arena", str(saved(tmp_path)), code=2).refusal
    assert "with --backend sim; allowed: a radius, or another --backend" in refusal
