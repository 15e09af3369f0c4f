"""The servo board as LegServos: over UDP and over a pseudo-terminal, the board in a process of its own."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hexctl.backends.base import LegServos
from hexctl.backends.mavlink.servos import MavlinkServos
from hexctl.robot.servo_map import load_servo_map
from tests.backends.conformance import LegServosConformance, check_state, move
from tests.backends.mavlink.boards import BoardProcess, board, fast_clock, fitting_file
from tests.robots import shipped


class OverBoard(LegServosConformance):
    """The suite against one board that all its tests share, one after the other.

    Attributes:
        pty: whether it speaks over a pseudo-terminal.
    """

    pty = False
    running: BoardProcess
    file: Path

    @pytest.fixture(autouse=True, scope="class")
    @classmethod
    def _board(cls, tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
        cls.file = fitting_file(tmp_path_factory.mktemp("robot"))
        with board("--backend", "mock", "--robot", str(cls.file), pty=cls.pty) as running:
            cls.running = running
            yield

    def make(self) -> LegServos:
        return MavlinkServos(
            shipped(), servo_map=load_servo_map(self.file), port=self.running.port, clock=fast_clock()
        )


class TestOverUdp(OverBoard):
    pass


class TestOverPseudoTerminal(OverBoard):
    pty = True


@pytest.mark.parametrize("pty", [False, True], ids=["udp", "pty"])
def test_a_simulated_robot_measures_and_knows_its_pose(pty: bool, tmp_path: Path) -> None:
    """The few of the suite that physics could spoil, on a clock that is the wall's."""
    file = fitting_file(tmp_path)
    with board("--robot", str(file), pty=pty) as running:
        servos = MavlinkServos(shipped(), servo_map=load_servo_map(file), port=running.port)
        with servos:
            check_state(servos.read(), servos)
            suite = LegServosConformance()
            suite.test_a_small_change_is_reached_within_a_second(servos)
            move(servos, servos.robot.stance_angles_rad, ticks=50)
            state = servos.read()
            check_state(state, servos)
            assert state.measured
            assert state.base_position_world is not None
            assert state.base_position_world[2] == pytest.approx(servos.robot.standing_height_m, abs=0.01)
        report = running.end()
        assert report["overrides"] >= 150
        assert report["refused"] == report["malformed"] == 0
