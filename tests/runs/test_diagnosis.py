"""`hexctl.diagnose`: one call, a recording, plain values."""

import json
from pathlib import Path

import pytest

import hexctl
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimClock
from hexctl.errors import InputError
from hexctl.robot.model import Robot


class Echo(MockServos):
    """Servos that echo, ahead of time."""

    def __init__(self, robot: Robot) -> None:
        super().__init__(robot, clock=SimClock(lambda: None))


ECHO = "tests.runs.test_diagnosis:Echo"


def test_a_simulated_leg_is_found_recorded_and_told_in_plain_values(tmp_path: Path) -> None:
    path = tmp_path / "diagnosis.rrd"
    done = hexctl.diagnose(failure="5:limp:femur", record=path)
    assert [str(failure) for failure in done.diagnosis.failures] == ["limp:femur"]
    assert done.trial.status == "ok"
    assert done.recording == path
    assert path.stat().st_size > 10_000
    outcome = json.loads(json.dumps(done.to_dict(), allow_nan=False))
    assert outcome["verdict"] == "leg 5 limp:femur"
    assert outcome["legs"][4]["gains"]["femur"] < 0.3 < outcome["legs"][4]["gains"]["coxa"]
    assert any("left out" in note for note in outcome["notes"])


def test_echoing_servos_are_asked_about_leg_by_leg() -> None:
    asked = []

    def ask(leg: int) -> bool:
        asked.append(leg)
        return leg != 3

    done = hexctl.diagnose(backend=ECHO, ask=ask)
    assert asked == [1, 2, 3, 4, 5, 6]
    assert done.diagnosis.source == done.outcome["source"] == "operator"
    assert done.outcome["verdict"] == "leg 3 unknown"


def test_without_an_operator_echoing_servos_leave_the_legs_unknown() -> None:
    done = hexctl.diagnose(backend=ECHO)
    assert done.diagnosis.source == "none"
    assert done.diagnosis.failures == ()
    assert done.outcome["verdict"].startswith("not known")


def test_a_stop_request_ends_the_test_early() -> None:
    calls = iter(range(10_000))
    done = hexctl.diagnose(stop_requested=lambda: next(calls) > 100)
    assert done.trial.status == "aborted"
    assert done.diagnosis.failures == ()


def test_only_a_simulation_is_told_what_to_break() -> None:
    with pytest.raises(InputError, match="failed_leg"):
        hexctl.diagnose(backend="mock", failed_leg=2)
    with pytest.raises(InputError, match="gait"):
        hexctl.diagnose(gait="wave")
