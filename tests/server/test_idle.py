"""A robot without commands holds its pose, sits down, and goes limp; and when it counts as at rest."""

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.control.controllers import SITTING_S, sitting_angles_rad
from hexctl.control.guard import Guard
from hexctl.ik.legs import solve_legs
from hexctl.server.idle import IdleSupervisor
from hexctl.server.rest_watch import RestWatch
from tests.control.posed import PosedMock, connected, send
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


def test_servos_that_use_one_array_again_and_again_are_not_at_rest_while_they_move() -> None:
    watch, angles_rad = RestWatch(), np.zeros(18)
    for tick in range(20):
        angles_rad += 0.01
        watch.note(angles_rad, 0.02 * tick)
    assert not watch.at_rest


def test_unknown_angles_are_not_at_rest() -> None:
    watch = RestWatch()
    for tick in range(20):
        watch.note(np.full(18, np.nan), 0.02 * tick)
    assert not watch.at_rest


def test_servos_that_cannot_be_reached_are_not_at_rest() -> None:
    """What is told of them is of before, and does not change however they move."""
    watch = RestWatch()
    for index in range(20):
        watch.note(np.zeros(18), 0.02 * index, reached=index < 15)
        assert watch.at_rest == (10 <= index < 15)


def let_pass(guard_and_servos: tuple[Guard, PosedMock], posture: IdleSupervisor, duration_s: float) -> None:
    guard, _ = guard_and_servos
    for _ in range(round(duration_s / PERIOD_S)):
        guard.clock.tick()
        guard.read()
        posture.tick(guard.clock.now_s)


def commanded_once() -> tuple[tuple[Guard, PosedMock], IdleSupervisor]:
    guard, servos = connected()
    posture = IdleSupervisor(guard, sit_after_s=1.0)
    send(guard, guard.robot.stance_angles_rad)
    posture.commanded(guard.clock.now_s)
    return (guard, servos), posture


def test_it_holds_after_silence_then_sits_within_limits_and_relaxes() -> None:
    (guard, servos), posture = commanded_once()
    let_pass((guard, servos), posture, 0.5)
    assert (guard.stopped, posture.name) == ("expired", "holding")
    n_before = len(servos.sent)
    let_pass((guard, servos), posture, 0.6)
    assert posture.name == "sitting"
    let_pass((guard, servos), posture, SITTING_S + 0.1)
    assert posture.name == "limp"
    assert servos.limp
    sat = np.array([targets.joint_positions_rad for targets in list(servos.sent)[n_before:]])
    np.testing.assert_allclose(sat[-1], sitting_angles_rad(guard.robot), atol=0.05)
    assert (np.abs(np.diff(sat, axis=0)) <= guard.robot.joint_max_speed_rad_s * PERIOD_S + 1e-9).all()
    assert guard.stopped == "expired"


def test_after_any_other_stop_it_holds_for_good() -> None:
    (guard, servos), posture = commanded_once()
    guard.stop("estop")
    let_pass((guard, servos), posture, 5.0)
    assert posture.name == "holding"
    assert len(servos.sent) == 1
    assert not servos.limp


def test_a_controller_that_comes_is_given_as_long_as_a_command() -> None:
    (guard, servos), posture = commanded_once()
    guard.pause_watchdog()
    let_pass((guard, servos), posture, 0.9)
    posture.controlled(guard.clock.now_s)
    let_pass((guard, servos), posture, 0.9)
    assert posture.name == "commanded"
    let_pass((guard, servos), posture, 0.2)
    assert posture.name == "sitting"


def test_a_robot_that_sits_down_stops_at_that_when_a_controller_comes() -> None:
    (guard, servos), posture = commanded_once()
    guard.pause_watchdog()
    let_pass((guard, servos), posture, 1.5)
    assert posture.name == "sitting"
    posture.controlled(guard.clock.now_s)
    n_before = len(servos.sent)
    let_pass((guard, servos), posture, 0.9)
    assert (posture.name, len(servos.sent)) == ("holding", n_before)
    let_pass((guard, servos), posture, SITTING_S + 0.3)
    assert posture.name == "limp"


