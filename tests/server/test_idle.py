"""A robot without commands holds its pose, sits down, and goes limp; and when it counts as at rest."""

import numpy as np
import pytest

from hexctl.backends.clock import PERIOD_S
from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.server.idle import IdleSupervisor, RestWatch
from tests.control.posed import connected, send
from tests.robots import ROBOT_NAMES, shipped


def test_joints_that_move_are_not_at_rest_and_those_that_tremble_are() -> None:
    watch, at_s = RestWatch(), 0.0
    angles_rad = np.zeros(18)

    def look(times: int, step_rad: float, noise_rad: float = 0.0) -> bool:
        nonlocal at_s
        for tick in range(times):
            at_s += 0.02
            angles_rad[4] += step_rad
            watch.note(angles_rad + noise_rad * (tick % 2), at_s)
        return watch.at_rest

    assert not look(5, 0.0), "too little was seen"
    assert look(10, 0.0)
    assert not look(10, 0.005)
    assert not look(5, 0.0), "it has moved of late"
    assert look(10, 0.0, noise_rad=0.005)


def test_unknown_and_unreached_joints_and_one_array_that_changes_are_not_at_rest() -> None:
    unknown, moving, unreached = RestWatch(), RestWatch(), RestWatch()
    angles_rad = np.zeros(18)
    for tick in range(20):
        angles_rad += 0.01
        moving.note(angles_rad, 0.02 * tick)
        unknown.note(np.full(18, np.nan), 0.02 * tick)
        # What is told of them is of before, and does not change however they move.
        unreached.note(np.zeros(18), 0.02 * tick, reached=tick < 15)
        assert unreached.at_rest == (10 <= tick < 15)
    assert not moving.at_rest
    assert not unknown.at_rest


class Idle:
    """A robot that was commanded once, unless told otherwise, and sits down after a second."""

    def __init__(self, *, commanded: bool = True) -> None:
        self.guard, self.servos = connected()
        self.posture = IdleSupervisor(self.guard, sit_after_s=1.0)
        if commanded:
            self.command()

    def command(self) -> None:
        send(self.guard, self.guard.robot.stance_angles_rad)
        self.posture.commanded(self.guard.clock.now_s)

    def after(self, duration_s: float) -> tuple[str, int]:
        """What it does after a time, and how many targets it has sent so far."""
        for _ in range(round(duration_s / PERIOD_S)):
            self.guard.clock.tick()
            self.guard.read()
            self.posture.tick(self.guard.clock.now_s)
        return self.posture.name, len(self.servos.sent)


def test_it_holds_after_silence_then_sits_within_limits_and_relaxes() -> None:
    idle = Idle()
    robot = idle.guard.robot
    posture, n_before = idle.after(0.5)
    assert (idle.guard.stopped, posture) == ("expired", "holding")
    assert idle.after(0.6)[0] == "sitting"
    assert idle.after(SITTING_S + 0.1)[0] == "limp"
    assert idle.servos.limp
    sat = np.array([targets.joint_positions_rad for targets in list(idle.servos.sent)[n_before:]])
    np.testing.assert_allclose(sat[-1], sitting_angles_rad(robot), atol=0.05)
    assert (np.abs(np.diff(sat, axis=0)) <= robot.joint_max_speed_rad_s * PERIOD_S + 1e-9).all()
    assert idle.guard.stopped == "expired"


def test_before_the_first_command_nothing_moves() -> None:
    assert Idle(commanded=False).after(5.0) == ("idle", 0)


def test_after_any_other_stop_it_holds_for_good_and_after_the_clear_until_the_next_command() -> None:
    idle = Idle()
    idle.guard.stop("estop")
    assert idle.after(60.0) == ("holding", 1)
    idle.guard.clear()
    assert idle.after(30.0) == ("idle", 1)
    assert not idle.servos.limp
    idle.command()
    assert idle.after(5.0)[0] == "limp"


@pytest.mark.parametrize(("reason", "sits_s"), [("expired", 1.5), ("hot: leg 2 femur 72 C", 0.5)])
def test_a_stop_while_it_sits_down_ends_the_motion(reason: str, sits_s: float) -> None:
    idle = Idle()
    idle.guard.stop(reason)
    posture, n_before = idle.after(sits_s)
    assert posture == "sitting"
    idle.guard.stop("estop")
    assert idle.after(5.0) == ("holding", n_before)
    assert not idle.servos.limp


def test_with_hot_servos_it_sits_at_once_and_goes_limp() -> None:
    idle = Idle()
    idle.guard.stop("hot: leg 2 femur 72 C")
    assert idle.after(0.1)[0] == "sitting"
    assert idle.after(SITTING_S + 0.1)[0] == "limp"
    assert idle.servos.limp
    sat = idle.servos.sent[-1].joint_positions_rad
    np.testing.assert_allclose(sat, sitting_angles_rad(idle.guard.robot), atol=0.05)


@pytest.mark.parametrize(
    ("left_s", "before", "soon", "later"),
    [
        (0.9, "commanded", "commanded", "limp"),  # it is given as long as a command
        (1.5, "sitting", "holding", "limp"),  # it stops at that
        (1.5 + SITTING_S, "limp", "limp", "limp"),  # and moves no limp robot
    ],
)
def test_a_robot_that_was_left_in_good_order_waits_for_the_controller_that_comes(
    left_s: float, before: str, soon: str, later: str
) -> None:
    idle = Idle()
    idle.guard.pause_watchdog()
    posture, n_before = idle.after(left_s)
    assert (posture, idle.guard.stopped) == (before, None)
    idle.posture.controlled(idle.guard.clock.now_s)
    assert idle.after(0.9) == (soon, n_before)
    assert idle.after(SITTING_S + 0.3)[0] == later


def test_a_command_ends_the_sitting() -> None:
    idle = Idle()
    idle.after(1.5)
    idle.guard.clear()
    idle.command()
    assert idle.after(0.02)[0] == "commanded"


def test_every_shipped_robot_sits_elsewhere_than_it_stands_within_its_ranges() -> None:
    for name in ROBOT_NAMES:
        robot = shipped(name)
        pose = sitting_angles_rad(robot)
        assert (pose >= robot.joint_lower_rad).all()
        assert (pose <= robot.joint_upper_rad).all()
        assert not np.allclose(pose, robot.stance_angles_rad)
