"""The guard and the link to the robot: what breaks, what gets too old, and pauses that are no silence."""

import math

import numpy as np
import pytest

from hexctl.control.guard import POSE_EXPIRY_S, Guard
from hexctl.errors import CommandRefusedError, EStopError, RobotFaultError
from hexctl.types import JointTargets
from tests.control.posed import PosedMock, read_for
from tests.robots import shipped

STANCE = shipped().stance_angles_rad


def _connected() -> tuple[Guard, PosedMock]:
    servos = PosedMock()
    guard = Guard(servos)
    guard.connect()
    guard.clock.tick()
    return guard, servos


def _send(guard: Guard) -> None:
    guard.write(JointTargets(STANCE, guard.clock.now_s))


@pytest.mark.parametrize("broken", [BrokenPipeError("pipe"), OSError(5, "input/output error")])
def test_a_link_that_breaks_is_a_fault_of_the_robot_wherever_it_is_used(broken: OSError) -> None:
    guard, servos = _connected()
    _send(guard)
    servos.fail_with(broken)
    with pytest.raises(RobotFaultError, match="the link to the robot failed") as failed:
        guard.read()
    assert failed.value.__cause__ is broken
    with pytest.raises(RobotFaultError, match="the link to the robot failed"):
        _send(guard)
    with pytest.raises(RobotFaultError, match="the link to the robot failed"):
        guard.close()
    with pytest.raises(RobotFaultError, match="the robot cannot be reached"):
        guard.connect()
    assert guard.counters.accepted == 1


class Unplugged(PosedMock):
    """A board whose calls beside read and write fail."""

    def pause_watchdog(self) -> None:
        raise BrokenPipeError("pipe")

    def disable_torque(self) -> bool:
        raise BrokenPipeError("pipe")


def test_a_link_that_breaks_at_a_pause_or_at_the_torque_is_a_fault_of_the_robot() -> None:
    guard = Guard(Unplugged())
    guard.connect()
    for call in (guard.pause_watchdog, guard.disable_torque):
        with pytest.raises(RobotFaultError, match=r"^the link to the robot failed: pipe$"):
            call()


def test_an_error_of_hexctl_passes_the_guard_as_it_is() -> None:
    guard, servos = _connected()
    servos.fail_with(RobotFaultError("the battery is empty"))
    for call in (guard.connect, guard.read, guard.close, lambda: _send(guard)):
        with pytest.raises(RobotFaultError, match=r"^the battery is empty$"):
            call()


@pytest.mark.parametrize(("ahead_s", "accepted"), [(0.0199, True), (0.0201, False), (3600.0, False)])
def test_a_command_may_be_ahead_by_a_period_and_no_more(ahead_s: float, accepted: bool) -> None:
    guard, servos = _connected()
    early = JointTargets(STANCE, guard.clock.now_s + ahead_s)
    if accepted:
        guard.write(early)
        return
    with pytest.raises(CommandRefusedError, match=r"got -.* s old; allowed: 0 to 0.2 s"):
        guard.write(early)
    assert not servos.sent
    assert guard.counters.refused == 1


@pytest.mark.parametrize("part", ["joints", "position", "quaternion", "age"])
def test_a_state_that_says_nothing_lets_no_command_pass(part: str) -> None:
    guard, servos = _connected()
    guard.read()
    _send(guard)
    servos.spoil(part)
    guard.read()
    with pytest.raises(EStopError, match="stopped: state"):
        _send(guard)
    assert len(servos.sent) == 1


@pytest.mark.parametrize(("age_s", "reason"), [(0.2, None), (0.201, "state"), (math.nan, "state")])
def test_a_state_may_be_as_old_as_a_command(age_s: float, reason: str | None) -> None:
    guard, servos = _connected()
    servos.age_s = age_s
    guard.read()
    assert guard.stopped == reason


def test_half_a_pose_that_is_gone_is_a_pose_lost() -> None:
    guard, servos = _connected()
    guard.read()
    servos.position_world = None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped == "pose lost"


def test_an_inertial_sensor_alone_tells_of_a_fall_and_that_it_has_gone() -> None:
    guard, servos = _connected()
    servos.position_world = None
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


def test_a_robot_that_never_knew_a_pose_has_not_lost_one() -> None:
    guard, servos = _connected()
    servos.position_world = servos.quaternion_world = None
    guard.read()
    assert guard.stopped is None


def test_a_pose_known_before_the_robot_was_cleared_may_be_gone_afterwards() -> None:
    guard, servos = _connected()
    guard.read()
    guard.stop("by hand")
    guard.clear()
    servos.position_world = servos.quaternion_world = None
    read_for(guard, POSE_EXPIRY_S + 0.1)
    assert guard.stopped is None


def test_how_long_the_body_has_leant_is_known_and_forgotten() -> None:
    guard, servos = _connected()
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


def test_a_rest_is_neither_silence_nor_overrun_and_ends_with_the_next_command() -> None:
    guard, servos = _connected()
    _send(guard)
    guard.pause_watchdog()
    servos.time.work(60.0)
    guard.read()
    assert guard.stopped is None
    guard.clock.tick()
    _send(guard)
    assert guard.clock.overruns == 0
    servos.time.work(0.3)
    guard.read()
    assert guard.stopped == "expired"


def test_a_rest_does_not_lift_a_stop() -> None:
    guard, _ = _connected()
    guard.stop("by hand")
    guard.pause_watchdog()
    with pytest.raises(EStopError, match="by hand"):
        _send(guard)


def test_a_robot_that_does_not_know_its_joints_says_so() -> None:
    guard, servos = _connected()
    servos.joints_rad = np.full(18, math.inf)
    with pytest.raises(RobotFaultError, match="not finite; check its sensors"):
        guard.accepted_rad()


def test_a_pause_makes_no_pose_too_old() -> None:
    guard, servos = _connected()
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
