"""A walk that has shown enough: when it is asked about, how it ends, and what is scored then."""

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import Enough, run_trial, stop_when
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import STATUSES, TrialResult
from hexctl.types import FloatArray
from hexctl.waiting import StopRequested, never
from tests.backends.fake_time import FakeTime
from tests.robots import shipped
from tests.trials import gait_of, walk


class Asked:
    """Has seen enough once a walk is as long as wanted, and keeps the paths that it was asked about."""

    def __init__(self, after_ticks: float = np.inf) -> None:
        self.after_ticks = after_ticks
        self.paths: list[FloatArray] = []

    def __call__(self, path_m: FloatArray) -> bool:
        self.paths.append(path_m.copy())
        return len(path_m) >= self.after_ticks


def _walk(
    duration_s: float,
    enough: Enough | None,
    *,
    world: World | None = None,
    stop_requested: StopRequested = never,
) -> tuple[TrialResult, TickLog]:
    log = TickLog()
    plan = TrialPlan(gait=gait_of(shipped()), duration_s=duration_s)
    with SimServos(shipped(), world=world) as servos:
        result = run_trial(
            Guard(servos),
            plan,
            recorders=(log,),
            stop_requested=stop_requested,
            should_stop=stop_when(enough),
        )
    return result, log


def test_it_is_asked_once_a_second_with_the_path_so_far() -> None:
    asked = Asked()
    result, _ = _walk(3.5, asked)
    assert [len(path) for path in asked.paths] == [50, 100, 150]
    for path in asked.paths:
        np.testing.assert_array_equal(path, result.path_m[: len(path)])


def test_a_walk_that_never_shows_enough_is_the_walk_that_nobody_asked_about() -> None:
    watched, alone = _walk(2.5, Asked())[0], walk(duration_s=2.5).result
    assert watched.status == "ok"
    assert watched.to_dict() == alone.to_dict()
    np.testing.assert_array_equal(watched.path_m, alone.path_m)


def test_a_walk_that_is_over_is_not_asked_about() -> None:
    asked = Asked(after_ticks=100)
    result, _ = _walk(2.0, asked)
    assert [len(path) for path in asked.paths] == [50]
    assert result.status == "ok"


def test_what_is_scored_is_the_walk_that_was_made() -> None:
    cut, _ = _walk(30.0, Asked(after_ticks=150))
    whole = walk(duration_s=3.0).result
    assert (cut.status, whole.status) == ("cut_short", "ok")
    assert cut.stopped is None
    assert cut.to_dict() | {"status": "ok"} == whole.to_dict()
    assert cut.duration_s == pytest.approx(3.0)
    assert cut.distance_m == cut.path_m[-1, 0]
    assert cut.deviation is not None
    assert cut.deviation.signed == cut.path_m[-1, 1]
    np.testing.assert_array_equal(cut.path_m, whole.path_m)


def test_a_walk_cut_short_is_never_valid_however_straight() -> None:
    cut, _ = _walk(30.0, Asked(after_ticks=50))
    assert cut.status in STATUSES
    assert not cut.valid
    assert {objective(cut) for objective in OBJECTIVES.values()} == {INVALID_SCORE}


def test_a_walk_cut_short_that_got_nowhere_was_still_cut_short() -> None:
    cut, _ = _walk(30.0, Asked(after_ticks=200), world=World(servo_strength=0.01))
    assert cut.status == "cut_short"
    assert cut.distance_m == pytest.approx(0, abs=0.1)


def test_a_walk_cut_short_ends_softly_in_the_stance() -> None:
    _, log = _walk(30.0, Asked(after_ticks=100))
    walked, stopping = log.rows_of("walk"), log.rows_of("stop")
    assert walked.stop - walked.start == 100
    assert stopping.stop > stopping.start
    np.testing.assert_allclose(log["commanded_rad"][-1], shipped().stance_angles_rad, atol=1e-9)
    jumps = np.abs(np.diff(log["commanded_rad"], axis=0)).max(axis=0)
    assert (jumps <= shipped().joint_max_speed_rad_s * 0.02 + 1e-12).all()


def test_a_stop_that_is_asked_for_still_aborts() -> None:
    asked, log = Asked(after_ticks=200), TickLog()
    plan = TrialPlan(gait=gait_of(shipped()), duration_s=30)
    with SimServos(shipped()) as servos:
        result = run_trial(
            Guard(servos),
            plan,
            recorders=(log,),
            stop_requested=lambda: log.walked_ticks >= 120,
            should_stop=stop_when(asked),
        )
    assert (result.status, result.stopped) == ("aborted", "requested")
    assert [len(path) for path in asked.paths] == [50, 100]
    assert result.duration_s == pytest.approx(2.4)


def test_a_walk_that_was_stopped_before_it_began_is_not_asked_about() -> None:
    asked = Asked(after_ticks=0)
    result, _ = _walk(30.0, asked, stop_requested=lambda: True)
    assert result.status == "aborted"
    assert asked.paths == []


def test_a_robot_that_knows_no_pose_has_no_path_to_show() -> None:
    asked = Asked()
    plan = TrialPlan(gait=gait_of(shipped()), duration_s=2.5)
    with Guard(MockServos(shipped(), clock=FakeTime().clock())) as guard:
        result = run_trial(guard, plan, should_stop=stop_when(asked))
    assert result.status == "ok"
    assert [path.shape for path in asked.paths] == [(0, 2), (0, 2)]
