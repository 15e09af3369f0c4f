"""Every way in which a trial can end, and what is scored then."""

import json
import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.controllers import check_walk
from hexctl.control.guard import POSE_EXPIRY_S, Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.errors import LimitError, ReachError, RobotFaultError
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.types import FloatArray, RobotState, leg_slice
from tests.backends.fake_time import FakeTime
from tests.control.posed import PosedMock
from tests.recorders import Calling
from tests.robots import shipped
from tests.trials import gait_of, walk


def _all_finite(result: TrialResult) -> bool:
    """Whether the numbers of a result survive strict JSON, which knows no NaN."""
    json.dumps(result.to_dict(), allow_nan=False)
    return bool(np.isfinite(result.path_m).all())


@pytest.mark.slow
def test_a_robot_without_strength_makes_no_progress() -> None:
    result = walk("tripod", world=World(servo_strength=0.01), duration_s=6).result
    assert result.status == "no_progress"
    assert not result.valid
    assert result.distance_m == pytest.approx(0, abs=0.1)


def test_a_robot_that_topples_over_while_it_settles_has_fallen_and_walked_nowhere() -> None:
    world = World(payload_kg=2, payload_position_m=(0.3, 0.0, 0.2))
    result = walk("tripod", world=world, duration_s=6).result
    assert (result.status, result.distance_m, result.deviation, result.duration_s) == ("fell", None, None, 0)
    assert _all_finite(result)


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
    """Run a trial in the simulation and ask for a stop some ticks into a phase."""
    failure = plan.pop("failure", None)
    with SimServos(shipped(), failure=failure) as servos:
        guard, log = Guard(servos), TickLog()

        def asked() -> bool:
            rows = log.rows_of(phase)
            return bool(rows.stop - rows.start >= after_ticks)

        result = run_trial(
            guard,
            TrialPlan(gait=gait_of(shipped()), belief=failure, **plan),
            recorders=(log,),
            stop_requested=asked,
        )
    return result, log, guard


def test_a_stop_in_the_walk_ends_softly_in_the_stance_as_aborted() -> None:
    result, log, guard = _stopped("walk", 200, duration_s=30)
    assert result.status == "aborted"
    assert guard.stopped is None, "nothing was frozen"
    assert result.duration_s == pytest.approx(4.0, abs=0.05)
    assert result.distance_m == pytest.approx(0.1485 * 3, abs=0.1)
    stopping = log.rows_of("stop")
    assert (stopping.stop - stopping.start) * 0.02 == pytest.approx(2.0, abs=0.05)
    np.testing.assert_allclose(log["commanded_rad"][-1], shipped().stance_angles_rad, atol=1e-9)
    jumps = np.abs(np.diff(log["commanded_rad"], axis=0)).max(axis=0)
    assert (jumps <= shipped().joint_max_speed_rad_s * 0.02 + 1e-12).all()


def test_a_stop_in_the_turn_ends_softly_in_the_stance_without_a_walk() -> None:
    result, log, guard = _stopped("turn", 150, failure=Failure(leg=2))
    assert result.status == "aborted"
    assert guard.stopped is None
    assert (result.distance_m, result.duration_s) == (None, 0)
    assert log.rows_of("walk") == slice(0, 0)
    turning = log.rows_of("turn")
    assert turning.stop - turning.start < 150 + 101 + 30, "it did not turn to the end"
    np.testing.assert_allclose(log["commanded_rad"][-1], shipped().stance_angles_rad, atol=1e-9)


def test_a_stop_asked_for_from_the_start_commands_nothing() -> None:
    servos, log = PosedMock(), TickLog()
    with Guard(servos) as guard:
        plan = TrialPlan(gait=gait_of(shipped()), belief=Failure(leg=2))
        result = run_trial(guard, plan, recorders=(log,), stop_requested=lambda: True)
    assert (result.status, result.stopped, result.duration_s) == ("aborted", "requested", 0)
    assert (len(log), len(servos.sent)) == (0, 0)
    assert _all_finite(result)


def test_a_stop_before_the_walk_never_walks() -> None:
    result, log, _ = _stopped("settle", 10, duration_s=30)
    assert result.status == "aborted"
    assert log.rows_of("walk") == slice(0, 0)


