"""The static deflection of the stance before the first trial, simulated and connected."""

from typing import Any

import numpy as np
import pytest

from hexctl.adapt.runner import RobotStoppedError
from hexctl.adapt.stance import connected_deflection_rad, simulated_deflection_rad, stance_deflection_rad
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.world import World
from hexctl.control.guard import Guard
from hexctl.errors import CommandRefusedError
from hexctl.types import FloatArray, JointTargets, RobotState
from tests.adapt.priors import plan_of
from tests.adapt.staying import StayingSim
from tests.backends.fake_time import FakeTime
from tests.control.posed import FallsAfter, PosedMock
from tests.robots import shipped

ROBOT = shipped()
PLAN = plan_of(ROBOT)
SAG_RAD = float(np.radians(1.0))


def sag(world: World, seed: int = 0) -> FloatArray:
    found = simulated_deflection_rad(ROBOT, world, PLAN, seed, PLAN.belief)
    assert found is not None
    return found


def test_a_heavier_robot_and_softer_servos_stay_farther_behind() -> None:
    plain = np.abs(sag(World())).sum()
    assert np.abs(sag(World(added_mass_share=0.3))).sum() > 1.1 * plain
    assert np.abs(sag(World(servo_stiffness=0.6))).sum() > 1.1 * plain


@pytest.mark.slow
def test_it_is_the_same_again_and_noise_of_the_sensors_is_averaged_out() -> None:
    noisy = World(sensor_noise=SensorNoise(joint_deg=0.5))
    np.testing.assert_array_equal(sag(noisy), sag(noisy))
    off = np.concatenate([sag(noisy, seed) - sag(World()) for seed in range(4)])
    assert 0 < np.degrees(off.std()) < 0.5 * 0.5


def test_a_robot_that_falls_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.control.guard.FALL_COS_TILT", 2.0)
    assert simulated_deflection_rad(ROBOT, World(), PLAN, 0, PLAN.belief) is None


def test_a_robot_that_stays_says_what_a_simulation_says(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Guard(StayingSim(ROBOT)) as servos:
        here = connected_deflection_rad(servos, PLAN)
    assert here is not None
    np.testing.assert_allclose(here, sag(StayingSim.world), atol=1e-4)


def test_a_robot_that_only_echoes_says_nothing_and_does_not_move() -> None:
    servos = MockServos(ROBOT, clock=FakeTime().clock())
    with Guard(servos) as guard:
        assert stance_deflection_rad(guard, PLAN) is None
    assert not servos.sent


def test_a_robot_that_is_stopped_meanwhile_waits_for_a_person() -> None:
    with FallsAfter(PosedMock(ROBOT), 0.5) as guard, pytest.raises(RobotStoppedError, match="stopped: fell"):
        connected_deflection_rad(guard, PLAN)


class Slow(PosedMock):
    """Follows at a speed of its own, and stays a degree behind at the end."""

    def __init__(self, speed_rad_s: float) -> None:
        super().__init__(ROBOT)
        self._step_rad = speed_rad_s * PERIOD_S
        self._at_rad = ROBOT.stance_angles_rad + 1.0

    def read(self) -> RobotState:
        goal = self.sent[-1].joint_positions_rad - SAG_RAD if self.sent else self._at_rad
        self._at_rad = self._at_rad + np.clip(goal - self._at_rad, -self._step_rad, self._step_rad)
        self.joints_rad = self._at_rad
        return super().read()


@pytest.mark.parametrize(
    ("speed_rad_s", "stands"), [(20.0, 1), (1.1, 2), (0.2, None)], ids=["fast", "slow", "hardly moving"]
)
def test_a_robot_that_moves_still_is_asked_again(speed_rad_s: float, stands: int | None) -> None:
    servos = Slow(speed_rad_s)
    with Guard(servos) as guard:
        began_s = servos.time.now_s
        sag_rad = stance_deflection_rad(guard, PLAN)
        took = (servos.time.now_s - began_s) / PLAN.settle_s
    if stands is None:
        assert sag_rad is None
    else:
        assert took == pytest.approx(stands, abs=0.2)
        assert sag_rad is not None
        np.testing.assert_allclose(sag_rad, SAG_RAD, atol=1e-3)


def test_a_command_that_is_refused_once_is_no_reason_to_go_without() -> None:
    servos = PosedMock(ROBOT)
    servos.joints_rad = ROBOT.stance_angles_rad - SAG_RAD

    class Refusing(Guard):
        refused = False

        def write(self, targets: JointTargets) -> JointTargets:
            if not self.refused and len(servos.sent) == 5:
                self.refused = True
                raise CommandRefusedError("not now")
            return super().write(targets)

    with Refusing(servos) as guard:
        sag_rad = stance_deflection_rad(guard, PLAN)
        assert guard.refused
    assert sag_rad is not None
    np.testing.assert_allclose(sag_rad, SAG_RAD)


def test_after_a_wish_to_stop_nothing_moves() -> None:
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        assert stance_deflection_rad(guard, PLAN, lambda: True) is None
    assert not servos.sent


def test_joints_that_say_what_they_are_told_are_not_measured() -> None:
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        assert stance_deflection_rad(guard, PLAN) is None
    assert servos.sent


def test_afterwards_silence_is_no_failure() -> None:
    servos = PosedMock(ROBOT)
    servos.joints_rad = ROBOT.stance_angles_rad - SAG_RAD
    with Guard(servos) as guard:
        assert connected_deflection_rad(guard, PLAN) is not None
        servos.time.sleep(60.0)
        guard.read()
        assert guard.stopped is None
