"""How a robot stands before its first trial, simulated and not."""

from typing import Any

import numpy as np
import pytest

from hexctl.adapt.stance import sag_here_rad, simulated_sag_rad, stance_sag_rad
from hexctl.adapt.stops import RobotStoppedError
from hexctl.backends.mock import MockServos
from hexctl.backends.sim.world import SensorNoise, World
from hexctl.control.guard import Guard
from hexctl.robot.messages import FloatArray
from tests.adapt.priors import plan_of
from tests.adapt.staying import StayingSim
from tests.backends.fake_time import FakeTime
from tests.control.posed import PosedMock
from tests.robots import shipped

ROBOT = shipped()
PLAN = plan_of(ROBOT)


def sag(world: World, seed: int = 0) -> FloatArray:
    found = simulated_sag_rad(ROBOT, world, PLAN, seed)
    assert found is not None
    return found


def test_a_heavier_robot_and_softer_servos_stay_farther_behind() -> None:
    plain = np.abs(sag(World())).sum()
    assert np.abs(sag(World(added_mass_share=0.3))).sum() > 1.1 * plain
    assert np.abs(sag(World(servo_stiffness=0.6))).sum() > 1.1 * plain


def test_it_is_the_same_again_and_noise_of_the_sensors_is_averaged_out() -> None:
    noisy = World(sensor_noise=SensorNoise(joint_deg=0.5))
    np.testing.assert_array_equal(sag(noisy), sag(noisy))
    off = np.concatenate([sag(noisy, seed) - sag(World()) for seed in range(8)])
    assert 0 < np.degrees(off.std()) < 0.5 * 0.5


def test_a_robot_that_falls_says_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.control.guard.FALL_COS_TILT", 2.0)
    assert simulated_sag_rad(ROBOT, World(), PLAN, 0) is None


def test_a_robot_that_stays_says_what_a_simulation_says(
    tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with Guard(StayingSim(ROBOT)) as servos:
        here = sag_here_rad(servos, PLAN)
    assert here is not None
    np.testing.assert_allclose(here, sag(StayingSim.world), atol=1e-4)


def test_a_robot_that_only_echoes_says_nothing_and_does_not_move() -> None:
    servos = MockServos(ROBOT, clock=FakeTime().clock())
    with Guard(servos) as guard:
        assert stance_sag_rad(guard, PLAN) is None
    assert not servos.sent


def test_a_robot_that_is_stopped_meanwhile_waits_for_a_person() -> None:
    servos = PosedMock(ROBOT)
    began_s = servos.time.now_s

    class Falling(Guard):
        def read(self) -> Any:
            if servos.time.now_s > began_s + 0.5:
                servos.lean(85.0)
            return super().read()

    with Falling(servos) as guard, pytest.raises(RobotStoppedError, match="stopped: fell"):
        sag_here_rad(guard, PLAN)


def test_afterwards_silence_is_no_failure() -> None:
    servos = PosedMock(ROBOT)
    with Guard(servos) as guard:
        assert sag_here_rad(guard, PLAN) is not None
        servos.time.sleep(60.0)
        guard.read()
        assert guard.stopped is None
