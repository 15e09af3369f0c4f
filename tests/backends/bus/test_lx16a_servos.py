"""LX-16A servos as a controller sees them: they conform, and the age of each joint is told."""

from collections.abc import Iterator

import numpy as np
import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.bus.servos import parse_bus_port
from hexctl.control.guard import Guard
from hexctl.testing.servo_conformance import LegServosConformance
from hexctl.types import JointTargets
from tests.backends.bus.boards import a_map, bus_board, servos_on

pytestmark = pytest.mark.realtime

MAP = a_map("lx16a", "lx16a")


class TestLx16a(LegServosConformance):
    #: A count is 0.0042 rad.
    @pytest.fixture(autouse=True)
    def board(self) -> Iterator[None]:
        with bus_board(MAP) as self.running:
            yield

    def make(self) -> LegServos:
        return servos_on(self.running, MAP)


def _walk_about(servos: LegServos, ticks: int) -> list[float]:
    """Greatest age of a joint in each tick, while all joints move."""
    ages = []
    for tick in range(ticks):
        servos.clock.tick()
        state = servos.read()
        assert state.servos is not None
        ages.append(float(state.servos.ages_s.max()))
        swing = 0.1 * np.sin(0.1 * tick + np.arange(18))
        servos.write(JointTargets(servos.robot.stance_angles_rad + swing, servos.clock.now_s))
    return ages


def test_joints_are_heard_in_turn_while_all_of_them_move() -> None:
    with bus_board(MAP) as board, servos_on(board, MAP) as servos:
        assert float(np.median(_walk_about(servos, 150))) < 0.4
        assert servos.read().warnings == ()


def test_a_servo_that_falls_silent_is_named_after_a_second_and_a_half() -> None:
    with bus_board(MAP, "mute:5:femur@1") as board, servos_on(board, MAP) as servos:
        _walk_about(servos, 250)
        state = servos.read()
        assert state.warnings == ("mute: leg 5 femur (id 14)",)
        assert state.healthy


def test_garbled_answers_stop_nothing() -> None:
    with bus_board(MAP, "garble:0.05") as board, Guard(servos_on(board, MAP), expiry_s=1.0) as guard:
        for _ in range(150):
            guard.clock.tick()
            state = guard.read()
            assert state.joint_positions_rad == pytest.approx(guard.robot.stance_angles_rad, abs=0.02)
            guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))
        assert guard.stopped is None


def test_a_hot_servo_is_named() -> None:
    with bus_board(MAP, "hot:2:femur:72") as board, servos_on(board, MAP) as servos:
        for _ in range(20):  # temperatures come in turn, and count once two agree
            _walk_about(servos, 100)
            hot = tuple(warning for warning in servos.read().warnings if "hot" in warning)
            if hot:
                break
        assert hot == ("hot, 72 degrees C: leg 2 femur (id 5)",)


def test_the_usual_baud_is_that_of_the_family() -> None:
    assert parse_bus_port("/dev/ttyUSB0", driver="lx16a") == ("/dev/ttyUSB0", 115_200)
    assert parse_bus_port("/dev/ttyUSB0", 9600, driver="lx16a") == ("/dev/ttyUSB0", 9600)
