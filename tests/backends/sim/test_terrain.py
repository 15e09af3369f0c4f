"""The floor of the physics is the floor that the world describes: rays are shot at it."""

import numpy as np
import pytest

from hexctl.backends.sim.simulation_model import FIRST_JOINT, make_simulation
from hexctl.backends.sim.terrain import PIT_SHARE, ROUGH_CELLS, ROUGH_HALF_SIZE_M, START_M, make_floor
from hexctl.backends.sim.world import World, load_world
from hexctl.types import FloatArray
from tests.robots import ROBOT_NAMES, shipped


def _heights_below(world: World, points: FloatArray, seed: int = 0) -> FloatArray:
    """Height of the floor at points (N, 2), found by a ray from above."""
    import mujoco

    physics = make_simulation(shipped(), world, seed=seed).physics
    physics.data.qpos[:2] = 100.0  # out of the way
    physics.forward()
    heights = []
    for x, y in points.tolist():
        start = np.array([x, y, 10.0])
        down, hit = np.array([0.0, 0.0, -1.0]), np.zeros(1, dtype=np.int32)
        distance = mujoco.mj_ray(physics.model.ptr, physics.data.ptr, start, down, None, 1, -1, hit)
        heights.append(start[2] - distance)
    return np.array(heights)


POINTS = np.random.default_rng(1).uniform(-3, 3, (60, 2))


@pytest.mark.parametrize(("slope_deg", "uphill_deg"), [(0.0, 0.0), (12.0, 0.0), (12.0, 215.0)])
def test_a_slope_rises_toward_uphill(slope_deg: float, uphill_deg: float) -> None:
    uphill = np.array([np.cos(np.radians(uphill_deg)), np.sin(np.radians(uphill_deg))])
    heights = _heights_below(World(slope_deg=slope_deg, slope_direction_deg=uphill_deg), POINTS)
    np.testing.assert_allclose(heights, np.tan(np.radians(slope_deg)) * (POINTS @ uphill), atol=1e-9)


def test_the_normal_stands_on_the_slope_and_the_robot_stands_along_it() -> None:
    world = World(slope_deg=15, slope_direction_deg=-70.0)
    floor = make_floor(world, 0)
    heights = _heights_below(world, POINTS)
    surface = np.column_stack([POINTS, heights])
    np.testing.assert_allclose(surface @ floor.normal_world, 0, atol=1e-9)
    physics = make_simulation(shipped(), world).physics
    body_up = np.array(physics.named.data.xmat["ant/"]).reshape(3, 3)[:, 2]
    np.testing.assert_allclose(body_up, floor.normal_world, atol=1e-12)
    feet = np.array([physics.named.data.geom_xpos[f"ant/leg{leg}/foot"] for leg in range(1, 7)])
    np.testing.assert_allclose(feet @ floor.normal_world, shipped().foot_radius_m, atol=1e-9)


@pytest.mark.parametrize("roughness_m", [0.003, 0.02])
def test_a_rough_floor_has_the_roughness_that_is_asked_for(roughness_m: float) -> None:
    world = World(roughness_m=roughness_m, roughness_length_m=0.12)
    heights = make_floor(world, 4).heights_m
    assert heights is not None
    inside = heights[25:-25, 25:-25]
    assert inside.std() == pytest.approx(roughness_m, rel=0.02)
    assert abs(inside.mean()) < roughness_m
    edge = np.concatenate([heights[0], heights[-1], heights[:, 0], heights[:, -1]])
    np.testing.assert_allclose(edge, heights.min(), atol=1e-12)
    cells = np.random.default_rng(2).integers(50, ROUGH_CELLS - 50, (50, 2))
    axis = np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, ROUGH_CELLS)
    found = _heights_below(world, np.stack([axis[cells[:, 1]], axis[cells[:, 0]]], axis=-1), seed=4)
    np.testing.assert_allclose(found, heights[cells[:, 0], cells[:, 1]], atol=1e-5)


def test_a_bump_is_as_wide_as_the_world_says() -> None:
    """Heights closer than a bump's width belong together, heights a few widths apart do not."""
    cell_m = 2 * ROUGH_HALF_SIZE_M / ROUGH_CELLS
    for length_m in (0.2, 0.8):
        heights = make_floor(World(roughness_m=0.01, roughness_length_m=length_m), 1).heights_m
        assert heights is not None
        heights = heights[25:-25, 25:-25]
        apart = [round(share * length_m / cell_m) for share in (0.25, 2.0)]
        near, far = (np.corrcoef(heights[cells:].ravel(), heights[:-cells].ravel())[0, 1] for cells in apart)
        assert near > 0.7
        assert abs(far) < 0.2


