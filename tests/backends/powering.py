"""Suites for servos whose torque is switched by software, in addition to those for every `LegServos`."""

import numpy as np

from hexctl.backends.pwm.servos import PwmServos
from hexctl.testing.servo_conformance import LegServosConformance
from hexctl.types import BoolArray, FloatArray
from tests.backends.standing import command, next_state, stand, until


class PoweringConformance(LegServosConformance):
    """Servos that hold only after the first targets, and until their torque is switched off."""

    def holding(self) -> BoolArray:
        """Joints whose servos hold, (18,)."""
        raise NotImplementedError

    def test_nothing_is_powered_before_the_first_targets_and_a_pose_outlasts_its_program(self) -> None:
        with self.make() as servos:
            for _ in range(20):
                next_state(servos)
            assert not self.holding().any()
            until(servos, lambda _: self.holding().all())
            assert servos.disable_torque()
            until(servos, lambda _: not self.holding().any(), write=False)
            until(servos, lambda _: self.holding().all())
        assert self.holding().all(), "after closing the robot holds its pose"
        with self.make() as servos:
            for _ in range(30):
                stand(servos, 1)
                assert self.holding().all(), "the next program lets go of nothing"
            assert servos.disable_torque()
        assert not self.holding().any(), "torque that is switched off before closing is off"


class HobbyServosConformance(PoweringConformance):
    """Servos that turn to their first pulses at full speed."""

    def make(self) -> PwmServos:
        raise NotImplementedError

    def pulses_us(self) -> FloatArray:
        """Pulses of the joints, (18,); 0 for a limp one."""
        raise NotImplementedError

    #: How exactly pulses are those of a pose, and a pose is read back.
    tolerance_us, tolerance_rad = 2.5, 5e-3

    def holding(self) -> BoolArray:
        return self.pulses_us() > 0

    def test_legs_are_powered_one_after_the_other_at_the_pose_that_came_first(self) -> None:
        with self.make() as servos:
            stance_rad = servos.robot.stance_angles_rad
            at_first_us, seen = servos.servo_map.raw(stance_rad), [0]
            for tick in range(200):
                stand(servos, 1, min(0.2, 0.01 * tick))
                powered = np.flatnonzero(self.holding())
                assert powered.tolist() == list(range(len(powered))), "in the order of the legs"
                if len(powered) < 18:
                    off_us = self.pulses_us()[powered] - at_first_us[powered]
                    np.testing.assert_allclose(off_us, 0, atol=self.tolerance_us + 0.01 * 2 * 637)
                if seen[-1] != len(powered):
                    seen.append(len(powered))
            assert seen == [0, 3, 6, 9, 12, 15, 18]
            np.testing.assert_allclose(
                self.pulses_us(), servos.servo_map.raw(stance_rad + 0.2), atol=self.tolerance_us
            )

    def test_a_single_pose_is_reached_and_is_where_the_next_program_begins(self) -> None:
        with self.make() as servos:
            command(servos, 0.1)
            servos.clock.time.sleep(5.0)
            goal_rad = servos.robot.stance_angles_rad + 0.1
            np.testing.assert_allclose(
                self.pulses_us(), servos.servo_map.raw(goal_rad), atol=self.tolerance_us
            )
        with self.make() as servos:
            np.testing.assert_allclose(servos.read().joint_positions_rad, goal_rad, atol=self.tolerance_rad)
