"""Legs fail in mid-walk; the robot notices and walks on along its line. Alone and in batches."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from hexctl import (
    Drive,
    Failure,
    Guard,
    Robot,
    RobotState,
    SimTrial,
    TrialPlan,
    TrialResult,
    make_gait,
    run_sim_trials,
    run_trial,
)
from hexctl.control.batch import run_sim_trial
from hexctl.control.monitor.leg_monitor import Suspicion
from hexctl.control.monitor.monitored_walk import MonitoredWalk, recovering_walk
from hexctl.control.monitor.recovery import Recovery, Response, StopWalking, WalkOn
from hexctl.control.preparation import WalkStart
from hexctl.control.trial import planned_walk
from hexctl.control.trial_plan import GaitChange
from hexctl.control.walks.velocity_walk import VelocityWalk
from hexctl.errors import WrongTypeError
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.robot.failure import NoticedFailure
from hexctl.robot.failure_grammar import parse_failure_event, parse_healing
from hexctl.types import BoolArray
from tests.control.posed import Fault, Faulty
from tests.robots import shipped
from tests.trials import sim_trial

EVENTS = ("5:locked@4.2", "2:limp@4.5", "3:missing@4.8", "1:stuck:femur@4")


def _trial(*events: str, duration_s: float = 10.0, hold: str = "line", **given: Any) -> SimTrial:
    """A tripod on its line; events are failures, and healings as `5@8`."""
    happens = [parse_failure_event(one) if ":" in one else parse_healing(one) for one in events]
    return sim_trial(events=happens, duration_s=duration_s, hold=hold, **given)


class Kept(list[MonitoredWalk]):
    """Makes recovering walks, and keeps them."""

    recovery: Recovery | None = None

    def make(self, start: WalkStart) -> MonitoredWalk:
        self.append(recovering_walk(self.recovery)(start))
        return self[-1]


def _walk(trial: SimTrial, recovery: Recovery | None = None) -> tuple[TrialResult, MonitoredWalk]:
    walks = Kept()
    walks.recovery = recovery
    return run_sim_trial(trial, walks.make), walks[0]


@pytest.fixture(scope="module")
def lost_legs() -> tuple[list[TrialResult], MonitoredWalk]:
    """Walks that lose a leg, and one that does not, led together."""
    walks, trials = Kept(), [*map(_trial, EVENTS), _trial()]
    return run_sim_trials(trials, make_controller=walks.make, apart=True), walks[0]


@pytest.mark.parametrize("place", range(4), ids=EVENTS)
def test_a_leg_dies_and_the_robot_walks_on_along_its_line(
    place: int, lost_legs: tuple[list[TrialResult], MonitoredWalk]
) -> None:
    result, (noticed,) = lost_legs[0][place], lost_legs[1].noticed[place]
    what, at_s = EVENTS[place].split("@")
    failure = noticed.suspicion.failure
    assert ":".join(filter(None, (str(failure.leg), failure.kind, failure.joint))) == what
    assert 0 < noticed.suspicion.step * 0.02 - float(at_s) < 1.2
    assert noticed.response.gait is not None
    assert noticed.response.gait.posture.tucked_legs == (failure.leg,)
    assert result.status == "ok"
    assert result.deviation is not None
    assert result.deviation.max < 0.05
    path_m = result.path_m[:, 0]
    assert path_m[-1] - path_m[300] > 0.7 * (path_m[200] - path_m[0]), "as fast as before"


@pytest.mark.parametrize("kind", ["limp", "locked", "missing"])
def test_a_leg_that_is_dead_before_the_first_step_is_noticed_and_tucked(kind: str) -> None:
    failure = Failure(leg=2, kind=kind)
    trial = replace(_trial(duration_s=3.0, self_rotation="none"), failures=(failure,))
    first = _walk(trial)[1].noticed[0][0]
    assert first.suspicion.failure == failure
    assert first.response.gait is not None
    assert first.response.gait.posture.tucked_legs == (2,)


@pytest.mark.slow
@pytest.mark.parametrize("world", ["rough", "real:3"])
def test_whole_legs_are_left_alone(world: str, lost_legs: tuple[list[TrialResult], MonitoredWalk]) -> None:
    assert lost_legs[1].noticed[4] == []
    assert _walk(_trial(world=world))[1].noticed == ([],)


def test_a_leg_that_the_plan_knows_of_is_not_noticed_again_and_another_is_taken_back_once_it_heals() -> None:
    belief = Failure(leg=2, kind="limp")
    trial = _trial("5:limp@3", "5@6", duration_s=14.0, failure=belief, self_rotation="none")
    first, second = _walk(trial)[1].noticed[0]
    assert first.suspicion.leg == 5
    assert first.response.gait is not None
    assert set(first.response.gait.posture.tucked_legs) >= {5}
    assert (second.healed, second.response.gait) == (True, trial.plan.gait)


@pytest.mark.slow
def test_a_weak_joint_is_named_with_its_share_and_its_leg_walks_on() -> None:
    result, walk = _walk(_trial("2:weak:femur:0.5@5", duration_s=7.5), StopWalking())
    (noticed,) = result.noticed
    assert (noticed.failure.leg, noticed.failure.joint, noticed.did) == (2, "femur", "walked on")
    assert noticed.failure.torque_fraction == pytest.approx(0.5, abs=0.15)
    assert NoticedFailure.from_dict(noticed.to_dict()).in_words == noticed.in_words
    assert result.status == "ok"
    assert not walk.known_failures()


def test_the_robot_can_stop_instead_and_says_why() -> None:
    result, walk = _walk(_trial("5:locked@4"), StopWalking())
    assert result.status == "aborted"
    assert result.stopped == "leg 5 locked"
    assert 4 < result.duration_s < 5.5
    assert len(walk.noticed[0]) == 1


@pytest.mark.slow
def test_a_recovery_stops_one_walk_of_a_batch_and_no_other() -> None:
    trials = [_trial(*events, duration_s=6.0) for events in (["5:locked@3"], [], ["2:limp@4"])]
    together = run_sim_trials(trials, make_controller=recovering_walk(StopWalking()), apart=True)
    assert [result.stopped for result in together] == ["leg 5 locked", None, "leg 2 limp"]
    assert [result.status for result in together] == ["aborted", "ok", "aborted"]
    assert together == [run_sim_trial(trial, recovering_walk(StopWalking())) for trial in trials]


@pytest.mark.slow
def test_each_walk_of_a_batch_recovers_by_itself_as_alone() -> None:
    """Failures at different times, of different legs, and in one moment; worlds with noise and delay."""
    trials = [
        _trial(*events, duration_s=5.0, world=world)
        for events in (["5:locked@3"], ["2:limp@3.4"], [], ["1:missing@3"], ["3:limp@3"])
        for world in ("flat", "real:2")
    ]
    trials.append(_trial("3:limp@3", duration_s=3.5))
    together = run_sim_trials([*trials, trials[0]], make_controller=recovering_walk(), apart=True)
    assert together == [run_sim_trial(trial, recovering_walk()) for trial in [*trials, trials[0]]]


def test_watching_alone_changes_no_walk() -> None:
    trial = _trial("5:locked@3", duration_s=5.0, hold="none")

    def make(start: WalkStart) -> MonitoredWalk:
        walks.append(MonitoredWalk(start, planned_walk(start), WalkOn()))
        return walks[-1]

    walks: list[MonitoredWalk] = []
    assert replace(run_sim_trial(trial, make), noticed=()) == run_sim_trial(trial)
    assert [noticed.suspicion.leg for noticed in walks[0].noticed[0]] == [5]


def test_a_leg_that_heals_is_taken_back_whatever_change_of_gait_was_planned() -> None:
    wave = make_gait(shipped(), "wave", pace_hz=shipped().gait.pace_hz)
    trial = _trial("5:limp@3", "5@8", duration_s=13.0, changes=(GaitChange(gait=wave, at_s=6.0),))
    result, walk = _walk(trial)
    failed, healed = walk.noticed_failures()
    assert (failed.failure.leg, failed.healed, healed.failure.leg, healed.healed) == (5, False, 5, True)
    assert 8 < healed.at_s < 13
    assert healed.did == f"changed to slots {','.join(map(str, wave.slots))}"
    assert isinstance(walk.walk, VelocityWalk)
    assert walk.walk.gaits[0].posture.tucked_legs == ()
    assert result.status == "ok"
    assert result.deviation is not None
    assert result.deviation.max < 0.08


def test_a_second_leg_is_met_in_the_same_way_and_stays_up_after_a_planned_change() -> None:
    wave = make_gait(shipped(), "wave", pace_hz=shipped().gait.pace_hz)
    change = GaitChange(gait=wave, at_s=9.0)
    result, walk = _walk(_trial("5:locked@3", "2:limp@6", duration_s=12.0, changes=(change,)))
    assert [one.suspicion.leg for one in walk.noticed[0]] == [5, 2]
    assert 6 < walk.noticed_failures()[1].at_s < 7.5
    assert walk.noticed[0][1].response.gait is not None
    assert walk.noticed[0][1].response.gait.posture.tucked_legs == (2, 5)
    assert isinstance(walk.walk, VelocityWalk)
    assert walk.walk.gaits[0].posture.tucked_legs == (2, 5)
    assert result.status == "ok"


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["limp", "missing"])
def test_without_two_neighbours_ahead_the_robot_walks_at_half_of_its_speed_or_more(kind: str) -> None:
    trial = _trial(f"1:{kind}@4", f"2:{kind}@4", duration_s=14.0)
    result, walk = _walk(trial)
    assert {one.suspicion.leg for one in walk.noticed[0]} == {1, 2}
    ideal_m = 8.0 * ideal_speed_m_s(shipped(), trial.plan.gait, trial.plan.motion(0.0))
    assert result.path_m[-1, 0] - result.path_m[-400, 0] > 0.5 * ideal_m


@pytest.mark.slow
@pytest.mark.parametrize("legs", [(2, 3), (5, 6)])
def test_a_leg_that_two_lost_ones_overload_is_taken_back(legs: tuple[int, int]) -> None:
    """Its servos have a fifth of their torque: leg 4 does not follow before the others are found missing."""
    _, walk = _walk(_trial(*(f"{leg}:missing@4.3" for leg in legs), world="real:18400", duration_s=8.0))
    accused, first, taken_back, second = walk.noticed[0]
    assert accused.suspicion.leg == taken_back.suspicion.leg == 4
    assert (first.suspicion.leg, taken_back.healed, second.suspicion.leg) == (legs[0], True, legs[1])
    assert walk.why_stopped() is None
    assert tuple(failure.leg for failure in walk.known_failures()) == legs


PLAN = TrialPlan(gait=make_gait(shipped(), "tripod"))


class Accuser:
    """A monitor that accuses one leg at a time."""

    new: BoolArray
    suspected: Suspicion

    def suspicion(self, *_: object) -> Suspicion:
        return self.suspected

    def __getattr__(self, name: str) -> Callable[..., None]:
        return lambda *_, **__: None


def _accused(walk: MonitoredWalk, leg: int, *, stuck: bool = True, step: int = 0) -> None:
    """Let a monitor accuse a leg."""
    walk._monitor = monitor = Accuser()  # type: ignore[assignment]
    failure = Failure(leg=leg, kind="locked" if stuck else "missing")
    evidence = "following" if stuck else "effort"
    monitor.new = np.arange(1, 7) == leg
    monitor.suspected = Suspicion(failure=failure, step=step, evidence=evidence, ratio=2.0)
    walk._respond(step)


@example([(1, 0, True), (2, 11, False), (3, 16, True), (1, 55, True), (4, 27, True)])
@given(st.lists(st.tuples(st.integers(1, 6), st.integers(0, 60), st.booleans()), max_size=12))
def test_accusations_in_any_order_leave_each_leg_believed_once(
    accusations: list[tuple[int, int, bool]],
) -> None:
    start = WalkStart(robot=shipped(), plans=(PLAN,), period_s=0.02)
    walk, step = MonitoredWalk(start, planned_walk(start), WalkOn()), 0
    for leg, later_steps, stuck in accusations:
        if leg in {failure.leg for failure in walk.known_failures()}:
            continue
        step += later_steps
        _accused(walk, leg, stuck=stuck, step=step)
        believed = [failure.leg for failure in walk.known_failures()]
        assert len(set(believed)) == len(believed)


def _walk_with(
    fault: Fault, *events: str, recovery: Recovery | None = None, **plan: Any
) -> tuple[TrialResult, MonitoredWalk]:
    """A walk whose sensors show something else than what is."""
    trial, walks = _trial(*events, **plan), Kept()
    walks.recovery = recovery
    with Guard(Faulty(trial.servos(), fault)) as guard:
        return run_trial(guard, trial.plan, walks.make), walks[0]


@pytest.mark.slow
def test_torques_that_all_vanish_are_not_told_any_more() -> None:
    def vanish(state: RobotState, time_s: float) -> RobotState:
        return replace(state, joint_torques_nm=np.zeros(18)) if time_s >= 5.0 else state

    result, walk = _walk_with(vanish, duration_s=9.0)
    assert (result.status, walk.noticed) == ("ok", ([],))


@pytest.mark.slow
@pytest.mark.parametrize("joint", [3, 4])
def test_a_sensor_that_freezes_costs_a_leg_and_no_fall(joint: int) -> None:
    frozen = list[float]()

    def freeze(state: RobotState, time_s: float) -> RobotState:
        joints_rad = state.joint_positions_rad.copy()
        if time_s >= 5.0:
            frozen.append(joints_rad[joint])
            joints_rad[joint] = frozen[0]
        return replace(state, joint_positions_rad=joints_rad)

    result, walk = _walk_with(freeze, duration_s=9.0)
    assert [one.suspicion.leg for one in walk.noticed[0]] == [2]
    assert result.status == "ok"
    assert result.deviation is not None
    assert abs(result.deviation.final) < 0.03


class Tries(Recovery):
    """Keeps the gait, with a posture to try."""

    def respond(self, robot: Robot, plan: TrialPlan, *_: object) -> Response:
        return Response(gait=plan.gait, tries=(make_gait(robot, "wave"),))


@pytest.mark.slow
def test_a_robot_that_falls_short_tells_its_higher_pace_and_still_finds_a_weak_joint() -> None:
    """Its sensor shows 0.8 of the distance."""

    def shortened(state: RobotState, _time_s: float) -> RobotState:
        assert state.base_position_world is not None
        return replace(state, base_position_world=0.8 * state.base_position_world)

    _, walk = _walk_with(shortened, "5:missing@3", "2:weak:femur:0.4@12", recovery=Tries(), duration_s=16.0)
    assert "recovery: slow on this posture; pace raised to 1.35 Hz" in walk.news()
    assert str(walk.noticed[0][-1].suspicion).startswith("leg 2 femur weak"), "found at that pace too"


class Raises(Recovery):
    """A recovery with a mistake in it."""

    def respond(self, *_: object) -> Response:
        raise ValueError("boom")


class Forgets(Recovery):
    """A recovery that returns nothing."""

    def respond(self, *_: object) -> Response:
        return None  # type: ignore[return-value]


@pytest.mark.parametrize(
    ("recovery", "why"),
    [
        (WalkOn(), None),
        (StopWalking(), "leg 2 locked"),
        (Raises(), "leg 2 locked; recovery Raises: ValueError: boom; HEXCTL_DEBUG=1 shows where"),
        (Forgets(), "leg 2 locked; recovery Forgets: respond gave None; allowed: a Response"),
    ],
)
def test_it_is_named_why_a_walk_stops(recovery: Recovery, why: str | None) -> None:
    start = WalkStart(robot=shipped(), plans=(PLAN,), period_s=0.02)
    walk = MonitoredWalk(start, planned_walk(start), recovery)
    assert walk.why_stopped() is None
    _accused(walk, 2)
    assert walk.why_stopped() == why


class OnSecondThought(Recovery):
    """Walks on with what it hears first of a failure, and in a wave once that is known better."""

    def __init__(self) -> None:
        self.heard: list[Failure] = []

    def respond(
        self, robot: Robot, plan: TrialPlan, heading_body_rad: float, failures: Sequence[Failure]
    ) -> Response:
        """One or the other."""
        self.heard += [failure for failure in failures if failure not in self.heard]
        if len(self.heard) == 1:
            return Response(gait=plan.gait, stays=True, why="why not")
        return Response(gait=make_gait(robot, "wave"))


def test_once_more_is_known_of_a_failure_the_recovery_is_asked_again() -> None:
    """Where a joint is stuck is measured better 0.4 cycles later."""
    recovery = OnSecondThought()
    result, walk = _walk(_trial("2:stuck:tibia@4.6", duration_s=7.0), recovery)
    ((noticed,),) = walk.noticed
    assert len(recovery.heard) == 2
    assert noticed.suspicion.failure == recovery.heard[-1]
    assert isinstance(walk.walk, VelocityWalk)
    assert walk.walk.gaits == [make_gait(shipped(), "wave")]
    (told,) = result.noticed
    assert told.did == "changed to slots 4,5,6,3,2,1"
    assert result.status == "ok"


@pytest.mark.slow
def test_a_leg_on_trial_counts_as_missing_again_when_another_fails() -> None:
    """The monitor is patient then, and would learn that the leg usually carries nothing."""
    _, walk = _walk(_trial("5:missing@3", "6:limp@10.3", duration_s=14.0))
    first, tried, other, again = walk.noticed[0][:4]
    assert (tried.healed, other.suspicion.leg, again.suspicion.failure) == (True, 6, first.suspicion.failure)
    assert tried.suspicion.step < 515 < other.suspicion.step == again.suspicion.step
    assert other.response == again.response
    assert [failure.leg for failure in walk.known_failures()] == [5, 6]


def test_a_class_in_place_of_a_recovery_is_refused_before_a_robot_moves() -> None:
    for use in (recovering_walk, lambda given: Drive("ant", recovery=given)):
        with pytest.raises(WrongTypeError, match="recovery"):
            use(StopWalking)  # type: ignore[arg-type]