def test_an_emergency_stop_freezes_at_once_and_aborts() -> None:
    with SimServos(shipped()) as servos:
        guard, log = Guard(servos), TickLog()

        def press() -> bool:
            if log.rows_of("walk").stop - log.rows_of("walk").start == 100:
                guard.stop("by hand")
            return False

        result = run_trial(
            guard, TrialPlan(gait=gait_of(shipped()), duration_s=30), recorders=(log,), stop_requested=press
        )
    assert result.status == "aborted"
    assert result.duration_s == pytest.approx(2.0, abs=0.05)
    assert log.rows_of("stop") == slice(0, 0)


def test_a_robot_that_knows_no_pose_walks_and_is_not_scored() -> None:
    with Guard(MockServos(shipped(), clock=FakeTime().clock())) as guard:
        log = TickLog()
        plan = TrialPlan(gait=gait_of(shipped()), belief=Failure(leg=2), duration_s=3)
        result = run_trial(guard, plan, recorders=(log,))
    assert result.status == "ok"
    assert result.duration_s == pytest.approx(3)
    assert (result.distance_m, result.deviation, result.yaw_change_rad) == (None, None, None)
    assert result.to_dict()["deviation_m"] == {"final": None, "mean": None, "max": None, "signed": None}
    assert log.rows_of("turn") == slice(0, 0), "it could not know when to end the turn"
    held = log["commanded_rad"][log.rows_of("walk")][:, 3:6]
    assert (held == shipped().stance_angles_rad[3:6]).all()


def test_a_robot_that_loses_its_pose_is_not_scored_with_a_made_up_one() -> None:
    servos, log = PosedMock(), TickLog()

    def lose_it() -> bool:
        if log.phase == "walk":
            servos.position_world = servos.quaternion_world = None
        return False

    with Guard(servos) as guard:
        result = run_trial(
            guard, TrialPlan(gait=gait_of(shipped()), duration_s=8), recorders=(log,), stop_requested=lose_it
        )
    assert (result.status, result.stopped) == ("aborted", "pose lost")
    assert not result.valid
    assert result.distance_m is None
    assert result.duration_s == pytest.approx(POSE_EXPIRY_S, abs=0.1)


def test_a_walk_that_ends_without_a_pose_has_no_end_and_one_that_finds_it_again_has() -> None:
    servos = PosedMock()
    pose = servos.position_world, servos.quaternion_world
    plan = TrialPlan(gait=gait_of(shipped()), duration_s=6)

    def away(first_s: float, last_s: float) -> TrialResult:
        def look(log: TickLog, _first: int, _last: int) -> None:
            if log.phase == "walk":
                rows = log.rows_of("walk")
                gone = first_s <= 0.02 * (rows.stop - rows.start) < last_s
                servos.position_world, servos.quaternion_world = (None, None) if gone else pose

        with Guard(servos) as guard:
            return run_trial(guard, plan, recorders=(Calling(look, block_ticks=1),))

    ended = away(4.0, 9.0)
    servos.position_world, servos.quaternion_world = pose
    assert (ended.distance_m, ended.deviation, ended.valid) == (None, None, False)
    found = away(1.0, 4.0)
    assert found.distance_m == pytest.approx(0.0, abs=1e-9), "the mock stands still"
    assert np.isnan(found.path_m[:, 0]).any()


def test_a_robot_that_loses_its_pose_in_the_turn_is_stopped() -> None:
    servos, log = PosedMock(), TickLog()

    def lose_it() -> bool:
        if log.phase == "turn":
            servos.position_world = servos.quaternion_world = None
        return False

    plan = TrialPlan(gait=gait_of(shipped()), belief=Failure(leg=2), duration_s=3)
    with Guard(servos) as guard:
        result = run_trial(guard, plan, recorders=(log,), stop_requested=lose_it)
    turning = log.rows_of("turn")
    assert turning.stop - turning.start == pytest.approx(POSE_EXPIRY_S / 0.02, abs=3)
    assert (result.status, result.stopped, result.distance_m) == ("aborted", "pose lost", None)


def test_a_stop_while_it_settles_starts_no_turn() -> None:
    result, log, _ = _stopped("settle", 10, failure=Failure(leg=2))
    assert (result.status, result.stopped) == ("aborted", "requested")
    assert log.rows_of("turn") == slice(0, 0)


