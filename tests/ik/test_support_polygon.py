"""The centre of gravity against MuJoCo, the support polygon against SciPy's hull."""

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.ik.legs import foot_positions_body
from hexctl.ik.support_polygon import (
    carried,
    centre_of_mass_body,
    foot_heights_body,
    margins_at_m,
    support,
    to_world,
)
from hexctl.types import N_JOINTS
from tests.robots import shipped

ALL = np.ones(6, dtype=bool)
HEXAGON = np.stack([np.cos(np.arange(6) * np.pi / 3), np.sin(np.arange(6) * np.pi / 3)], axis=-1)
plane = st.lists(st.floats(-1, 1), min_size=12, max_size=12).map(lambda xy: np.reshape(xy, (6, 2)))


@pytest.mark.parametrize(("name", "own"), [("ant", False), ("pexod", False), ("phantomx", True)])
def test_the_centre_of_mass_is_that_of_the_simulated_body(name: str, own: bool) -> None:
    from hexctl.backends.sim.simulation_model import FIRST_JOINT, make_simulation
    from hexctl.backends.sim.world import World

    robot = shipped(name)
    if own:
        coms = 0.3 * robot.link_vectors_m + np.array([[0.0, 0.01], [0.005, -0.01], [-0.01, -0.02]])
        robot = replace(robot, body=replace(robot.body, com_m=(0.02, -0.01, 0.03)), link_coms_m=coms)
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
    from scipy.spatial import ConvexHull

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
