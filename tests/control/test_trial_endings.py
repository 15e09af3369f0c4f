"""Every way in which a trial can end, what is scored then, and what must not end it."""

import json
import math
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hexctl import Failure, Guard, Recorders, RobotFaultError, SimServos, TrialPlan, TrialResult, run_trial
from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES
from hexctl.backends.mock import MockServos
from hexctl.control.guard import POSE_EXPIRY_S
from hexctl.control.log import TickLog
from hexctl.control.trial import Enough, stop_when
from hexctl.robot.failure import each_failure
from hexctl.types import FloatArray
from tests.backends.fake_time import FakeTime
from tests.control.posed import PosedMock
from tests.robots import shipped
from tests.trials import Calling, gait_of, walk


def _plan(**changes: Any) -> TrialPlan:
    return TrialPlan(gait=gait_of(shipped()), **changes)


def _all_finite(result: TrialResult) -> bool:
    """Whether the numbers of a result survive strict JSON, which knows no NaN."""
    json.dumps(result.to_dict(), allow_nan=False)
    return bool(np.isfinite(result.path_m).all())


def _ends_softly(log: TickLog) -> None:
    """The joints end in the stance, and none was ever commanded faster than it may move."""
    np.testing.assert_allclose(log["commanded_rad"][-1], shipped().stance_angles_rad, atol=1e-9)
    jumps = np.abs(np.diff(log["commanded_rad"], axis=0)).max(axis=0)
    assert (jumps <= shipped().joint_max_speed_rad_s * 0.02 + 1e-12).all()


def _with_physics_at(tick: int, happen: Callable[[Any], None], **plan: Any) -> tuple[TrialResult, TickLog]:
    """Run a trial in which something happens to the physics when the walk reaches a tick."""
    with SimServos(shipped()) as servos:
        log = TickLog()

        def never_but_look() -> bool:
            if log.phase == "walk" and len(log) - log.rows_of("walk").start == tick:
                happen(servos.compiled.physics.data)
            return False

        gait = gait_of(shipped(), "tripod")
        result = run_trial(
            Guard(servos), TrialPlan(gait=gait, **plan), recorders=(log,), stop_requested=never_but_look
        )
    return result, log


def test_a_fall_ends_the_walk_with_what_was_walked_so_far() -> None:
    def tip_over(data: Any) -> None:
        data.qpos[2] += 0.1
        data.qpos[3:7] = [0, 1, 0, 0]

    result, log = _with_physics_at(100, tip_over, duration_s=10)
    assert result.status == "fell"
    assert result.duration_s == pytest.approx(2.0, abs=0.3)
    assert result.distance_m is not None
    assert log.rows_of("stop") == slice(0, 0)
    assert _all_finite(result)


@pytest.mark.parametrize("value", [1e12, math.nan])
def test_a_simulation_that_diverges_is_a_result_without_nonsense(value: float) -> None:
    def blow_up(data: Any) -> None:
        data.qvel[:] = value

    result, log = _with_physics_at(150, blow_up, duration_s=10)
    assert result.status == "diverged"
    assert not result.valid
    assert result.duration_s == pytest.approx(3.0, abs=0.1)
    assert result.distance_m == pytest.approx(0.3, abs=0.1)
    assert _all_finite(result)
    assert np.isfinite(log["measured_rad"]).all()


def _stopped(phase: str, after_ticks: int, **plan: Any) -> tuple[TrialResult, TickLog, Guard]:
    """Run a trial of a robot that follows exactly, and ask for a stop some ticks into a phase."""
    log = TickLog()

    def asked() -> bool:
        rows = log.rows_of(phase)
        return bool(rows.stop - rows.start >= after_ticks)

    with Guard(PosedMock()) as guard:
        return run_trial(guard, _plan(**plan), recorders=(log,), stop_requested=asked), log, guard


def test_a_stop_in_the_walk_ends_softly_in_the_stance_as_aborted() -> None:
    result, log, guard = _stopped("walk", 200, duration_s=30)
    assert result.status == "aborted"
    assert guard.stopped is None, "nothing was frozen"
    assert result.duration_s == pytest.approx(4.0, abs=0.05)
    stopping = log.rows_of("stop")
    assert (stopping.stop - stopping.start) * 0.02 == pytest.approx(2.0, abs=0.05)
    assert result.to_dict()["stopped"] == "requested"
    _ends_softly(log)


def test_a_stop_in_the_turn_ends_softly_in_the_stance_without_a_walk() -> None:
    result, log, guard = _stopped("turn", 150, failures=(Failure(leg=2),))
    assert result.status == "aborted"
    assert guard.stopped is None
    assert (result.distance_m, result.duration_s) == (None, 0)
    assert log.rows_of("walk") == slice(0, 0)
    turning = log.rows_of("turn")
    assert turning.stop - turning.start < 150 + 101 + 30, "it did not turn to the end"
    _ends_softly(log)


