"""What a trial's result counts, and what happens around the walk that must not change it."""

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.mock import MockServos
from hexctl.control.guard import Guard
from hexctl.control.log import Recorders, TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.robot.failure import Failure
from hexctl.types import JointTargets
from tests.backends.fake_time import FakeTime
from tests.control.posed import PosedMock
from tests.recorders import Calling
from tests.robots import shipped
from tests.trials import gait_of, walk

STANCE = shipped().stance_angles_rad


def _plan(**changes: Any) -> TrialPlan:
    return TrialPlan(gait=gait_of(shipped()), **{"duration_s": 1.0, **changes})


class _Rounding(PosedMock):
    """Servos that take whole hundredths of a radian."""

    def write(self, targets: JointTargets) -> JointTargets:
        return super().write(JointTargets(np.round(targets.joint_positions_rad, 2), targets.stamp_s))


def test_what_the_servos_round_is_recorded_and_is_no_clipping() -> None:
    servos, log = _Rounding(), TickLog()
    slow = replace(gait_of(shipped()), pace_hz=0.2, amplitude=0.05)
    with Guard(servos) as guard:
        result = run_trial(guard, TrialPlan(gait=slow, duration_s=2), recorders=(log,))
    assert result.clipped_ticks == guard.counters.clipped == 0
    assert (log["commanded_rad"] != log["wanted_rad"]).any()
    np.testing.assert_array_equal(log["commanded_rad"], np.round(log["wanted_rad"], 2))


def test_ticks_are_counted_as_clipped_in_the_walk_only() -> None:
    servos, log = PosedMock(), TickLog()
    servos.connect()
    servos.write(JointTargets(STANCE - 0.8, 0.0))
    guard = Guard(servos)
    result = run_trial(guard, _plan(settle_s=0.2), recorders=(log,))
    changed = (log["commanded_rad"] != log["wanted_rad"]).any(axis=-1)
    assert changed[log.rows_of("settle")].any()
    assert guard.counters.clipped == changed.sum()
    assert result.clipped_ticks == changed[log.rows_of("walk")].sum()


def _meddler(phase: str, happen: Callable[[], object]) -> Calling:
    """A recorder that does something to the robot in a phase."""
    return Calling(lambda log, _, __: happen() if log.phase == phase else None, block_ticks=1)


def _run(servos: PosedMock, phase: str, happen: Callable[[], object]) -> tuple[TrialResult, Guard, Recorders]:
    guard, recorders = Guard(servos), Recorders(_meddler(phase, happen))
    servos.connect()
    return run_trial(guard, _plan(), recorders=recorders), guard, recorders


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"healthy": False}, "fault"), ({"age_s": 1.0}, "state")],
)
@pytest.mark.parametrize("phase", ["settle", "walk", "stop"])
def test_what_goes_wrong_aborts_the_walk_unless_it_is_over(
    phase: str, change: dict[str, Any], reason: str
) -> None:
    servos = PosedMock()
    result, guard, recorders = _run(servos, phase, lambda: vars(servos).update(change))
    log = recorders.log
    assert guard.stopped == reason
    ends = log.rows_of(phase)
    assert ends.stop - ends.start == 1, "it stands without a step more"
    if phase == "stop":
        assert (result.status, result.stopped, result.valid) == ("ok", None, True)
        assert result.duration_s == pytest.approx(1)
    else:
        assert (result.status, result.stopped, result.valid) == ("aborted", reason, False)
    assert result.to_dict()["stopped"] == result.stopped


def test_a_fall_in_the_soft_stop_leaves_the_walk_as_it_was() -> None:
    servos = PosedMock()
    result, guard, recorders = _run(servos, "stop", lambda: servos.lean(90))
    log = recorders.log
    assert guard.stopped == "fell"
    assert log.rows_of("stop").stop - log.rows_of("stop").start < 20
    assert (result.status, result.stopped) == ("ok", None)
    assert result.valid


def test_a_stop_requested_in_the_soft_stop_leaves_the_walk_as_it_was() -> None:
    asked = []
    servos, log = PosedMock(), _meddler("stop", lambda: asked.append(1))
    with Guard(servos) as guard:
        result = run_trial(guard, _plan(), recorders=(log,), stop_requested=lambda: bool(asked))
    assert asked
    assert (result.status, result.stopped) == ("ok", None)


def test_a_stop_requested_says_so_in_the_numbers() -> None:
    log = TickLog()
    with Guard(PosedMock()) as guard:
        result = run_trial(guard, _plan(), recorders=(log,), stop_requested=lambda: log.walked_ticks == 20)
    assert result.duration_s == pytest.approx(0.4)
    assert result.to_dict()["status"] == "aborted"
    assert result.to_dict()["stopped"] == "requested"


def test_a_recorder_that_fails_lets_the_robot_walk_on_to_the_end() -> None:
    def fail() -> None:
        raise OSError("no space left")

    result, guard, recorders = _run(PosedMock(), "walk", fail)
    log = recorders.log
    assert (result.status, guard.stopped) == ("ok", None)
    assert [str(failure.error) for failure in recorders.failures] == ["no space left"]
    assert log.walked_ticks == 50
    np.testing.assert_allclose(log["commanded_rad"][-1], STANCE, atol=1e-9)


def test_without_a_deviation_a_trial_is_ok_and_cannot_be_ranked() -> None:
    with Guard(MockServos(shipped(), clock=FakeTime().clock())) as guard:
        result = run_trial(guard, _plan(duration_s=3.0))
    assert (result.status, result.deviation, result.valid) == ("ok", None, False)


@pytest.mark.slow
@pytest.mark.parametrize(("leg", "degrees"), [(3, 60), (5, -60), (4, 0)])
def test_how_far_the_self_rotation_turned_is_in_the_result(leg: int, degrees: float) -> None:
    result = walk(failure=Failure(leg=leg), duration_s=0.1).result
    assert math.degrees(result.turned_rad) == pytest.approx(degrees, abs=0.15)
    assert result.to_dict()["self_rotation_deg"] == pytest.approx(math.degrees(result.turned_rad))
    assert result.to_dict()["stopped"] is None


def test_three_trials_in_a_row_on_one_guard_are_each_their_own() -> None:
    servos = PosedMock()
    with Guard(servos) as guard:
        for _ in range(3):
            log = TickLog()
            result = run_trial(guard, _plan(), recorders=(log,))
            assert (result.status, result.stopped) == ("ok", None)
            assert result.duration_s == pytest.approx(1)
            assert log.walked_ticks == 50
            servos.time.work(3600.0)
    assert guard.clock.overruns == 0
