"""Simulated servos: conformance, determinism, sensor noise, divergence, the stepping clock."""

from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexctl.backends.base import LegServos
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.flaws import SensorNoise
from hexctl.backends.sim.servos import SimClock, SimServos
from hexctl.backends.sim.simulation_model import FIRST_JOINT, TOUCH
from hexctl.backends.sim.world import World
from hexctl.errors import RobotFaultError, SimulationDivergedError
from hexctl.robot.rotations import yaw_rad
from hexctl.testing.servo_conformance import LegServosConformance, move
from hexctl.types import FloatArray
from tests.backends.fake_time import FakeTime
from tests.robots import ROBOT_NAMES, shipped
from tests.trials import walk

NOISY = World(sensor_noise=SensorNoise(joint_deg=0.5, position_m=0.003, yaw_deg=1.0))
ROUGH = World(
    roughness_m=0.004, joint_offset_deg=1.0, sensor_noise=SensorNoise(joint_deg=0.2, position_m=0.001)
)


class TestSimServos(LegServosConformance):
    def make(self) -> LegServos:
        return SimServos(shipped())


@pytest.mark.slow
class TestSimServosThatAreBadlyCalibrated(LegServosConformance):
    tolerance_rad = 0.05

    def make(self) -> LegServos:
        return SimServos(shipped("phantomx"), world=World(joint_offset_deg=2.0), seed=3)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_robot_stands_still_on_six_feet_that_carry_its_weight(name: str) -> None:
    robot = shipped(name)
    with SimServos(robot) as servos:
        move(servos, robot.stance_angles_rad, ticks=50)
        before = servos.read()
        move(servos, robot.stance_angles_rad, ticks=50)
        after = servos.read()
        assert before.base_position_world is not None
        assert after.base_position_world is not None
        np.testing.assert_allclose(after.base_position_world, before.base_position_world, atol=1e-3)
        np.testing.assert_allclose(after.base_position_world[:2], 0, atol=0.005)
        assert after.base_position_world[2] == pytest.approx(robot.standing_height_m, abs=0.01)
        assert after.foot_contacts is not None
        assert after.foot_contacts.all()
        assert servos.compiled.physics.data.sensordata[TOUCH].sum() == pytest.approx(
            9.81 * robot.mass_kg, rel=0.01
        )


def test_without_noise_it_measures_exactly_where_it_is() -> None:
    with SimServos(shipped()) as servos:
        move(servos, servos.robot.stance_angles_rad + 0.05, ticks=10)
        data = servos.compiled.physics.data
        state, qpos = servos.read(), data.qpos
        assert state.measured
        np.testing.assert_array_equal(state.joint_velocities_rad_s, data.qvel[6:])
        np.testing.assert_array_equal(state.joint_positions_rad, qpos[FIRST_JOINT:])
        np.testing.assert_array_equal(state.base_position_world, qpos[:3])
        np.testing.assert_array_equal(state.base_quaternion_world, qpos[3:FIRST_JOINT])


def test_the_angular_velocity_is_about_the_axes_of_the_body() -> None:
    with SimServos(shipped()) as servos:
        data = servos.compiled.physics.data
        data.qpos[2:FIRST_JOINT] = [1.0, 0.8, 0.6, 0.0, 0.0]
        data.qvel[3:6] = [0.3, -0.5, 2.0]
        states = []
        for _ in range(2):
            servos.clock.tick()
            states.append(servos.read())
        before, after = (Rotation.from_quat(one.base_quaternion_world, scalar_first=True) for one in states)
        turned_rad_s = (before.inv() * after).as_rotvec() / servos.clock.period_s
        assert states[1].angular_velocity_body_rad_s == pytest.approx(turned_rad_s, abs=0.05)


def test_the_physics_can_be_reached_only_when_connected() -> None:
    servos = SimServos(shipped())
    with pytest.raises(RobotFaultError, match="connect"):
        _ = servos.compiled
    with pytest.raises(RobotFaultError, match="connect"):
        servos.clock.tick()
    with servos:
        assert servos.clock.tick().index == 1


