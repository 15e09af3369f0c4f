"""Load capacity: against a linear program with all forces in it, and against a simulation that sinks."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World
from hexctl.ik.legs import link_points_body
from hexctl.ik.load_capacity import load_capacity
from hexctl.ik.statics import GRAVITY_M_S2, arms_m, link_torques_nm
from hexctl.ik.support_polygon import centre_of_mass_of
from hexctl.robot.model import Robot
from hexctl.types import BoolArray, FloatArray, JointTargets
from tests.robots import shipped, without_friction

FLAT, ICE = World(), World(friction=0.001, contact_time_s=0.005)
EVERY_FOOT = np.ones(6, dtype=bool)


def capacity_of(robot: Robot, joints_rad: FloatArray, standing: BoolArray, world: World = FLAT) -> float:
    return float(load_capacity(robot, joints_rad, standing, friction=world.friction))


def with_capacity(robot: Robot, capacity: float, world: World) -> Robot:
    """The robot with a share of its torque, by which it carries a multiple of its weight in its stance.

    The two are no proportion: part of the torque carries the links themselves.
    """

    def weaker(share: float) -> Robot:
        return replace(robot, joint_max_torque_nm=share * robot.joint_max_torque_nm)

    def excess(share: float) -> float:
        return capacity_of(weaker(share), robot.stance_angles_rad, EVERY_FOOT, world) - capacity

    from scipy.optimize import brentq

    return weaker(brentq(excess, 1e-4, 1.0))


def lowered_m(robot: Robot, world: World) -> float:
    """How far a simulated robot sinks that stands in its stance for two seconds."""
    with SimServos(robot, world=world) as servos:
        for _ in range(100):
            servos.clock.tick()
            state = servos.read()
            servos.write(JointTargets(robot.stance_angles_rad, servos.clock.now_s))
        assert state.base_position_world is not None
        return robot.standing_height_m - float(state.base_position_world[2])


@pytest.mark.slow
@pytest.mark.parametrize(("name", "world"), [("ant", ICE), ("pexod", FLAT), ("phantomx", FLAT)])
def test_a_robot_stands_above_a_capacity_of_one_and_sinks_below(name: str, world: World) -> None:
    robot = without_friction(name)
    # Where friction between the feet has to help, feet creep a little before it does.
    assert lowered_m(with_capacity(robot, 1.1, world), world) < 0.008
    assert lowered_m(with_capacity(robot, 0.9, world), world) > 0.02


def test_fewer_feet_carry_less_and_one_side_alone_nothing() -> None:
    robot = shipped("pexod")
    tripod = np.array([True, False, True, False, True, False])
    left = np.array([True, True, True, False, False, False])
    every, three, side = (
        capacity_of(robot, robot.stance_angles_rad, feet) for feet in (EVERY_FOOT, tripod, left)
    )
    assert every > three > 0
    assert side == 0


def test_it_is_what_a_linear_program_finds() -> None:
    """Forces on all feet at once, with the torques, the friction and the balance as rows of one program."""
    robot = without_friction("phantomx")
    rng = np.random.default_rng(3)
    for _ in range(8):
        joints_rad = robot.stance_angles_rad + rng.uniform(-0.3, 0.3, 18)
        standing = rng.random(6) < 0.8
        expected = _program(robot, joints_rad, standing)
        assert capacity_of(robot, joints_rad, standing) == pytest.approx(expected, rel=1e-6)


def _program(robot: Robot, joints_rad: FloatArray, standing: BoolArray) -> float:
    from scipy.optimize import linprog

    points = link_points_body(robot, joints_rad)
    arms = arms_m(robot, points, joints_rad.reshape(6, 3))
    own, centre = link_torques_nm(robot, arms), centre_of_mass_of(robot, points)
    # Unknowns: up and outward force of each leg, and the multiple of the weight.
    rows, bounds_of = [], []
    for leg in range(6):
        for joint in (1, 2):
            row = np.zeros(13)
            row[leg] = -arms[leg, -1, joint]
            row[6 + leg] = points[leg, -1, 2] - points[leg, joint, 2]
            limit = robot.joint_max_torque_nm[3 * leg + joint]
            rows += [row, -row]
            bounds_of += [limit - own[leg, joint], limit + own[leg, joint]]
        for sign in (1, -1):
            row = np.zeros(13)
            row[6 + leg], row[leg] = sign, -FLAT.friction
            rows.append(row)
            bounds_of.append(0.0)
    weight_n = GRAVITY_M_S2 * robot.mass_kg
    feet = points[:, -1, :2]
    equal = np.zeros((3, 13))
    equal[0, :6], equal[1:, :6] = 1.0, feet.T
    equal[:, 12] = -weight_n * np.array([1.0, *centre[:2]])
    bounds = [(0, None if stands else 0) for stands in standing] + [(None, None)] * 6 + [(0, None)]
    cost = np.zeros(13)
    cost[12] = -1.0
    found = linprog(cost, A_ub=np.array(rows), b_ub=bounds_of, A_eq=equal, b_eq=np.zeros(3), bounds=bounds)
    return float(found.x[12]) if found.success else 0.0