def test_a_stop_asked_for_in_the_soft_stop_leaves_the_walk_whole() -> None:
    result, _, _ = _stopped("stop", 20, duration_s=3)
    assert (result.status, result.stopped) == ("ok", None)
    assert result.duration_s == pytest.approx(3)


def test_what_is_broken_and_what_the_controller_believes_are_two_things() -> None:
    """A locked leg that the controller was not told of is commanded like the others, and does not follow."""
    broken = Failure(leg=5)
    excursion_rad: dict[bool, FloatArray] = {}
    for told in (False, True):
        plan = TrialPlan(gait=gait_of(shipped()), belief=broken if told else None, duration_s=3.0)
        log = TickLog()
        with SimServos(shipped(), failure=broken) as servos:
            run_trial(Guard(servos), replace(plan, self_rotation="none"), recorders=(log,))
        rows, leg = log.rows_of("walk"), leg_slice(5)
        excursion_rad[told] = np.ptp(
            [log[name][rows][:, leg] for name in ("wanted_rad", "measured_rad")], axis=1
        )
    assert excursion_rad[True].max() < 0.06
    assert excursion_rad[False][0].max() > 0.2
    assert excursion_rad[False][1].max() < 0.06


def test_a_walk_that_the_legs_cannot_make_after_the_turn_is_refused_before_it() -> None:
    """Forward the gait is possible, sideways, where the self-rotation leads, it is not."""
    robot, failure = shipped("phantomx"), Failure(leg=2)
    gait = replace(gait_of(robot), amplitude=0.13)
    plan = TrialPlan(gait=gait, belief=failure, duration_s=1)
    check_walk(robot, gait, plan.motion(0.0))
    log = TickLog()
    with Guard(SimServos(robot, failure=failure)) as guard, pytest.raises((ReachError, LimitError)):
        run_trial(guard, plan, recorders=(log,))
    assert len(log) == 0
    with pytest.raises((ReachError, LimitError)):
        run_sim_trials([SimTrial(robot=robot, plan=plan, failure=plan.belief)])


@pytest.mark.parametrize(("amplitude", "height"), [(0.6, 0.02), (0.05, 0.3)])
def test_a_gait_beyond_the_legs_is_refused_before_anything_moves(amplitude: float, height: float) -> None:
    servos = PosedMock()
    gait = Gait(slots=(1, 4, 2, 6, 3, 5), pace_hz=0.9, amplitude=amplitude, height=height)
    with Guard(servos) as guard, pytest.raises((ReachError, LimitError), match=r"leg \d"):
        run_trial(guard, TrialPlan(gait=gait))
    assert len(servos.sent) == 0


class _Dying(PosedMock):
    """A robot whose link breaks at a time of its clock."""

    def read(self) -> RobotState:
        if self.clock.now_s > 2.0:
            raise RobotFaultError("the link is gone; check the cable")
        return super().read()


def test_a_fault_of_the_robot_is_raised_and_what_was_logged_is_kept() -> None:
    seen: list[tuple[int, int]] = []
    log = TickLog()
    watching = Calling(lambda _, first, last: seen.append((first, last)))
    with Guard(_Dying()) as guard, pytest.raises(RobotFaultError, match="check the cable"):
        run_trial(guard, TrialPlan(gait=gait_of(shipped()), duration_s=30), recorders=(log, watching))
    assert len(log) == 100
    assert seen[-1][1] == 100


def test_a_clock_that_skips_points_does_not_stretch_the_walk() -> None:
    """Every tick's work takes two and a half periods: the gait keeps to the time, not to the ticks."""
    servos, log = PosedMock(), TickLog()

    def work() -> bool:
        servos.time.work(0.05)
        return False

    with Guard(servos) as guard:
        result = run_trial(
            guard, TrialPlan(gait=gait_of(shipped()), duration_s=4), recorders=(log,), stop_requested=work
        )
    rows = log.rows_of("walk")
    assert rows.stop - rows.start < 0.5 * 4 / 0.02
    assert result.duration_s == pytest.approx(4, abs=0.06)
    assert servos.clock.overruns > 50
