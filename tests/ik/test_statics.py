"""What a stance carries, and how near its legs are: against MuJoCo, SciPy, and what weight and levers say."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.optimize import brentq, linprog
from scipy.spatial import ConvexHull

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulation_model import FIRST_JOINT, make_simulation
from hexctl.backends.sim.world import World
from hexctl.gait.foot_trajectory import gait_feet_body
from hexctl.gait.gait import Motion, make_gait
from hexctl.ik.clearance import PARTS, leg_clearance, segment_distance_m
from hexctl.ik.legs import foot_positions_body, link_points_body, solve_legs
from hexctl.ik.load_capacity import load_capacity
from hexctl.ik.statics import arms_m, link_torques_nm, static_load
from hexctl.ik.support_polygon import (
    carried,
    centre_of_mass_body,
    centre_of_mass_of,
    foot_heights_body,
    margins_at_m,
    support,
    to_world,
)
from hexctl.robot.model import Robot
from hexctl.types import GRAVITY_M_S2, N_JOINTS, BoolArray, FloatArray, JointTargets
from tests.robots import shipped, without_friction

ALL = np.ones(6, dtype=bool)

FRICTION = World().friction

#: Feet slide, as in the model, and the floor is hard.
ICE = World(friction=0.001, contact_time_s=0.005)


def uneven(robot: Robot) -> Robot:
    """The robot with centres of mass and stiffness of its own."""
    return replace(
        robot,
        body=replace(robot.body, com_m=(0.02, -0.01, 0.03)),
        link_coms_m=robot.link_vectors_m * 0.3 + np.array([[0.0, 0.01], [0.005, -0.01], [-0.01, -0.02]]),
        joint_stiffness_nm_per_rad=np.tile([20.0, 30.0, 12.0], 6),
    )


@pytest.mark.parametrize(
    ("name", "own", "lifted"),
    [("ant", False, True), ("phantomx", False, False), ("phantomx", True, False), ("pexod", False, True)],
)
def test_torques_and_deflections_are_those_of_a_simulation(name: str, own: bool, lifted: bool) -> None:
    """Each joint that carries within 3 % of its own torque, the others within 2 % of the greatest.

    Measured: 2.1 % and 1.5 %. The statics leave out what feet still hold sideways, the floor they press in,
    and how the links turn with a body that tilts.
    """
    robot = uneven(without_friction(name)) if own else without_friction(name)
    targets_rad = robot.stance_angles_rad
    if lifted:
        gait = make_gait(robot, "demo")
        feet = gait_feet_body(robot, gait, Motion(travel=0.0), 2.0 + 0.12 / gait.pace_hz)
        targets_rad = solve_legs(robot, feet).joint_positions_rad
    load = static_load(robot, targets_rad)
    with SimServos(robot, world=ICE) as servos:
        for _ in range(75):
            servos.clock.tick()
            joints_rad = servos.read().joint_positions_rad
            servos.write(JointTargets(targets_rad, servos.clock.now_s))
        torques_nm = servos.compiled.physics.data.actuator_force.copy()
    assert load.balanced
    errors_nm, most_nm = np.abs(load.torques_nm - torques_nm), np.abs(torques_nm).max()
    carrying = np.abs(torques_nm) > 0.1 * most_nm
    assert (errors_nm <= np.where(carrying, 0.03 * np.abs(torques_nm), 0.02 * most_nm)).all()
    off_rad, most_rad = joints_rad - targets_rad, most_nm / robot.servo.stiffness_nm_per_rad
    assert load.deflections_rad == pytest.approx(off_rad, abs=0.02 * most_rad)
    assert (load.foot_forces_n == 0).any() == lifted


def test_forces_carry_the_weight_and_only_from_below() -> None:
    robot = shipped("pexod")
    rng = np.random.default_rng(0)
    lifts = np.where(rng.random((50, 6)) < 0.3, 0.03, 0.0)
    feet = robot.stance_feet_body + np.stack([0 * lifts, 0 * lifts, lifts], axis=-1)
    load = static_load(robot, solve_legs(robot, feet).joint_positions_rad)
    assert (load.foot_forces_n >= 0).all()
    assert load.foot_forces_n[load.balanced].sum(axis=-1) == pytest.approx(
        GRAVITY_M_S2 * robot.mass_kg, rel=0.01
    )
    assert (load.foot_heights_m[load.foot_forces_n > 0] < 1e-6).all()


def test_a_robot_that_stands_inside_its_feet_balances_on_any_servos() -> None:
    """Each Newton step alone may go round between two sets of feet for ever."""
    robot = shipped("ant")
    rng = np.random.default_rng(1)
    inside = 0
    for mass, stiffness in ((1.0, 0.94), (4.6, 1.03), (7.4, 1.06), (3.0, 0.1)):
        heavy = replace(
            robot,
            body=replace(robot.body, mass_kg=mass * robot.body.mass_kg),
            servo=replace(robot.servo, stiffness_nm_per_rad=stiffness * robot.servo.stiffness_nm_per_rad),
        )
        moved = rng.uniform(-0.03, 0.03, (150, 6, 2))
        lifted = np.where(rng.random((150, 6, 1)) < 0.5, rng.uniform(0, 0.04, (150, 6, 1)), 0.0)
        feet = robot.stance_feet_body + np.concatenate([moved, lifted], axis=-1)
        solution = solve_legs(heavy, feet)
        joints_rad = solution.joint_positions_rad[solution.reachable.all(axis=-1)]
        load = static_load(heavy, joints_rad)
        points = link_points_body(heavy, joints_rad + load.deflections_rad)
        centres = centre_of_mass_of(heavy, points)
        for feet_m, centre_m, balanced in zip(points[..., -1, :2], centres, load.balanced, strict=True):
            hull = ConvexHull(feet_m).equations
            if (hull[:, :2] @ centre_m[:2] + hull[:, 2] < -0.01).all():
                inside += 1
                assert balanced
    assert inside > 500


def test_the_capacity_is_what_a_linear_program_finds() -> None:
    """Forces on all feet at once, with the torques, the friction and the balance as rows of one program."""
    robot = without_friction("phantomx")
    rng = np.random.default_rng(3)
    for _ in range(8):
        joints_rad = robot.stance_angles_rad + rng.uniform(-0.3, 0.3, 18)
        standing = rng.random(6) < 0.8
        expected = _program(robot, joints_rad, standing)
        found = load_capacity(robot, joints_rad, standing, friction=FRICTION)
        assert float(found) == pytest.approx(expected, rel=1e-6)


def _program(robot: Robot, joints_rad: FloatArray, standing: BoolArray) -> float:
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
            row[6 + leg], row[leg] = sign, -FRICTION
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


# The centre of gravity and the support polygon.

HEXAGON = np.stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)], axis=-1)
plane = st.lists(st.floats(-1, 1), min_size=12, max_size=12).map(lambda xy: np.reshape(xy, (6, 2)))


@pytest.mark.parametrize(("name", "own"), [("ant", False), ("pexod", False), ("phantomx", True)])
def test_the_centre_of_mass_is_that_of_the_simulated_body(name: str, own: bool) -> None:
    robot = uneven(shipped(name)) if own else shipped(name)
    simulation = make_simulation(robot, World())
    data = simulation.physics.data
    random = np.random.default_rng(3)
    poses = [robot.stance_angles_rad + random.normal(0, 0.4, N_JOINTS) for _ in range(5)]
    for joints in poses:
        quaternion = random.normal(size=4)
        quaternion /= np.linalg.norm(quaternion)
        data.qpos[:3], data.qpos[3:FIRST_JOINT] = [0.3, -0.2, 0.5], quaternion
        data.qpos[FIRST_JOINT:] = joints
        simulation.physics.forward()
        trunk = simulation.physics.model.jnt_bodyid[0]
        expected = np.array(data.subtree_com[trunk])
        mine = to_world(centre_of_mass_body(robot, joints)[np.newaxis], np.array(data.qpos[:3]), quaternion)
        np.testing.assert_allclose(mine[0], expected, atol=1e-9)


def test_foot_heights_are_those_of_the_kinematics() -> None:
    robot = shipped()
    joints = robot.stance_angles_rad + np.random.default_rng(1).normal(0, 0.5, (7, N_JOINTS))
    expected = foot_positions_body(robot, joints)[..., 2]
    np.testing.assert_allclose(foot_heights_body(robot, joints), expected, atol=1e-12)


@given(feet=plane, point=st.tuples(st.floats(-1, 1), st.floats(-1, 1)).map(np.array))
def test_the_polygon_is_the_convex_hull(feet: np.ndarray, point: np.ndarray) -> None:
    feet = np.round(feet, 3)
    try:
        hull = ConvexHull(feet)
    except Exception:  # noqa: BLE001  all feet on a line
        return
    found = support(feet, ALL, point)
    sides = hull.equations[:, :2] @ point + hull.equations[:, 2]
    assert found.margin_m == pytest.approx(-sides.max(), abs=1e-9)
    x, y = found.corners.T
    area = 0.5 * (x * np.roll(y, -1) - y * np.roll(x, -1)).sum()
    assert area == pytest.approx(hull.volume, abs=1e-9)


@given(feet=plane, standing=st.lists(st.booleans(), min_size=6, max_size=6).map(np.array))
def test_the_quick_answer_is_that_of_the_margin(feet: np.ndarray, standing: np.ndarray) -> None:
    point = np.array([0.0312, -0.0177])
    margin = float(support(feet, standing, point).margin_m)
    if abs(margin) > 1e-6:
        assert bool(carried(feet, standing, point)) == (margin > 0)


@pytest.mark.parametrize("legs", [(), (1,), (1, 4)])
def test_too_few_feet_carry_nothing(legs: tuple[int, ...]) -> None:
    standing = np.isin(np.arange(1, 7), legs)
    found = support(HEXAGON, standing, np.array([0.1, 0.05]))
    assert found.margin_m < 0
    assert np.isfinite(found.corners).all()


def test_a_foot_in_the_air_does_not_carry() -> None:
    standing = np.array([False, True, True, False, True, True])
    forward = np.array([0.6, 0.0])
    inside, outside = (support(HEXAGON, which, forward).margin_m for which in (ALL, standing))
    assert inside > 0
    assert outside == pytest.approx(-0.1)


def test_margins_of_several_points_are_those_of_each() -> None:
    random = np.random.default_rng(5)
    feet, standing = random.normal(size=(40, 6, 2)), random.random((40, 6)) < 0.6
    points = random.normal(size=(7, 2))
    together = margins_at_m(feet, standing, points)
    for row, point in zip(together, points, strict=True):
        np.testing.assert_allclose(row, support(feet, standing, np.broadcast_to(point, (40, 2))).margin_m)


# Clearance between legs.


def test_segments_are_as_far_apart_as_their_nearest_points() -> None:
    ends = np.random.default_rng(1).normal(size=(100, 4, 3))
    ends[:20, 1] = ends[:20, 0]  # points
    ends[20:40, 3] = ends[20:40, 2] + ends[20:40, 1] - ends[20:40, 0]  # parallel
    share = np.linspace(0, 1, 101)[:, np.newaxis]
    one = ends[:, np.newaxis, 0] + share * (ends[:, np.newaxis, 1] - ends[:, np.newaxis, 0])
    other = ends[:, np.newaxis, 2] + share * (ends[:, np.newaxis, 3] - ends[:, np.newaxis, 2])
    sampled = np.linalg.norm(one[:, :, np.newaxis] - other[:, np.newaxis], axis=-1).min(axis=(1, 2))
    exact = segment_distance_m(*(ends[:, index] for index in range(4)))
    assert exact == pytest.approx(sampled, abs=0.02)
    assert (exact <= sampled + 1e-9).all()


@pytest.mark.parametrize("name", ["ant", "pexod"])
def test_gaps_are_those_of_the_simulated_solids(name: str) -> None:
    robot = shipped(name)
    rng = np.random.default_rng(2)
    low, high = robot.joint_lower_rad, robot.joint_upper_rad
    with SimServos(robot) as servos:
        physics = servos.compiled.physics
        model, data = physics.model.ptr, physics.data.ptr
        geoms = {
            (leg, part): physics.model.name2id(f"{robot.name}/leg{leg}/{part}", "geom")
            for leg in range(1, 7)
            for part in PARTS
        }
        for joints_rad in rng.uniform(low, high, size=(5, 18)):
            data.qpos[7:] = joints_rad
            mujoco.mj_forward(model, data)
            clearance = leg_clearance(robot, joints_rad)
            for leg in range(1, 7):
                gaps = [
                    mujoco.mj_geomDistance(
                        model, data, geoms[leg, one], geoms[leg % 6 + 1, other], 10.0, np.zeros(6)
                    )
                    for one in PARTS
                    for other in PARTS
                ]
                gap_m = float(clearance.gaps_m[leg - 1])
                if gap_m <= 0:
                    assert min(gaps) <= robot.foot_radius_m
                    continue
                # A simulated tibia ends a foot's radius before the centre of the foot.
                assert gap_m <= min(gaps) + 1e-6
                assert gap_m == pytest.approx(min(gaps), abs=robot.foot_radius_m)


def test_gap_and_depth_belong_to_the_parts_that_are_named() -> None:
    """Of parts of different thickness the deepest overlap, as a share, is not always the least gap."""
    robot = replace(shipped("pexod"), link_radii_m=np.array([0.06, 0.03, 0.01]))
    rng = np.random.default_rng(7)
    joints_rad = rng.uniform(robot.joint_lower_rad, robot.joint_upper_rad, size=(50, 18))
    near = leg_clearance(robot, joints_rad)
    radii_m = np.append(robot.link_radii_m, robot.foot_radius_m)
    touching_m = radii_m[near.nearest].sum(axis=-1)
    assert near.depths == pytest.approx(np.maximum(0.0, -near.gaps_m / touching_m))
    assert ((near.depths > 0) == (near.gaps_m < 0)).all()


def with_capacity(robot: Robot, capacity: float, world: World) -> Robot:
    """The robot with a share of its torque, by which it carries a multiple of its weight in its stance.

    The two are no proportion: part of the torque carries the links themselves.
    """

    def weaker(share: float) -> Robot:
        return replace(robot, joint_max_torque_nm=share * robot.joint_max_torque_nm)

    def excess(share: float) -> float:
        found = load_capacity(weaker(share), robot.stance_angles_rad, ALL, friction=world.friction)
        return float(found) - capacity

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
@pytest.mark.parametrize(("name", "world"), [("ant", ICE), ("pexod", World()), ("phantomx", World())])
def test_a_robot_stands_above_a_capacity_of_one_and_sinks_below(name: str, world: World) -> None:
    robot = without_friction(name)
    # Where friction between the feet has to help, feet creep a little before it does.
    assert lowered_m(with_capacity(robot, 1.1, world), world) < 0.008
    assert lowered_m(with_capacity(robot, 0.9, world), world) > 0.02