def test_a_free_robot_falls_as_newton_says() -> None:
    with SimServos(shipped()) as servos:
        servos.compiled.physics.data.qpos[2] += 1.0
        start = servos.read().base_position_world
        servos.clock.tick()
        servos.clock.tick()
        after = servos.read().base_position_world
        assert start is not None
        assert after is not None
        # Two ticks of ten steps each, semi-implicit: g dt^2 n (n + 1) / 2.
        assert start[2] - after[2] == pytest.approx(9.81 * 0.002**2 * 20 * 21 / 2, rel=1e-3)


def test_the_same_seed_gives_the_same_trial_to_the_last_bit() -> None:
    first, second = (walk(duration_s=1.5, world=ROUGH, seed=5) for _ in range(2))
    assert first.result.to_dict() == second.result.to_dict()
    for column in (
        "measured_rad",
        "commanded_rad",
        "base_position_world",
        "base_quaternion_world",
        "foot_contacts",
    ):
        assert np.array_equal(first.log[column], second.log[column])


def _errors(world: World) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Measured - true of joints, position and yaw over 400 ticks of standing."""
    joints, positions, yaws = [], [], []
    with SimServos(shipped(), world=world) as servos:
        for _ in range(400):
            move(servos, servos.robot.stance_angles_rad, ticks=1)
            state, qpos = servos.read(), servos.compiled.physics.data.qpos
            assert state.base_position_world is not None
            assert state.base_quaternion_world is not None
            joints.append(state.joint_positions_rad - qpos[FIRST_JOINT:])
            positions.append(state.base_position_world - qpos[:3])
            yaws.append(yaw_rad(state.base_quaternion_world) - yaw_rad(qpos[3:FIRST_JOINT]))
    return np.array(joints), np.array(positions), np.array(yaws)


def test_sensor_noise_has_the_standard_deviations_of_its_world() -> None:
    joints, positions, yaws = _errors(NOISY)
    assert joints.std() == pytest.approx(np.radians(0.5), rel=0.05)
    assert positions.std() == pytest.approx(0.003, rel=0.1)
    assert yaws.std() == pytest.approx(np.radians(1.0), rel=0.15)
    assert abs(joints.mean()) < np.radians(0.02)


def test_another_trial_in_the_same_world_has_the_same_robot_and_noise_of_its_own() -> None:
    offsets, measured = [], []
    for trial in (0, 1):
        with SimServos(shipped(), world=ROUGH, seed=5, trial=trial) as servos:
            move(servos, servos.robot.stance_angles_rad, ticks=5)
            offsets.append(servos.compiled.joint_offsets_rad)
            measured.append(servos.read().joint_positions_rad)
    np.testing.assert_array_equal(offsets[0], offsets[1])
    assert not np.array_equal(measured[0], measured[1])


@pytest.mark.slow
@pytest.mark.parametrize(("array", "value"), [("qvel", 1e12), ("qvel", np.nan), ("qpos", np.inf)])
def test_a_simulation_that_diverges_says_so(array: str, value: float) -> None:
    with SimServos(shipped()) as servos:
        servos.clock.tick()
        data: Any = servos.compiled.physics.data
        getattr(data, array)[-1] = value
        with pytest.raises(SimulationDivergedError, match="unstable"):
            servos.clock.tick()


def test_a_paced_clock_waits_for_the_wall() -> None:
    time = FakeTime(50.0)
    clock = SimClock(lambda: time.work(0.004), time.clock())
    for index in range(1, 101):
        clock.tick()
        assert time.now_s == pytest.approx(50.0 + index * PERIOD_S + 0.004, abs=1e-6)
    assert clock.overruns == 0


def test_a_paced_clock_that_is_late_counts_but_never_skips() -> None:
    time = FakeTime()
    steps: list[int] = []
    clock = SimClock(lambda: steps.append(1), time.clock())
    clock.tick()
    time.work(5.5 * PERIOD_S)
    tick = clock.tick()
    assert (tick.index, len(steps)) == (2, 2)
    assert tick.time_s == pytest.approx(2 * PERIOD_S)
    assert clock.overruns == 4


@pytest.mark.slow
def test_sensor_noise_does_not_touch_the_robot() -> None:
    true = []
    for world in (World(), NOISY):
        with SimServos(shipped(), world=world) as servos:
            move(servos, servos.robot.stance_angles_rad + 0.1, ticks=30)
            true.append(servos.compiled.physics.data.qpos.copy())
    np.testing.assert_array_equal(true[0], true[1])
