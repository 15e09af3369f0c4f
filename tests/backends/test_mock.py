"""The mock robot: it conforms, it echoes, and it keeps what it was sent."""

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.clock import WallClock
from hexctl.backends.mock import MockServos
from hexctl.testing.servo_conformance import LegServosConformance
from hexctl.types import JointTargets
from tests.backends.fake_time import FakeTime
from tests.robots import shipped


class TestMockServos(LegServosConformance):
    def make(self) -> LegServos:
        return MockServos(shipped(), clock=FakeTime().clock())


def test_it_says_that_its_joints_are_an_echo_and_that_it_knows_no_pose() -> None:
    with MockServos(shipped(), clock=FakeTime().clock()) as servos:
        state = servos.read()
        assert not state.measured
        assert state.base_position_world is None
        assert state.base_quaternion_world is None
        assert state.foot_contacts is None


def test_it_keeps_what_it_was_sent_newest_last() -> None:
    with MockServos(shipped(), clock=FakeTime().clock()) as servos:
        for angle in (0.1, 0.2, 0.3):
            servos.write(JointTargets(np.full(18, angle), angle))
        assert [targets.joint_positions_rad[0] for targets in servos.sent] == [0.1, 0.2, 0.3]
        np.testing.assert_array_equal(servos.read().joint_positions_rad, np.full(18, 0.3))


def test_it_runs_on_the_wall_unless_told_otherwise() -> None:
    assert isinstance(MockServos(shipped()).clock, WallClock)