def test_a_rough_floor_sinks_to_its_lowest_point_within_its_last_metre() -> None:
    """Nothing steps up or down where the even floor beyond the bumps begins."""
    world = World(roughness_m=0.05, roughness_length_m=0.3)
    heights = make_floor(world, 3).heights_m
    assert heights is not None
    lowest = heights.min()
    axis = np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, ROUGH_CELLS)
    to_edge = np.minimum(*np.meshgrid(ROUGH_HALF_SIZE_M - np.abs(axis), ROUGH_HALF_SIZE_M - np.abs(axis)))
    share = np.clip(to_edge, 0, 1)
    assert (heights - lowest <= share * 10 * world.roughness_m + 1e-12).all()
    assert heights[to_edge >= 1].std() == pytest.approx(world.roughness_m, rel=0.1)
    side = np.linspace(-7, 7, 30)
    inside, outside = (
        _heights_below(world, np.column_stack([np.full(30, x), side]), seed=3) for x in (7.999, 8.001)
    )
    np.testing.assert_allclose(inside, outside, atol=1e-3)
    np.testing.assert_allclose(outside, lowest, atol=1e-6)


@pytest.mark.parametrize(("name", "seed"), [*zip(ROBOT_NAMES, range(3), strict=True)])
def test_no_foot_starts_inside_a_rough_floor(name: str, seed: int) -> None:
    physics = make_simulation(shipped(name), World(roughness_m=0.02), seed=seed).physics
    assert physics.data.ncon == 0 or physics.data.contact.dist.min() > -1e-3
    np.testing.assert_array_equal(physics.data.qpos[FIRST_JOINT:], shipped(name).stance_angles_rad)


UNEVEN = {name: load_world(name) for name in ("steps", "pits", "ramps")}


def _middle(name: str, seed: int = 0) -> tuple[FloatArray, FloatArray]:
    """Coordinates of the cells within 4 m, (N,), and their heights, (N, N)."""
    heights = make_floor(UNEVEN[name], seed).heights_m
    assert heights is not None
    axis = np.linspace(-ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, len(heights))
    near = np.abs(axis) <= 4
    return axis[near], heights[np.ix_(near, near)]


@pytest.mark.parametrize("name", UNEVEN)
def test_the_start_of_an_uneven_world_is_even_and_no_foot_starts_inside_the_floor(name: str) -> None:
    axis, heights = _middle(name)
    start = np.abs(axis) <= START_M
    np.testing.assert_allclose(heights[np.ix_(start, start)], 0, atol=1e-12)
    assert heights.std() > 1e-3
    physics = make_simulation(shipped(), UNEVEN[name]).physics
    assert physics.data.ncon == 0 or physics.data.contact.dist.min() > -1e-3


def test_blocks_have_random_heights_up_to_the_step_height_apart_and_steep_sides() -> None:
    axis, heights = _middle("steps")
    assert np.abs(heights).max() <= 0.015
    np.testing.assert_allclose([heights.min(), heights.max()], [-0.015, 0.015], atol=5e-4)
    changes = np.flatnonzero(np.abs(np.diff(heights[0])) > 1e-9)
    assert np.diff(axis[changes]).min() >= UNEVEN["steps"].block_m - 0.011, "one cell wide"
    assert make_floor(UNEVEN["steps"], 1) != make_floor(UNEVEN["steps"], 2)


def test_a_quarter_of_the_floor_is_pits_of_one_depth() -> None:
    _, heights = _middle("pits")
    np.testing.assert_allclose(np.unique(heights), [-0.02, 0.0], atol=1e-9)
    assert (heights < -0.01).mean() == pytest.approx(PIT_SHARE, abs=0.04)


def test_ramps_go_up_and_down_at_their_inclination() -> None:
    axis, heights = _middle("ramps")
    world, slope = UNEVEN["ramps"], np.gradient(heights[0], axis)
    np.testing.assert_allclose(np.ptp(heights, axis=0), 0, atol=1e-12)
    tangent = np.tan(np.radians(world.ramp_deg))
    steep = np.abs(np.abs(slope) - tangent) < 1e-6
    assert steep[np.abs(axis) > START_M + 0.1].mean() > 0.8, "all but the crests and valleys"
    assert heights.max() == pytest.approx(tangent * world.ramp_length_m, rel=0.1)
    assert heights.min() == pytest.approx(0, abs=1e-12)


@pytest.mark.parametrize("name", ["ant", "lukas"])
def test_no_foot_that_falls_on_a_soft_floor_of_blocks_sinks_in_beyond_its_middle(name: str) -> None:
    """A height field holds a foot that is deeper between the inner sides of its cells."""
    robot, world = shipped(name), UNEVEN["steps"].model_copy(update={"contact_time_s": 0.04})
    physics = make_simulation(robot, world).physics
    physics.data.qpos[2] += robot.standing_height_m / 2
    feet, deepest_m = [f"{name}/leg{leg}/foot" for leg in range(1, 7)], np.inf
    for _ in range(250):
        physics.step()
        deepest_m = min(deepest_m, physics.named.data.geom_xpos[feet, "z"].min())
    assert deepest_m > 0
    assert physics.data.qpos[2] == pytest.approx(robot.standing_height_m, rel=0.1)
