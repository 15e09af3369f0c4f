"""The guard: range, speed, freshness, silence, falls, and a stop that stays."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.base import LegServos
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import POSE_EXPIRY_S, Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import CommandRefusedError, EStopError, InputError, RobotFaultError
from hexctl.gait.gait import make_gait
from hexctl.testing.servo_conformance import LegServosConformance, move
from hexctl.types import FloatArray, JointTargets, RobotState, ServoReadings
from tests.backends.fake_time import FakeTime
from tests.control.posed import PosedMock, connected, read_for, send
from tests.robots import ROBOT_NAMES, shipped

ANT = shipped()
STANCE = ANT.stance_angles_rad
STEP = ANT.joint_max_speed_rad_s * 0.02


class TestGuardedMock(LegServosConformance):
    def make(self) -> LegServos:
        return Guard(MockServos(ANT, clock=FakeTime().clock()))


class TestGuardedSim(LegServosConformance):
    def make(self) -> LegServos:
        return Guard(SimServos(ANT))


def test_what_is_within_the_limits_passes_unchanged() -> None:
    guard, servos = connected()
    sent = send(guard, STANCE + 0.05)
    np.testing.assert_array_equal(sent, STANCE + 0.05)
    np.testing.assert_array_equal(servos.sent[-1].joint_positions_rad, sent)
    assert (guard.counters.accepted, guard.counters.clipped, guard.counters.refused) == (1, 0, 0)


def test_a_jump_is_slewed_at_the_joints_own_speed_from_the_last_accepted_target() -> None:
    guard, servos = connected()
    wanted = STANCE.copy()
    wanted[0] += 0.5
    steps = []
    for _ in range(6):
        steps.append(send(guard, wanted)[0] - STANCE[0])
        guard.clock.tick()
    np.testing.assert_allclose(steps, np.minimum(np.arange(1, 7) * STEP[0], 0.5))
    assert guard.counters.clipped == 3
    np.testing.assert_array_equal(servos.sent[-1].joint_positions_rad, wanted)


def test_the_first_step_is_measured_from_where_the_joints_are() -> None:
    guard, servos = connected()
    servos.write(JointTargets(STANCE - 0.4, 0.0))
    np.testing.assert_allclose(send(guard, STANCE), STANCE - 0.4 + STEP)


def test_no_target_leaves_the_range_of_its_joint() -> None:
    guard, _ = connected()
    for far, limit in ((100.0, ANT.joint_upper_rad), (-100.0, ANT.joint_lower_rad)):
        for _ in range(60):
            sent = send(guard, np.full(18, far))
            guard.clock.tick()
        np.testing.assert_array_equal(sent, limit)


@pytest.mark.parametrize("side", [-1, 1])
def test_a_joint_found_outside_its_range_comes_back_no_faster_than_it_may(side: int) -> None:
    guard, servos = connected()
    beyond = ANT.joint_upper_rad + 0.5 if side > 0 else ANT.joint_lower_rad - 0.5
    limit = ANT.joint_upper_rad if side > 0 else ANT.joint_lower_rad
    servos.write(JointTargets(beyond, 0.0))
    before = beyond
    for _ in range(20):
        sent = send(guard, STANCE)
        assert (np.abs(sent - before) <= STEP + 1e-12).all()
        assert (side * (sent - before) <= 0).all()
        before = sent
        guard.clock.tick()
    assert (side * (before - limit) <= 0).all()


@given(
    name=st.sampled_from(ROBOT_NAMES),
    sequence=st.lists(
        st.lists(st.floats(-1e6, 1e6) | st.floats(-3, 3), min_size=18, max_size=18), min_size=1, max_size=8
    ),
    skipped=st.integers(0, 3),
)
def test_whatever_is_written_what_is_sent_keeps_range_and_speed(
    name: str, sequence: list[list[float]], skipped: int
) -> None:
    robot = shipped(name)
    servos = PosedMock(robot)
    with Guard(servos) as guard:
        before = robot.stance_angles_rad
        for wanted in sequence:
            guard.clock.tick()
            servos.time.work(0.02 * skipped)
            send(guard, np.array(wanted))
            sent = servos.sent[-1].joint_positions_rad
            assert (sent >= robot.joint_lower_rad).all()
            assert (sent <= robot.joint_upper_rad).all()
            assert (np.abs(sent - before) <= robot.joint_max_speed_rad_s * 0.02 + 1e-12).all()
            before = sent


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_targets_that_are_not_finite_are_refused_and_the_last_stay_in_force(bad: float) -> None:
    guard, servos = connected()
    send(guard, STANCE + 0.05)
    wanted = STANCE + 0.05
    wanted[7] = bad
    with pytest.raises(CommandRefusedError, match="finite"):
        send(guard, wanted)
    assert len(servos.sent) == 1
    assert (guard.counters.accepted, guard.counters.refused) == (1, 1)
    guard.clock.tick()
    np.testing.assert_array_equal(send(guard, STANCE + 0.06), STANCE + 0.06)


@pytest.mark.parametrize(("age_s", "accepted"), [(0.0, True), (0.15, True), (0.25, False), (100.0, False)])
def test_a_stale_command_is_refused(age_s: float, accepted: bool) -> None:
    guard, servos = connected()
    stale = JointTargets(STANCE, guard.clock.now_s)
    servos.time.work(age_s)
    if accepted:
        guard.write(stale)
        return
    with pytest.raises(CommandRefusedError, match=r"got .* s old; allowed: 0 to 0.2 s"):
        guard.write(stale)
    assert len(servos.sent) == 0
    assert guard.counters.refused == 1


def test_a_command_without_a_time_is_refused() -> None:
    guard, servos = connected()
    with pytest.raises(CommandRefusedError):
        guard.write(JointTargets(STANCE, math.nan))
    assert len(servos.sent) == 0


def test_a_command_from_the_future_is_refused() -> None:
    guard, servos = connected()
    guard.write(JointTargets(STANCE, guard.clock.now_s + 0.015))
    with pytest.raises(CommandRefusedError, match="old"):
        guard.write(JointTargets(STANCE, guard.clock.now_s + 0.5))
    assert len(servos.sent) == 1


def test_many_commands_in_one_period_move_no_further_than_one() -> None:
    guard, _ = connected()
    step = guard.robot.joint_max_speed_rad_s * 0.02
    for _ in range(3):
        guard.clock.tick()
        before = guard.accepted_rad().copy()
        for _ in range(6):
            sent = send(guard, STANCE + 0.5)
        np.testing.assert_allclose(sent - before, np.minimum(step, STANCE + 0.5 - before), atol=1e-12)


@given(
    offsets=st.lists(st.lists(st.floats(-0.5, 0.5), min_size=1, max_size=4), min_size=1, max_size=5),
    found_at=st.sampled_from([STANCE, ANT.joint_upper_rad + 10 * STEP, ANT.joint_lower_rad - 10 * STEP]),
)
def test_whatever_comes_within_periods_each_servo_is_told_a_step_at_a_time(
    offsets: list[list[float]], found_at: FloatArray
) -> None:
    guard, servos = connected()
    servos.write(JointTargets(found_at, 0.0))
    servos.sent.clear()
    told = [send(guard, found_at)]
    for period in offsets:
        guard.clock.tick()
        before = told[-1]
        for offset in period:
            told.append(send(guard, STANCE + offset))
            assert (np.abs(told[-1] - before) <= STEP + 1e-12).all()
    assert (np.abs(np.diff(told, axis=0)) <= STEP + 1e-12).all()
    assert len(servos.sent) == len(told)


@pytest.mark.parametrize("expiry_s", [0.0, -1.0, 1.5, math.inf, math.nan])
def test_the_expiry_has_no_off(expiry_s: float) -> None:
    with pytest.raises(InputError, match="expiry"):
        Guard(PosedMock(), expiry_s=expiry_s)


def test_two_trials_with_a_pause_between_them() -> None:
    guard, servos = connected()
    plan = TrialPlan(gait=make_gait(guard.robot, "tripod"), duration_s=1)
    for _ in range(2):
        result = run_trial(guard, plan)
        assert (result.status, result.stopped) == ("ok", None)
        servos.time.work(7.3)
    assert guard.clock.overruns == 0


@pytest.mark.parametrize("part", ["joints", "position", "quaternion", "age"])
def test_a_state_that_says_nothing_stops_the_robot(part: str) -> None:
    guard, servos = connected()
    guard.read()
    servos.spoil(part)
    guard.read()
    assert guard.stopped == "state"


def test_a_pose_that_is_gone_stops_the_robot_unless_it_comes_back_in_time() -> None:
    guard, servos = connected()
    guard.read()
    pose = servos.position_world, servos.quaternion_world
    for _ in range(3):
        servos.position_world = servos.quaternion_world = None
        read_for(guard, POSE_EXPIRY_S - 0.1)
        assert guard.stopped is None
        servos.position_world, servos.quaternion_world = pose
        read_for(guard, 0.1)
    servos.position_world = servos.quaternion_world = None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped == "pose lost"


def test_a_robot_that_does_not_know_its_joints_is_not_moved() -> None:
    guard, servos = connected()
    servos.spoil("joints")
    with pytest.raises(RobotFaultError, match="not finite"):
        send(guard, STANCE)
    assert len(servos.sent) == 0


@pytest.mark.parametrize("error", [BrokenPipeError("gone"), TimeoutError("late"), OSError("port")])
def test_a_link_that_fails_is_a_fault_of_the_robot(error: OSError) -> None:
    guard, servos = connected()
    servos.fail_with(error)
    with pytest.raises(RobotFaultError, match="link"):
        guard.read()


def test_silence_after_a_command_freezes_the_robot() -> None:
    guard, servos = connected()
    send(guard, STANCE)
    servos.time.work(0.19)
    guard.read()
    assert guard.stopped is None
    servos.time.work(0.02)
    guard.read()
    assert guard.stopped == "expired"
    with pytest.raises(EStopError, match=r"expired.*clear"):
        send(guard, STANCE)


def test_silence_before_the_first_command_is_no_fault() -> None:
    guard, servos = connected()
    servos.time.work(10)
    guard.read()
    assert guard.stopped is None


def test_after_clearing_silence_counts_from_the_next_command() -> None:
    guard, servos = connected()
    send(guard, STANCE)
    servos.time.work(1.0)
    guard.read()
    assert guard.stopped == "expired"
    guard.clear()
    guard.clock.tick()
    guard.read()
    assert guard.stopped is None, "or no client could continue after a silence"
    send(guard, STANCE)
    servos.time.work(0.3)
    guard.read()
    assert guard.stopped == "expired"


def test_a_body_that_leans_too_far_for_a_fifth_of_a_second_has_fallen() -> None:
    guard, servos = connected()
    servos.lean(60)
    for _ in range(9):
        guard.read()
    servos.lean(40)
    guard.read()
    servos.lean(60)
    for _ in range(9):
        guard.read()
    assert guard.stopped is None, "each lean was short"
    guard.read()
    assert guard.stopped == "fell"


@pytest.mark.parametrize("degrees", [-120, -60, 60, 180])
def test_a_fall_to_any_side_is_one(degrees: float) -> None:
    guard, servos = connected()
    servos.lean(degrees)
    for _ in range(10):
        guard.read()
    assert guard.stopped == "fell"


def test_a_robot_that_lies_on_its_back_in_the_simulation_has_fallen() -> None:
    servos = SimServos(ANT)
    with Guard(servos) as guard:
        servos.compiled.physics.data.qpos[3:7] = [0, 1, 0, 0]
        for _ in range(9):
            guard.clock.tick()
            guard.read()
            send(guard, STANCE)
        guard.clock.tick()
        guard.read()
        with pytest.raises(EStopError, match="fell"):
            send(guard, STANCE)


def _with_temperature(servos: PosedMock, joint: int, degrees: float) -> None:
    """Let the servos report temperatures: one of them another than the rest."""
    read, unknown = servos.read, np.full(18, np.nan)
    temperatures = np.full(18, 40.0)
    temperatures[joint] = degrees

    def hot() -> RobotState:
        readings = ServoReadings(
            ages_s=np.zeros(18),
            efforts=unknown,
            currents_a=unknown,
            voltages_v=unknown,
            temperatures_c=temperatures,
        )
        return replace(read(), servos=readings)

    servos.read = hot  # type: ignore[method-assign]


@pytest.mark.parametrize(
    ("degrees", "stopped"), [(np.nan, None), (60.0, None), (72.0, "hot: leg2 femur 72 C")]
)
def test_a_servo_that_is_too_hot_stops_the_robot_which_may_then_sit(
    degrees: float, stopped: str | None
) -> None:
    guard, servos = connected()
    send(guard, STANCE)
    _with_temperature(servos, 4, degrees)
    guard.read()
    assert guard.stopped == stopped
    if stopped is not None:
        with pytest.raises(EStopError):
            send(guard, STANCE)
        guard.write_while_timed_out(JointTargets(STANCE + 0.01, guard.clock.now_s))
        guard.stop("estop")
        assert guard.stopped == "estop", "which outweighs it"
        with pytest.raises(EStopError):
            guard.write_while_timed_out(JointTargets(STANCE, guard.clock.now_s))


def test_a_fault_that_the_robot_reports_stops_it() -> None:
    guard, servos = connected()
    servos.healthy = False
    guard.read()
    with pytest.raises(EStopError, match="fault"):
        send(guard, STANCE)


def test_a_stop_stays_until_it_is_cleared_and_keeps_its_first_reason() -> None:
    guard, servos = connected()
    send(guard, STANCE)
    guard.stop("by hand")
    guard.stop("again")
    for _ in range(3):
        guard.clock.tick()
        guard.read()
        with pytest.raises(EStopError, match="stopped: by hand; clear"):
            send(guard, STANCE + 0.01)
    assert len(servos.sent) == 1
    assert (guard.counters.accepted, guard.counters.refused) == (1, 3)
    guard.clear()
    guard.clock.tick()
    send(guard, STANCE + 0.01)
    assert len(servos.sent) == 2


def test_a_stop_stays_over_closing_and_connecting_again() -> None:
    guard, _ = connected()
    guard.stop("by hand")
    guard.close()
    guard.connect()
    with pytest.raises(EStopError):
        send(guard, STANCE)


def test_a_robot_that_is_reached_again_starts_anew_from_where_its_joints_are() -> None:
    guard, servos = connected()
    send(guard, STANCE + 0.1)
    guard.close()
    servos.time.work(60.0)
    guard.connect()
    servos.write(JointTargets(STANCE - 0.6, 0.0))  # it was moved in between
    guard.clock.tick()
    guard.read()
    assert guard.stopped is None, "no silence counts without a connection"
    np.testing.assert_allclose(send(guard, STANCE), STANCE - 0.6 + STEP)


def test_after_clearing_the_robot_goes_on_from_where_its_joints_are() -> None:
    guard, servos = connected()
    send(guard, STANCE + 0.1)
    guard.stop("by hand")
    servos.write(JointTargets(STANCE - 0.6, 0.0))  # an operator moves it
    guard.clear()
    guard.clock.tick()
    np.testing.assert_allclose(send(guard, STANCE), STANCE - 0.6 + STEP)


def test_the_simulated_robot_holds_its_last_targets_when_stopped() -> None:
    with Guard(SimServos(ANT)) as guard:
        move(guard, STANCE + 0.1, ticks=30)
        guard.stop("by hand")
        for _ in range(50):
            guard.clock.tick()
        np.testing.assert_allclose(guard.read().joint_positions_rad, STANCE + 0.1, atol=0.03)
