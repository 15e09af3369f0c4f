"""The demo, and `hexctl demo` and `diagnose` as a user calls them."""

import json
import threading
from functools import partial
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.cli.console import StopOnInterrupt
from hexctl.cli.prompts import LegPrompt
from hexctl.demo import rescue
from hexctl.errors import InputError
from hexctl.recording.recorded_trial import LEG_CONDITIONS, read_trial
from hexctl.runs.run import RunResult, run
from tests.cli.conftest import Call
from tests.cli.terminals import type_in


@pytest.fixture(autouse=True)
def _without_a_screen(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


@pytest.mark.slow
def test_ctrl_c_ends_it(call: Call, monkeypatch: Any) -> None:
    monkeypatch.setattr(StopOnInterrupt, "requested", lambda _: True)
    printed = call("demo", code=130)
    assert "with recovery" not in printed.out
    assert not list(Path("runs").iterdir())


ECHO = "tests.runs.test_run:Echo"


@pytest.mark.slow
def test_the_table_says_which_leg_and_why_and_a_recording_is_left(tmp_path: Path, call: Call) -> None:
    printed = call("diagnose --failure 5:limp:femur").out
    (line,) = [line for line in printed.splitlines() if line.startswith("5 ")]
    assert "limp:femur" in line
    (recording,) = (tmp_path / "runs").glob("*.rrd")
    assert "diagnosis" in recording.name
    assert str(recording.relative_to(tmp_path)) in printed


def test_servos_that_echo_and_no_terminal_are_one_line(call: Call) -> None:
    printed = call("diagnose --backend", ECHO, "--no-record")
    assert "not known" in printed.out
    assert len(printed.err.splitlines()) == 1


def test_the_operator_answers_in_words_and_is_asked_again_until_the_input_ends(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    type_in(monkeypatch, "yes\nperhaps\nno\nquit\n")
    prompt = LegPrompt()
    assert [prompt.moved(leg) for leg in range(1, 5)] == [True, False, None, None]
    assert "'perhaps'" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("failure", "leg"), [("5:limp", 5), ("3:weak:0.9", None)])
def test_a_walk_finds_its_failed_leg_first(failure: str, leg: int | None, call: Call) -> None:
    """One that is not found is still what the simulation breaks."""
    walk = ["run", "--gait", "auto", "--duration", "0.5", "--no-record", "--json", "--failed-leg", "auto"]
    printed = call(*walk, "--failure", failure)
    outcome = printed.json
    assert outcome["failed_leg"] == leg
    assert leg is not None or "leg 3 weak:0.9" in printed.err


@pytest.mark.slow
def test_with_recovery_the_robot_keeps_its_speed_and_its_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(rescue.PICTURE, "width_px", 160)
    monkeypatch.setitem(rescue.PICTURE, "fps", 4)
    monkeypatch.setattr(rescue, "new_spec", partial(new_spec, duration_s=2.0))
    told: list[RunResult] = []
    result = rescue.demo(budget=1, folder=tmp_path / "runs", on_walk=told.append)
    walked_on, recovered = result.walked_on, result.recovered
    assert walked_on is not None
    assert recovered is not None
    assert told == [walked_on, recovered]
    distances_m = [walk.trial.distance_m or 0 for walk in (walked_on, recovered)]
    assert 0 < distances_m[0] <= 0.7 * distances_m[1]
    assert recovered.trial.deviation is not None
    assert recovered.trial.deviation.final < 0.04
    (noticed,) = recovered.trial.noticed
    assert noticed.failure.leg == rescue.EVENT.leg
    assert rescue.EVENT.at_s < noticed.at_s < rescue.EVENT.at_s + 2
    assert result.adaptation is not None
    spec = result.adaptation.session.spec
    assert (spec.broken, spec.world, spec.budget) == (rescue.EVENT.failure, f"{result.world}@0.5ms", 1)
    said = json.loads(json.dumps(result.to_dict()))
    assert said["recovered"]["distance_m"] > said["walked_on"]["distance_m"]
    assert [path.name for path in result.recordings] == ["walked-on.rrd", "recovered.rrd"]
    for path in result.recordings:
        conditions = read_trial(path).leg_conditions[:, rescue.EVENT.leg - 1]
        assert LEG_CONDITIONS[conditions[0]] == "whole"
        assert LEG_CONDITIONS[conditions[-1]] == "failed"
    assert (result.picture is None) is (result.no_picture is not None)
    if result.picture is not None:
        assert result.picture.parent == result.folder
        assert result.picture.stat().st_size < 3_000_000


@pytest.mark.long
def test_the_world_is_the_first_in_which_failure_and_search_show() -> None:
    """In the worlds before, recovery gains less than 30 %, or a gait goes straight without a search."""

    def shows(number: int) -> bool:
        world = f"transfer:{number}"
        walks = [rescue.walk_and_fail(one, None, world=world) for one in (rescue.WALK_ON, rescue.RECOVER)]
        without_m, with_m = (walk.trial.distance_m or 0 for walk in walks)
        if without_m > 0.7 * with_m:
            return False
        event = rescue.EVENT.failure
        known: dict[str, Any] = {
            "world": world,
            "failure": event,
            "hold": "none",
            "duration_s": 30.0,
            "record": False,
        }
        ends = [run(gait=gait, **known).trial.deviation for gait in ("tripod", "auto")]
        return all(end is not None and abs(end.final) > 0.1 for end in ends)

    assert f"transfer:{next(filter(shows, range(500, 510)))}" == rescue.WORLD


@pytest.mark.slow
def test_a_stop_leaves_what_was_walked_before_it(tmp_path: Path, monkeypatch: Any) -> None:
    monkeypatch.setattr(rescue, "WALK_S", 7.0)
    told: list[RunResult] = []
    begun: list[Session] = []
    result = rescue.demo(
        folder=tmp_path, on_walk=told.append, on_begin=begun.append, stop_requested=lambda: bool(begun)
    )
    assert result.interrupted
    assert [result.walked_on, result.recovered] == told
    assert result.picture is None
    assert "race" not in {thread.name for thread in threading.enumerate()}, "it would draw while Python ends"
    asked = iter(range(10_000))
    again = rescue.demo(folder=tmp_path, stop_requested=lambda: next(asked) > 30)
    assert again.interrupted
    assert again.walked_on is not None
    assert (again.recovered, again.adaptation, len(again.recordings)) == (None, None, 1)
    assert again.folder != result.folder, "nothing is replaced"


@pytest.mark.slow
def test_an_unexpected_error_of_the_drawing_is_part_of_the_result(tmp_path: Path, monkeypatch: Any) -> None:
    def export(*_: object, **__: object) -> None:
        raise ValueError("no encoder")

    monkeypatch.setattr(rescue, "export", export)
    result = rescue.DemoResult(event=rescue.EVENT, world=rescue.WORLD, folder=tmp_path)
    assert rescue._drawn(result, lambda: False) == {"no_picture": "ValueError: no encoder"}


@pytest.mark.slow
def test_what_cannot_be_is_refused_before_anything_walks(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="budget"):
        rescue.demo(budget=0, folder=tmp_path)
    assert not list(tmp_path.iterdir())
    taken = tmp_path / "taken"
    taken.touch()
    with pytest.raises(InputError, match="taken"):
        rescue.demo(folder=taken)