def test_a_stop_asked_for_from_the_start_commands_nothing() -> None:
    servos, log = PosedMock(), TickLog()
    with Guard(servos) as guard:
        result = run_trial(
            guard, _plan(failures=(Failure(leg=2),)), recorders=(log,), stop_requested=lambda: True
        )
    assert (result.status, result.stopped, result.duration_s) == ("aborted", "requested", 0)
    assert (len(log), len(servos.sent)) == (0, 0)
    assert _all_finite(result)


def test_a_stop_while_it_settles_starts_neither_turn_nor_walk() -> None:
    result, log, _ = _stopped("settle", 10, failures=(Failure(leg=2),))
    assert (result.status, result.stopped) == ("aborted", "requested")
    assert log.rows_of("turn") == log.rows_of("walk") == slice(0, 0)


def test_a_stop_asked_for_in_the_soft_stop_leaves_the_walk_whole() -> None:
    result, _, _ = _stopped("stop", 20, duration_s=1)
    assert (result.status, result.stopped, result.valid) == ("ok", None, True)
    assert result.duration_s == pytest.approx(1)


def test_an_emergency_stop_freezes_at_once_and_aborts() -> None:
    log = TickLog()
    with Guard(PosedMock()) as guard:

        def press() -> bool:
            if log.walked_ticks == 100:
                guard.stop("by hand")
            return False

        result = run_trial(guard, _plan(duration_s=30), recorders=(log,), stop_requested=press)
    assert (result.status, result.stopped) == ("aborted", "by hand")
    assert result.duration_s == pytest.approx(2.0, abs=0.05)
    assert log.rows_of("stop") == slice(0, 0)


# A pose that is not known, or lost


def test_a_robot_that_knows_no_pose_walks_and_is_not_scored() -> None:
    with Guard(MockServos(shipped(), clock=FakeTime().clock())) as guard:
        log = TickLog()
        result = run_trial(guard, _plan(failures=(Failure(leg=2),), duration_s=3), recorders=(log,))
    assert result.status == "ok"
    assert result.duration_s == pytest.approx(3)
    assert (result.distance_m, result.deviation, result.yaw_change_rad) == (None, None, None)
    assert not result.valid
    assert log.rows_of("turn") == slice(0, 0), "it could not know when to end the turn"
    held = log["commanded_rad"][log.rows_of("walk")][:, 3:6]
    assert (held == shipped().stance_angles_rad[3:6]).all()


@pytest.mark.parametrize(("phase", "belief"), [("walk", None), ("turn", Failure(leg=2))])
def test_a_robot_that_loses_its_pose_is_stopped_and_not_scored(phase: str, belief: Failure | None) -> None:
    servos, log = PosedMock(), TickLog()

    def lose_it() -> bool:
        if log.phase == phase:
            servos.position_world = servos.quaternion_world = None
        return False

    with Guard(servos) as guard:
        plan = _plan(failures=each_failure(belief), duration_s=8)
        result = run_trial(guard, plan, recorders=(log,), stop_requested=lose_it)
    assert (result.status, result.stopped, result.distance_m) == ("aborted", "pose lost", None)
    assert not result.valid
    rows = log.rows_of(phase)
    assert rows.stop - rows.start == pytest.approx(POSE_EXPIRY_S / 0.02, abs=3)
    if phase == "walk":
        assert result.duration_s == pytest.approx(POSE_EXPIRY_S, abs=0.1)


def test_a_walk_that_ends_without_a_pose_has_no_end_and_one_that_finds_it_again_has() -> None:
    servos = PosedMock()
    pose = servos.position_world, servos.quaternion_world

    def away(first_s: float, last_s: float) -> TrialResult:
        def look(log: TickLog, _first: int, _last: int) -> None:
            if log.phase == "walk":
                rows = log.rows_of("walk")
                gone = first_s <= 0.02 * (rows.stop - rows.start) < last_s
                servos.position_world, servos.quaternion_world = (None, None) if gone else pose

        with Guard(servos, trusts_position=lambda: True) as guard:
            return run_trial(guard, _plan(duration_s=6), recorders=(Calling(look, block_ticks=1),))

    ended = away(4.0, 9.0)
    servos.position_world, servos.quaternion_world = pose
    assert (ended.distance_m, ended.deviation, ended.valid) == (None, None, False)
    found = away(1.0, 4.0)
    assert found.distance_m == pytest.approx(0.0, abs=1e-9), "the mock stands still"
    assert np.isnan(found.path_m[:, 0]).any()


# Faults, recorders and clocks


@pytest.mark.parametrize(
    ("change", "reason"),
    [({"healthy": False}, "fault"), ({"age_s": 1.0}, "state")],
)
@pytest.mark.parametrize("phase", ["settle", "walk", "stop"])
def test_what_goes_wrong_aborts_the_walk_unless_it_is_over(
    phase: str, change: dict[str, Any], reason: str
) -> None:
    servos = PosedMock()

    def meddle(log: TickLog, _first: int, _last: int) -> None:
        if log.phase == phase:
            vars(servos).update(change)

    recorders = Recorders(Calling(meddle, block_ticks=1))
    with Guard(servos) as guard:
        result = run_trial(guard, _plan(duration_s=1.0), recorders=recorders)
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


