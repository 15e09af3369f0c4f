"""Simulated PCA9685 boards: a robot moves as their pulses say, and what goes wrong with them."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.i2c_socket import I2cSocket
from hexctl.control.guard import Guard
from hexctl.types import JointTargets, RobotState
from tests.backends.pwm.boards import a_map, i2c_servos_on, pca9685_board
from tests.robots import shipped

pytestmark = pytest.mark.realtime


def _until(servos: LegServos, condition: Callable[[RobotState], Any], *, write: bool = True) -> RobotState:
    for _ in range(400):
        servos.clock.tick()
        state = servos.read()
        if condition(state):
            return state
        if write:
            servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
    raise AssertionError(state)


def test_a_simulated_robot_moves_as_the_pulses_say() -> None:
    from hexctl.backends.sim.servos import SimServos

    simulated = SimServos(shipped(), realtime=True)
    with pca9685_board(servos=simulated) as board, i2c_servos_on(board) as servos:
        wanted = servos.robot.stance_angles_rad + 0.05
        for _ in range(400):
            servos.clock.tick()
            servos.write(JointTargets(wanted, servos.clock.now_s))
            if np.allclose(simulated.read().joint_positions_rad, wanted, atol=0.03):
                break
        else:
            raise AssertionError(simulated.read().joint_positions_rad - wanted)
        np.testing.assert_allclose(board.pulses_us(), a_map("pca9685").raw(wanted), atol=2.5)
        servos.disable_torque()
        _until(servos, lambda _: not board.pulses_us().any(), write=False)


def test_transfers_that_are_not_acknowledged_now_and_then_stop_nothing() -> None:
    with pca9685_board("nack:0.02@1") as board, Guard(i2c_servos_on(board), expiry_s=1.0) as guard:
        for _ in range(200):
            guard.clock.tick()
            guard.read()
            guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
        assert guard.stopped is None
        assert board.report()["refused"] > 0


def test_a_cable_that_comes_back_leaves_the_robot_standing() -> None:
    with pca9685_board("unplug@2", "replug@3") as board, i2c_servos_on(board) as servos:
        state = _until(servos, lambda state: not state.healthy)
        assert "do not answer (Remote I/O error" in str(state.fault)
        _until(servos, lambda state: state.healthy, write=False)
        assert (board.pulses_us() > 0).all()


def test_boards_that_lose_their_power_say_so_and_stay_limp() -> None:
    with pca9685_board("reset@2") as board, i2c_servos_on(board) as servos:
        state = _until(servos, lambda state: not state.healthy)
        assert "0x40 has lost its settings" in str(state.fault)
        assert "0x41 has lost its settings" in str(state.fault)
        assert not board.pulses_us().any()
        for _ in range(10):
            servos.clock.tick()
            servos.write(JointTargets(servos.robot.stance_angles_rad, servos.clock.now_s))
        assert not board.pulses_us().any()


@pytest.mark.parametrize(("bits_per_s", "least_s"), [(100_000, 0.0036), (10_000, 0.036)])
def test_transfers_take_no_less_than_their_bits(bits_per_s: int, least_s: float) -> None:
    with pca9685_board(bits_per_s=bits_per_s) as board:
        bus, began_s = I2cSocket(board.path), time.monotonic()
        for _ in range(10):
            bus.read_byte_data(0x40, 0)  # four bytes
        assert time.monotonic() - began_s >= 10 * least_s / 10
        bus.close()