def test_a_controller_that_comes_moves_no_limp_robot() -> None:
    (guard, servos), posture = commanded_once()
    guard.pause_watchdog()
    let_pass((guard, servos), posture, 1.5 + SITTING_S)
    n_before = len(servos.sent)
    posture.controlled(guard.clock.now_s)
    let_pass((guard, servos), posture, 3.0)
    assert (posture.name, len(servos.sent)) == ("limp", n_before)


def test_a_stop_while_sitting_down_ends_the_motion() -> None:
    (guard, servos), posture = commanded_once()
    let_pass((guard, servos), posture, 1.5)
    assert posture.name == "sitting"
    guard.stop("estop")
    n_before = len(servos.sent)
    let_pass((guard, servos), posture, 5.0)
    assert len(servos.sent) == n_before
    assert not servos.limp


def test_a_robot_whose_controller_left_in_good_order_sits_down_too() -> None:
    (guard, servos), posture = commanded_once()
    guard.pause_watchdog()
    let_pass((guard, servos), posture, 4.0)
    assert posture.name == "limp"
    assert guard.stopped is None


def test_before_the_first_command_nothing_moves() -> None:
    guard, servos = connected()
    posture = IdleSupervisor(guard, sit_after_s=1.0)
    let_pass((guard, servos), posture, 5.0)
    assert posture.name == "idle"
    assert not servos.sent


def test_a_command_ends_the_sitting() -> None:
    (guard, servos), posture = commanded_once()
    let_pass((guard, servos), posture, 1.5)
    guard.clear()
    send(guard, guard.robot.stance_angles_rad)
    posture.commanded(guard.clock.now_s)
    posture.tick(guard.clock.now_s)
    assert posture.name == "commanded"


def test_every_shipped_robot_sits_lower_than_it_stands_within_its_ranges() -> None:
    for name in ROBOT_NAMES:
        robot = shipped(name)
        pose = sitting_angles_rad(robot)
        assert (pose >= robot.joint_lower_rad).all()
        assert (pose <= robot.joint_upper_rad).all()
        assert not np.allclose(pose, robot.stance_angles_rad)
        assert solve_legs(robot, robot.stance_feet_body).reachable.all()


def test_after_a_stop_is_cleared_nothing_moves_before_the_next_command() -> None:
    (guard, servos), posture = commanded_once()
    guard.stop("estop")
    let_pass((guard, servos), posture, 60.0)
    guard.clear()
    n_before = len(servos.sent)
    let_pass((guard, servos), posture, 30.0)
    assert posture.name == "idle"
    assert len(servos.sent) == n_before
    assert not servos.limp
    send(guard, guard.robot.stance_angles_rad)
    posture.commanded(guard.clock.now_s)
    let_pass((guard, servos), posture, 5.0)
    assert posture.name == "limp"


def test_with_hot_servos_it_sits_at_once_and_goes_limp() -> None:
    (guard, servos), posture = commanded_once()
    guard.stop("hot: leg2 femur 72 C")
    let_pass((guard, servos), posture, 0.1)
    assert posture.name == "sitting"
    let_pass((guard, servos), posture, SITTING_S + 0.1)
    assert posture.name == "limp"
    assert servos.limp
    np.testing.assert_allclose(
        servos.sent[-1].joint_positions_rad, sitting_angles_rad(guard.robot), atol=0.05
    )


def test_a_stop_while_hot_servos_sit_ends_the_motion() -> None:
    (guard, servos), posture = commanded_once()
    guard.stop("hot: leg2 femur 72 C")
    let_pass((guard, servos), posture, 0.5)
    guard.stop("estop")
    n_before = len(servos.sent)
    let_pass((guard, servos), posture, 3.0)
    assert posture.name == "holding"
    assert len(servos.sent) == n_before
