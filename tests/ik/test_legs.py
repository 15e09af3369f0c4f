"""Kinematics both ways: there and back, against a scalar reference and against MuJoCo."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.sim.simulation_model import FIRST_JOINT, make_simulation
from hexctl.backends.sim.world import World
from hexctl.errors import LimitError, ReachError
from hexctl.ik.legs import (
    check_joint_limits,
    foot_positions_body,
    link_points_body,
    solve_legs,
    solve_legs_within_limits,
)
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, N_JOINTS, N_LEGS, BoolArray, FloatArray
from tests.ik.reference import leg_angles
from tests.robots import ROBOT_NAMES, shipped

names = st.sampled_from(ROBOT_NAMES)
eighteen = st.lists(st.floats(0, 1), min_size=N_JOINTS, max_size=N_JOINTS).map(np.array)


def _angles_within_limits(robot: Robot, shares: FloatArray) -> FloatArray:
    span = robot.joint_upper_rad - robot.joint_lower_rad
    angles: FloatArray = robot.joint_lower_rad + shares * span
    return angles


def _feet_around(robot: Robot, shares: FloatArray) -> FloatArray:
    """Feet all around the mounts, some of them out of reach."""
    reach = float(np.hypot(*robot.link_vectors_m.T).sum())
    return robot.mount_positions_body + (2 * shares.reshape(N_LEGS, 3) - 1) * reach


def _foot_before_the_coxa(robot: Robot, angles: FloatArray) -> BoolArray:
    """Whether each foot is on the side of the coxa axis to which its leg points."""
    points = link_points_body(robot, angles)
    yaw = robot.mount_yaws_rad + angles[::3]
    outward = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
    return np.asarray(((points[:, 3] - points[:, 0])[:, :2] * outward).sum(axis=-1) > 1e-3)


def _knee_up(robot: Robot, angles: FloatArray) -> BoolArray:
    """Whether each knee is above the line from the femur joint to the foot."""
    slopes = np.arctan2(robot.link_vectors_m[:, 1], robot.link_vectors_m[:, 0])
    return np.asarray(np.sin(angles[2::3] + slopes[2] - slopes[1]) < -1e-3)


@given(name=names, shares=eighteen)
def test_feet_that_can_be_reached_come_back_from_their_angles(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = _feet_around(robot, shares)
    solution = solve_legs(robot, feet)
    back = foot_positions_body(robot, solution.joint_positions_rad)
    reachable = solution.reachable
    np.testing.assert_allclose(back[reachable], feet[reachable], atol=1e-7)
    off = np.linalg.norm(back - feet, axis=-1)
    assert (off[~reachable] > 0).all(), "a foot that can be put in place is reachable"


@given(name=names, shares=eighteen)
def test_angles_come_back_from_their_feet(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    angles = _angles_within_limits(robot, shares)
    feet = foot_positions_body(robot, angles)
    solution = solve_legs(robot, feet)
    before = _foot_before_the_coxa(robot, angles)
    back = foot_positions_body(robot, solution.joint_positions_rad)
    np.testing.assert_allclose(back[before], feet[before], atol=1e-6)
    same = np.repeat(before & _knee_up(robot, angles), 3)
    np.testing.assert_allclose(solution.joint_positions_rad[same], angles[same], atol=1e-6)


@given(name=names, shares=eighteen)
def test_all_legs_at_once_equal_the_scalar_reference(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = _feet_around(robot, shares)
    solution = solve_legs(robot, feet)
    for leg in (np.flatnonzero(solution.reachable) + 1).tolist():
        x, y, z = feet[leg - 1].tolist()
        expected = leg_angles(robot, leg, (x, y, z))
        got = solution.joint_positions_rad[3 * (leg - 1) : 3 * leg]
        difference = np.angle(np.exp(1j * (got - np.array(expected))))
        np.testing.assert_allclose(difference, 0, atol=1e-6)


@given(name=names, shares=eighteen)
def test_a_foot_out_of_reach_is_flagged_and_the_leg_points_at_it(name: str, shares: FloatArray) -> None:
    robot = shipped(name)
    feet = robot.mount_positions_body + 5 * (_feet_around(robot, shares) - robot.mount_positions_body)
    solution = solve_legs(robot, feet)
    assert np.isfinite(solution.joint_positions_rad).all()
    femur, tibia = np.hypot(*robot.link_vectors_m[1:].T)
    points = link_points_body(robot, solution.joint_positions_rad)
    to_foot, to_wanted = points[:, 3] - points[:, 1], feet - points[:, 1]
    distance = np.linalg.norm(to_wanted, axis=-1)
    beyond = distance > femur + tibia + 1e-9
    assert not solution.reachable[beyond].any()
    np.testing.assert_allclose(np.linalg.norm(to_foot[beyond], axis=-1), femur + tibia, atol=1e-9)
    cosine = (to_foot * to_wanted).sum(axis=-1) / np.linalg.norm(to_foot, axis=-1) / distance
    np.testing.assert_allclose(cosine[beyond], 1, atol=1e-9)


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("where", ["coxa axis", "femur joint", "mount"])
def test_a_foot_too_near_is_flagged_and_finite(name: str, where: str) -> None:
    robot = shipped(name)
    points = link_points_body(robot, robot.stance_angles_rad)
    feet = {
        "coxa axis": points[:, 0] + [0, 0, -0.001],
        "femur joint": points[:, 1],
        "mount": robot.mount_positions_body,
    }[where]
    solution = solve_legs(robot, feet)
    assert np.isfinite(solution.joint_positions_rad).all()
    if where == "femur joint":
        assert not solution.reachable.any()


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_stance_of_the_file_is_the_solution_of_its_feet(name: str) -> None:
    robot = shipped(name)
    solution = solve_legs(robot, robot.stance_feet_body)
    assert solution.reachable.all()
    np.testing.assert_allclose(solution.joint_positions_rad, robot.stance_angles_rad, atol=1e-12)


def test_many_poses_at_once_equal_each_alone_to_the_last_bit() -> None:
    robot = shipped("phantomx")
    shares = np.random.default_rng(3).uniform(size=(4, 5, N_JOINTS))
    angles = _angles_within_limits(robot, shares)
    feet = foot_positions_body(robot, angles)
    together = solve_legs(robot, feet)
    for index in np.ndindex(4, 5):
        alone = solve_legs(robot, feet[index])
        assert np.array_equal(together.joint_positions_rad[index], alone.joint_positions_rad)
        assert np.array_equal(together.reachable[index], alone.reachable)
        assert np.array_equal(feet[index], foot_positions_body(robot, angles[index]))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_positive_angle_turns_left_and_lifts(name: str) -> None:
    robot = shipped(name)
    rest = link_points_body(robot, robot.stance_angles_rad)
    for index, kind in enumerate(JOINT_KINDS):
        angles = robot.stance_angles_rad.copy()
        angles[index::3] += 0.01
        before, after = (points[:, 3] - rest[:, index] for points in (rest, link_points_body(robot, angles)))
        if kind == "coxa":
            assert (before[:, 0] * after[:, 1] > before[:, 1] * after[:, 0]).all()
        else:
            yaw = robot.mount_yaws_rad
            outward = np.stack([np.cos(yaw), np.sin(yaw)], axis=-1)
            out, moved_out = ((foot[:, :2] * outward).sum(axis=-1) for foot in (before, after))
            assert (out * after[:, 2] > before[:, 2] * moved_out).all(), "turned upward about its joint"


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_feet_and_joints_stand_where_mujoco_has_them(name: str) -> None:
    robot = shipped(name)
    physics = make_simulation(robot, World()).physics
    rng = np.random.default_rng(11)
    for _ in range(50):
        angles = _angles_within_limits(robot, rng.uniform(size=N_JOINTS))
        quaternion = rng.standard_normal(4)
        base = rng.uniform(-2, 2, 3)
        physics.data.qpos[:] = [*base, *(quaternion / np.linalg.norm(quaternion)), *angles]
        physics.forward()
        to_world = np.array(physics.named.data.xmat[f"{robot.name}/"]).reshape(3, 3)
        points = link_points_body(robot, angles) @ to_world.T + base
        joints = physics.data.xanchor[1:].reshape(N_LEGS, 3, 3)
        np.testing.assert_allclose(points[:, :3], joints, atol=1e-9)
        sites = [physics.named.data.site_xpos[f"{robot.name}/leg{leg}/foot"] for leg in range(1, 7)]
        geoms = [physics.named.data.geom_xpos[f"{robot.name}/leg{leg}/foot"] for leg in range(1, 7)]
        np.testing.assert_allclose(points[:, 3], sites, atol=1e-9)
        np.testing.assert_allclose(points[:, 3], geoms, atol=1e-9)
        np.testing.assert_array_equal(physics.data.qpos[FIRST_JOINT:], angles)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_stance_is_within_limits(name: str) -> None:
    robot = shipped(name)
    np.testing.assert_array_equal(
        solve_legs_within_limits(robot, robot.stance_feet_body),
        solve_legs(robot, robot.stance_feet_body).joint_positions_rad,
    )


@pytest.mark.parametrize("leg", range(1, N_LEGS + 1))
def test_a_foot_out_of_reach_names_its_leg_and_how_far_it_may_be(leg: int) -> None:
    robot = shipped()
    feet = np.tile(robot.stance_feet_body, (5, 1, 1))
    feet[3, leg - 1] *= 1.5
    feet[4, leg - 1] *= 2.0
    with pytest.raises(ReachError) as refused:
        solve_legs_within_limits(robot, feet)
    message = str(refused.value)
    hip = np.array([0.080 + 0.0503, -0.0112])
    distance = np.hypot(*(np.array([0.408, -0.242]) - hip))
    assert f"leg {leg}: foot {distance:.4f} m" in message, "the worst of its positions"
    assert "allowed: 0.0441 to 0.1889 m" in message
    assert "\n" not in message


@pytest.mark.parametrize("leg", range(1, N_LEGS + 1))
@pytest.mark.parametrize("kind", JOINT_KINDS)
@pytest.mark.parametrize("side", [-1, 1])
def test_a_joint_out_of_range_is_named_with_its_angle_and_range(leg: int, kind: str, side: int) -> None:
    robot = shipped("pexod")
    joint = 3 * (leg - 1) + JOINT_KINDS.index(kind)
    angles = robot.stance_angles_rad.copy()
    limits = robot.joint_lower_rad if side < 0 else robot.joint_upper_rad
    angles[joint] = limits[joint] + side * np.radians(3)
    degrees = np.degrees(angles[joint])
    with pytest.raises(LimitError, match=f"leg {leg} {kind}: needs {degrees:.1f} deg") as refused:
        check_joint_limits(robot, angles)
    most = 90 if kind == "coxa" else 45
    assert f"allowed: -{most} to {most} deg" in str(refused.value)


def test_the_worst_joint_of_many_poses_is_named() -> None:
    robot = shipped()
    angles = np.tile(robot.stance_angles_rad, (4, 1))
    angles[1, 3] = np.radians(61)
    angles[2, 10] = np.radians(95)
    with pytest.raises(LimitError, match=r"leg 4 femur: needs 95\.0 deg; allowed: -90 to 90 deg"):
        check_joint_limits(robot, angles)


def test_a_foot_that_only_a_joint_beyond_its_range_reaches_is_refused() -> None:
    robot = shipped()
    angles = robot.stance_angles_rad.copy()
    angles[6] = np.radians(70)
    with pytest.raises(LimitError, match=r"leg 3 coxa: needs 70\.0 deg; allowed: -60 to 60 deg"):
        solve_legs_within_limits(robot, foot_positions_body(robot, angles))


def test_the_end_of_the_range_itself_is_allowed() -> None:
    robot = shipped()
    check_joint_limits(robot, robot.joint_upper_rad)
    check_joint_limits(robot, np.stack([robot.joint_lower_rad, robot.joint_upper_rad]))