def test_a_fault_of_the_robot_is_raised_and_what_was_logged_is_kept() -> None:
    seen: list[tuple[int, int]] = []
    servos, log = PosedMock(), TickLog()

    def unplug() -> bool:
        if len(log) == 100:
            servos.fail_with(RobotFaultError("the link is gone"))
        return False

    watching = Calling(lambda _, first, last: seen.append((first, last)))
    guard = Guard(servos)
    guard.connect()
    with pytest.raises(RobotFaultError):
        run_trial(guard, _plan(duration_s=30), recorders=(log, watching), stop_requested=unplug)
    assert len(log) == 100
    assert seen[-1][1] == 100


def test_a_clock_that_skips_points_does_not_stretch_the_walk() -> None:
    """Every tick's work takes two and a half periods: the gait keeps to the time, not to the ticks."""
    servos, log = PosedMock(), TickLog()

    def work() -> bool:
        servos.time.work(0.05)
        return False

    with Guard(servos) as guard:
        result = run_trial(guard, _plan(duration_s=4), recorders=(log,), stop_requested=work)
    rows = log.rows_of("walk")
    assert rows.stop - rows.start < 0.5 * 4 / 0.02
    assert result.duration_s == pytest.approx(4, abs=0.06)
    assert servos.clock.overruns > 50


# Walks that have shown enough


class Asked:
    """Has seen enough once a walk is as long as wanted, and keeps the paths that it was asked about."""

    def __init__(self, after_ticks: float = np.inf) -> None:
        self.after_ticks = after_ticks
        self.paths: list[FloatArray] = []

    def __call__(self, path_m: FloatArray) -> bool:
        self.paths.append(path_m.copy())
        return len(path_m) >= self.after_ticks


def _shown(duration_s: float, enough: Enough | None) -> tuple[TrialResult, TickLog]:
    """A walk in the simulation that ends when it has shown enough."""
    log = TickLog()
    with SimServos(shipped()) as servos:
        plan, should_stop = _plan(duration_s=duration_s), stop_when(enough)
        return run_trial(servos, plan, recorders=(log,), should_stop=should_stop), log


def test_a_walk_is_asked_about_once_a_second_with_its_path_so_far_and_not_at_its_end() -> None:
    asked = Asked()
    result, log = _shown(2.0, asked)
    assert [len(path) for path in asked.paths] == [50]
    np.testing.assert_array_equal(asked.paths[0], result.path_m[:50])
    alone = walk(duration_s=2.0).result
    assert result.status == "ok"
    assert result.to_dict() == alone.to_dict()
    np.testing.assert_array_equal(result.path_m, alone.path_m)

    cut, log = _shown(30.0, Asked(after_ticks=100))
    assert (cut.status, cut.stopped, cut.valid) == ("cut_short", None, False)
    assert cut.to_dict() | {"status": "ok"} == alone.to_dict()
    np.testing.assert_array_equal(cut.path_m, alone.path_m)
    assert cut.deviation is not None
    assert (cut.distance_m, cut.deviation.signed) == tuple(cut.path_m[-1])
    assert {objective(cut) for objective in OBJECTIVES.values()} == {INVALID_SCORE}
    walked, stopping = log.rows_of("walk"), log.rows_of("stop")
    assert walked.stop - walked.start == 100
    assert stopping.stop > stopping.start
    _ends_softly(log)


def test_a_walk_cut_short_that_got_nowhere_was_still_cut_short_and_may_say_why() -> None:
    with Guard(PosedMock()) as guard:
        plan = _plan(duration_s=30)
        cut = run_trial(guard, plan, should_stop=lambda trace: len(trace.path_m) >= 200 and "enough")
    assert (cut.status, cut.stopped) == ("cut_short", "enough")
    assert cut.duration_s == pytest.approx(4.0)
    assert cut.distance_m == pytest.approx(0, abs=0.1)


@pytest.mark.parametrize(("stop_tick", "asked_at"), [(120, [50, 100]), (0, [])])
def test_a_stop_that_is_asked_for_still_aborts(stop_tick: int, asked_at: list[int]) -> None:
    asked, log = Asked(after_ticks=200 if stop_tick else 0), TickLog()
    with Guard(PosedMock()) as guard:
        result = run_trial(
            guard,
            _plan(duration_s=30),
            recorders=(log,),
            stop_requested=lambda: log.walked_ticks >= stop_tick,
            should_stop=stop_when(asked),
        )
    assert (result.status, result.stopped) == ("aborted", "requested")
    assert [len(path) for path in asked.paths] == asked_at
    assert result.duration_s == pytest.approx(0.02 * stop_tick)
