"""Clearance between legs: against sampled segments and MuJoCo's own distances."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.ik.clearance import PARTS, leg_clearance, segment_distance_m
from tests.robots import shipped


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
    import mujoco

    from hexctl.backends.sim.servos import SimServos

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
