"""The guard: range, speed, freshness, silence, falls, a broken link, and a stop that stays."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl import EStopError, Guard, InputError, JointTargets, LegServos, RobotFaultError, SimServos
from hexctl.backends.mock import MockServos
from hexctl.control.controllers import Walk
from hexctl.control.guard import POSE_EXPIRY_S, StepLimits, leaning
from hexctl.errors import CommandRefusedError
from hexctl.gait.gait import Motion, make_gait
from hexctl.robot.rotations import quaternion_about
from hexctl.testing.servo_conformance import LegServosConformance, move
from hexctl.types import FloatArray
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


# Range and speed


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


angle = st.floats(-4, 4)


@given(wanted=st.lists(angle, min_size=18, max_size=18), accepted=st.lists(angle, min_size=18, max_size=18))
def test_one_joint_at_a_time_it_is_range_first_and_then_speed(
    wanted: list[float], accepted: list[float]
) -> None:
    robot = shipped("phantomx")
    limits = StepLimits.of(robot, 0.02)
    got = limits.apply(np.array(wanted), np.array(accepted))
    for joint in range(18):
        step = float(robot.joint_max_speed_rad_s[joint]) * 0.02
        target = min(max(wanted[joint], robot.joint_lower_rad[joint]), robot.joint_upper_rad[joint])
        target = min(max(target, accepted[joint] - step), accepted[joint] + step)
        assert got[joint] == target


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


def test_a_burst_that_swings_stays_within_one_step_to_either_side_a_step_at_a_time() -> None:
    guard, _ = connected()
    for _ in range(5):
        np.testing.assert_allclose(send(guard, STANCE + 1.0), STANCE + STEP)
        np.testing.assert_allclose(send(guard, STANCE - 1.0), STANCE, atol=1e-12)
        np.testing.assert_allclose(send(guard, STANCE - 1.0), STANCE - STEP)
        np.testing.assert_allclose(send(guard, STANCE + 1.0), STANCE, atol=1e-12)


@given(
    bursts=st.lists(
        st.lists(st.tuples(st.floats(-4, 4), st.floats(0, 0.03)), max_size=8), min_size=1, max_size=12
    )
)
def test_whatever_is_written_whenever_the_joints_go_no_faster_than_they_may(
    bursts: list[list[tuple[float, float]]],
) -> None:
    guard, servos = connected()
    began_s = servos.time.now_s
    for burst in bursts:
        for wanted, pause_s in burst:
            sent = send(guard, np.full(18, wanted))
            periods = math.floor((servos.time.now_s - began_s) / 0.02 + 1e-6) + 1
            assert (np.abs(sent - STANCE) <= periods * STEP + 1e-9).all()
            servos.time.work(pause_s)
        guard.clock.tick()


def test_ticks_that_come_late_are_clipped_no_more_than_ticks_on_time() -> None:
    """A late tick and the next one on time are nearer to one another than a period."""
    guard, servos = connected()
    direction = np.where(ANT.joint_upper_rad > STANCE + 6 * STEP, 0.99, -0.99)
    for step in range(1, 7):
        servos.time.work(0.017 if step % 2 else 0.001)
        wanted = STANCE + step * direction * STEP
        np.testing.assert_array_equal(send(guard, wanted), wanted)
        guard.clock.tick()
    assert guard.counters.clipped == 0


def test_where_the_joints_are_is_asked_once_and_is_then_what_was_accepted() -> None:
    guard, servos = connected()
    np.testing.assert_array_equal(guard.accepted_rad(), STANCE)
    sent = send(guard, STANCE + 1.0)
    servos.joints_rad = STANCE - 0.5  # a measurement that lags behind
    np.testing.assert_array_equal(guard.accepted_rad(), sent)


# Commands that are not passed on


@pytest.mark.parametrize("bad", [math.nan, math.inf, -math.inf])
def test_targets_that_are_not_finite_are_refused_and_the_last_stay_in_force(bad: float) -> None:
    guard, servos = connected()
    send(guard, STANCE + 0.05)
    wanted = STANCE + 0.05
    wanted[7] = bad
    with pytest.raises(CommandRefusedError):
        send(guard, wanted)
    assert len(servos.sent) == 1
    assert (guard.counters.accepted, guard.counters.refused) == (1, 1)
    guard.clock.tick()
    np.testing.assert_array_equal(send(guard, STANCE + 0.06), STANCE + 0.06)


@pytest.mark.parametrize(
    ("age_s", "accepted"),
    [
        (0.0, True),
        (0.1999, True),
        (0.2001, False),
        (100.0, False),
        (-0.0199, True),  # ahead by a period at most
        (-0.0201, False),
        (math.nan, False),
    ],
)
def test_a_stale_command_is_refused(age_s: float, accepted: bool) -> None:
    guard, servos = connected()
    command = JointTargets(STANCE, guard.clock.now_s - age_s)
    if accepted:
        guard.write(command)
    else:
        with pytest.raises(CommandRefusedError):
            guard.write(command)
    assert (len(servos.sent), guard.counters.refused) == (accepted, not accepted)


def test_the_expiry_has_no_off() -> None:
    Guard(PosedMock(), expiry_s=1.0)
    for expiry_s in (0.0, -1.0, 1.01, math.inf, math.nan):
        with pytest.raises(InputError, match="expiry"):
            Guard(PosedMock(), expiry_s=expiry_s)


# States that stop the robot


@pytest.mark.parametrize("part", ["joints", "position", "quaternion", "age"])
def test_a_state_that_says_nothing_stops_the_robot(part: str) -> None:
    guard, servos = connected()
    guard.read()
    send(guard, STANCE)
    servos.spoil(part)
    guard.read()
    assert guard.stopped == "state"
    with pytest.raises(EStopError):
        send(guard, STANCE)
    assert len(servos.sent) == 1


@pytest.mark.parametrize(("age_s", "reason"), [(0.2, None), (0.201, "state"), (math.nan, "state")])
def test_a_state_may_be_as_old_as_a_command(age_s: float, reason: str | None) -> None:
    guard, servos = connected()
    servos.age_s = age_s
    guard.read()
    assert guard.stopped == reason


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


def test_half_a_pose_that_is_gone_is_a_pose_lost_and_an_inertial_sensor_alone_tells_of_a_fall() -> None:
    guard, servos = connected()
    guard.read()
    servos.position_world = None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped == "pose lost"
    guard.clear()
    guard.read()
    assert guard.stopped is None
    servos.lean(60)
    for _ in range(100):
        guard.read()
    assert guard.stopped == "fell"
    guard.clear()
    servos.lean(0)
    guard.read()
    assert guard.stopped is None
    servos.quaternion_world = None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped == "pose lost"


def swing(guard: Guard, duration_s: float, legs: int = 6) -> None:
    """Read, and let so many legs swing, for a duration."""
    for tick in range(round(duration_s / 0.02)):
        guard.clock.tick()
        guard.read()
        if guard.stopped is None:
            send(guard, STANCE + 0.2 * math.sin(0.2 * tick) * (np.arange(18) < 3 * legs))


def stand(guard: Guard, duration_s: float) -> None:
    """Read, and command the stance, for a duration."""
    for _ in range(round(duration_s / 0.02)):
        guard.clock.tick()
        guard.read()
        send(guard, STANCE)


@pytest.mark.parametrize("part", ["position_world", "quaternion_world"])
def test_a_pose_that_repeats_itself_is_lost_while_the_legs_move(part: str) -> None:
    guard, servos = connected()
    setattr(servos, part, None)
    swing(guard, 2 * POSE_EXPIRY_S)
    assert guard.stopped is None
    servos.frozen = True
    swing(guard, POSE_EXPIRY_S - 2.1)
    stand(guard, 20.0)  # its pose repeats
    pose = servos.position_world, servos.quaternion_world
    servos.position_world = servos.quaternion_world = None
    stand(guard, 2.0)  # a gap counts at rest too
    servos.position_world, servos.quaternion_world = pose
    stand(guard, 20.0)
    assert guard.stopped is None
    swing(guard, 0.3)
    assert guard.stopped == "pose lost"


def test_a_position_may_repeat_itself_while_the_body_turns_in_place() -> None:
    guard, servos = connected()
    servos.frozen = True
    for tick in range(round(2 * POSE_EXPIRY_S / 0.02)):
        servos.quaternion_world = quaternion_about((0, 0, 1), 0.001 * tick)
        guard.clock.tick()
        guard.read()
        send(guard, STANCE + 0.2 * math.sin(0.2 * tick))


@pytest.mark.parametrize(("legs", "stopped"), [(2, None), (3, "state"), (6, "state")])
def test_angles_that_repeat_while_three_legs_move_are_no_state(legs: int, stopped: str | None) -> None:
    guard, servos = connected()
    swing(guard, 1.0, legs)
    stand(guard, 1.0)
    servos.joints_rad = STANCE
    stand(guard, 1.0)  # its angles repeat, and may lag behind the first targets afterwards
    swing(guard, 0.4, legs)
    assert guard.stopped is None
    swing(guard, 0.4, legs)
    assert guard.stopped == stopped


@pytest.mark.parametrize("period", [1, 40], ids=["steady", "interrupted"])
@pytest.mark.parametrize(("share", "known"), [(0.0, False), (0.2, True), (1.0, True)])
def test_a_position_that_stands_while_the_legs_walk_is_none(share: float, known: bool, period: int) -> None:
    guard, servos = connected()
    walk = Walk(ANT, make_gait(ANT, "tripod"), Motion(), period_s=0.02)
    for step in range(400):  # 8 s, about 1 m
        guard.clock.tick()
        noise_m = 0.002 * math.sin(1.7 * step)
        shown = np.array([share * 0.13 * 0.02 * step + noise_m, 0.0, 0.1])
        servos.position_world = shown if (step + 1) % period < 10 else None
        state = guard.read()
        send(guard, walk.targets_rad(step, state))
    assert (state.base_position_world is not None) is known
    servos.position_world = np.array([1.04 * share + 0.1, 0.0, 0.1])
    assert guard.peek().base_position_world is not None


@pytest.mark.parametrize("known_before", [False, True])
def test_a_pose_that_was_not_known_since_the_robot_was_cleared_is_not_lost(known_before: bool) -> None:
    guard, servos = connected()
    if known_before:
        guard.read()
        guard.stop("by hand")
        guard.clear()
    servos.position_world = servos.quaternion_world = None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped is None


def test_a_robot_that_does_not_know_its_joints_is_not_moved() -> None:
    guard, servos = connected()
    servos.joints_rad = np.full(18, math.inf)
    for call in (guard.accepted_rad, lambda: send(guard, STANCE)):
        with pytest.raises(RobotFaultError):
            call()
    assert len(servos.sent) == 0


def test_silence_after_a_command_freezes_the_robot() -> None:
    guard, servos = connected()
    send(guard, STANCE)
    servos.time.work(0.19)
    guard.read()
    assert guard.stopped is None
    servos.time.work(0.02)
    guard.read()
    assert guard.stopped == "expired"
    with pytest.raises(EStopError):
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


@pytest.mark.parametrize(
    ("degrees", "leans"), [(0, False), (49, False), (51, True), (-51, True), (180, True)]
)
def test_a_body_leans_beyond_fifty_degrees(degrees: float, leans: bool) -> None:
    around = [quaternion_about(axis, math.radians(degrees)) for axis in ((1, 0, 0), (0, 1, 0))]
    assert leaning(np.stack(around)).tolist() == [leans, leans]


def test_how_long_the_body_has_leant_is_known_and_forgotten() -> None:
    guard, servos = connected()
    servos.lean(60)
    for ticks in range(1, 5):
        guard.read()
        assert guard.leaning_ticks == ticks
    servos.lean(0)
    guard.read()
    assert guard.leaning_ticks == 0
    servos.lean(60)
    guard.read()
    guard.clear()
    assert guard.leaning_ticks == 0


@pytest.mark.parametrize(
    ("degrees", "stopped"), [(np.nan, None), (67.9, None), (68.0, "hot: leg 2 femur 68 C")]
)
def test_a_servo_that_is_too_hot_stops_the_robot_which_may_then_sit(
    degrees: float, stopped: str | None
) -> None:
    guard, servos = connected()
    send(guard, STANCE)
    servos.temperatures_c = np.full(18, 40.0)
    servos.temperatures_c[3:5] = np.nan, degrees
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


@pytest.mark.parametrize(
    ("said", "stopped"),
    [
        ({"healthy": False}, "fault"),
        ({"healthy": False, "fault": "low battery"}, "fault: low battery"),
        ({"own_stop": "fell"}, "fell"),
    ],
)
def test_a_fault_or_a_stop_that_the_robot_reports_stops_it_until_it_is_cleared(
    said: dict[str, object], stopped: str
) -> None:
    guard, servos = connected()
    with pytest.MonkeyPatch.context() as patch:
        for name, value in said.items():
            patch.setattr(servos, name, value)
        guard.read()
    guard.read()
    assert guard.stopped == stopped
    with pytest.raises(EStopError):
        send(guard, STANCE)


# The stop


def test_a_stop_stays_until_it_is_cleared_and_keeps_its_first_reason() -> None:
    guard, servos = connected()
    send(guard, STANCE)
    guard.stop("by hand")
    guard.stop("again")
    for _ in range(3):
        guard.clock.tick()
        guard.read()
        assert guard.stopped == "by hand"
        with pytest.raises(EStopError):
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
    guard.pause_watchdog()
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


# The link, and pauses that are no silence


@pytest.mark.parametrize("broken", [BrokenPipeError("pipe"), TimeoutError("late"), OSError(5, "io")])
def test_a_link_that_breaks_is_a_fault_of_the_robot_wherever_it_is_used(
    broken: OSError, monkeypatch: pytest.MonkeyPatch
) -> None:
    guard, servos = connected()
    send(guard, STANCE)
    servos.fail_with(broken)
    monkeypatch.setattr(servos, "pause_watchdog", servos.read)
    monkeypatch.setattr(servos, "disable_torque", servos.read)
    uses = (guard.read, lambda: send(guard, STANCE), guard.pause_watchdog, guard.disable_torque)
    for call in (*uses, guard.close, guard.connect):
        with pytest.raises(RobotFaultError) as failed:
            call()
        assert failed.value.__cause__ is broken
    assert guard.counters.accepted == 1


def test_an_error_of_hexctl_passes_the_guard_as_it_is() -> None:
    guard, servos = connected()
    servos.fail_with(RobotFaultError("the battery is empty"))
    for call in (guard.connect, guard.read, guard.close, lambda: send(guard, STANCE)):
        with pytest.raises(RobotFaultError, match=r"^the battery is empty$"):
            call()


def test_a_rest_is_neither_silence_nor_overrun_and_ends_with_the_next_command() -> None:
    guard, servos = connected()
    send(guard, STANCE)
    guard.pause_watchdog()
    servos.time.work(60.0)
    guard.read()
    assert guard.stopped is None
    guard.clock.tick()
    send(guard, STANCE)
    assert guard.clock.overruns == 0
    servos.time.work(0.3)
    guard.read()
    assert guard.stopped == "expired"


def test_a_pause_makes_no_pose_too_old() -> None:
    guard, servos = connected()
    guard.read()
    guard.pause_watchdog()
    for _ in range(round((POSE_EXPIRY_S + 1) / guard.clock.period_s)):
        guard.clock.tick()
    guard.pause_watchdog()
    servos.position_world = servos.quaternion_world = None
    guard.read()
    assert guard.stopped is None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped == "pose lost"
