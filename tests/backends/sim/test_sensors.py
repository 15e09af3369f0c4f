"""A simulated robot measures what the real one does."""

from dataclasses import replace
from itertools import chain, combinations

import numpy as np
import pytest

from hexctl.backends.sim.flaws import SensorFaults
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.robot.sensors import SENSORS, Sensor
from hexctl.types import JointTargets, RobotState
from tests.robots import shipped

#: Fields of a state by the sensor that fills them; an orientation comes from either of two.
FIELDS: dict[Sensor, tuple[str, ...]] = {
    "joint_positions": (),
    "joint_velocities": ("joint_velocities_rad_s",),
    "joint_loads": ("joint_torques_nm",),
    "foot_contacts": ("foot_contacts",),
    "imu": ("base_quaternion_world", "angular_velocity_body_rad_s"),
    "position": ("base_position_world", "base_quaternion_world"),
}

SUBSETS = list(chain.from_iterable(combinations(SENSORS, count) for count in range(len(SENSORS) + 1)))


def stepped(sensors: tuple[Sensor, ...], *, all_sensors: bool = False) -> tuple[RobotState, np.ndarray]:
    """State of a robot that cannot follow its targets yet, and the targets."""
    robot = replace(shipped(), sensors=sensors)
    with SimServos(robot, all_sensors=all_sensors) as servos:
        servos.clock.tick()
        targets = robot.stance_angles_rad + 0.1
        servos.write(JointTargets(targets, servos.clock.now_s))
        servos.clock.tick()
        return servos.read(), targets


@pytest.mark.parametrize("sensors", SUBSETS, ids="+".join)
def test_a_state_has_exactly_what_the_robot_measures(sensors: tuple[Sensor, ...]) -> None:
    state, targets = stepped(sensors)
    expected = {field for sensor in sensors for field in FIELDS[sensor]}
    fields = {field for each in FIELDS.values() for field in each}
    assert {field for field in fields if getattr(state, field) is not None} == expected
    assert state.measured == ("joint_positions" in sensors)
    assert np.array_equal(state.joint_positions_rad, targets) != state.measured


@pytest.mark.parametrize(
    ("sensors", "lost"), [(("imu",), False), (("position",), True)], ids=("imu", "camera")
)
def test_a_pose_that_is_lost_is_that_of_a_tracker(sensors: tuple[Sensor, ...], lost: bool) -> None:
    robot = replace(shipped(), sensors=sensors)
    gone = World(lost_poses=0.9, sensor_faults=SensorFaults(pose_frozen_s=((0.0, 9.0),)))
    with SimServos(robot, world=gone) as servos:
        turns = []
        for _ in range(40):
            servos.clock.tick()
            servos.write(JointTargets(robot.stance_angles_rad + 0.1, servos.clock.now_s))
            turns.append(servos.read().base_quaternion_world)
    seen = [turn for turn in turns if turn is not None]
    assert (len(seen) < len(turns)) == lost
    assert (len({tuple(turn) for turn in seen}) == 1) == lost


def test_all_sensors_are_those_of_a_robot_that_has_them() -> None:
    assert stepped((), all_sensors=True)[0] == stepped(SENSORS)[0]


@pytest.mark.parametrize("sensors", [(), ("imu",), ("foot_contacts",)], ids="+".join)
def test_many_robots_measure_what_one_does(sensors: tuple[Sensor, ...]) -> None:
    robot = replace(shipped(), sensors=sensors)
    plan = TrialPlan(gait=make_gait(robot, "demo"), duration_s=1.0, hold="none")
    trials = [
        SimTrial(robot=robot, plan=plan, failures=(), world=world, seed=seed)
        for world, seed in (("flat", 0), ("rough", 1))
    ]
    assert run_sim_trials(trials) == [run_sim_trial(trial) for trial in trials]
