"""The scene: every robot and every floor is drawn where the physics has it."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.terrain import Floor, make_floor
from hexctl.backends.sim.world import load_world
from hexctl.browser.floor_scene import UNEVEN_HALF_M, FloorScene, heights_at
from hexctl.browser.play_panel import plain_worlds
from hexctl.browser.robot_parts import link_shape, trunk_shape
from hexctl.browser.robot_scene import (
    LIFTED_COLOR,
    MISSING_OPACITY,
    TOUCHING_COLOR,
    RobotScene,
)
from hexctl.browser.scene_server import SceneServer
from hexctl.errors import InputError
from hexctl.palette import FAILED_COLORS, LINK_COLORS, NOTICED_COLORS
from hexctl.recording.scene import LEVEL
from hexctl.robot.configs import config_names
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_meshes, load_robot
from hexctl.robot.rotations import matrix_of
from hexctl.types import JOINT_KINDS, N_LEGS, FloatArray, RobotState

ROBOTS = config_names("robots")


@pytest.fixture(scope="module")
def scene() -> Iterator[Any]:
    with SceneServer(0, title="test") as server:
        yield server.viser.scene


def moved(name: str) -> SimServos:
    """A simulated robot somewhere, with other angles than those of its stance."""
    servos = SimServos(name)
    servos.connect()
    data = servos.compiled.physics.data
    generator = np.random.default_rng(3)
    data.qpos[:7] = 0.3, -0.2, 0.4, *np.array([0.8, 0.3, -0.4, 0.2]) / np.sqrt(0.93)
    data.qpos[7:] += generator.uniform(-0.4, 0.4, 18)
    servos.compiled.physics.forward()
    return servos


@pytest.mark.parametrize("name", ROBOTS)
def test_every_part_is_where_the_physics_has_it(scene: Any, name: str) -> None:
    servos = moved(name)
    physics, robot = servos.compiled.physics, servos.robot
    drawn = RobotScene(scene, "/world/robot", robot, load_meshes(name), LEVEL)
    drawn.show(servos.true_state())
    at_m, turn = drawn._base.position, matrix_of(np.asarray(drawn._base.wxyz))
    for link, kind in enumerate(JOINT_KINDS):
        handle = drawn._links[link]
        for leg in range(N_LEGS):
            body = physics.model.name2id(f"{robot.name}/leg{leg + 1}/{kind}", "body")
            there = at_m + turn @ handle.batched_positions[leg]
            assert there == pytest.approx(physics.data.xpos[body], abs=1e-5)
            pose = turn @ matrix_of(handle.batched_wxyzs[leg].astype(float))
            assert pose == pytest.approx(physics.data.xmat[body].reshape(3, 3), abs=1e-5)
            geom = physics.model.name2id(f"{robot.name}/leg{leg + 1}/foot", "geom")
            foot = at_m + turn @ drawn._feet.batched_positions[leg]
            assert foot == pytest.approx(physics.data.geom_xpos[geom], abs=1e-5)
    drawn.remove()
    servos.close()


@pytest.mark.parametrize("name", ROBOTS)
def test_links_are_drawn_from_joint_to_joint(name: str) -> None:
    robot = load_robot(name)
    for link, radius_m in enumerate(robot.link_radii_m):
        vertices_m = link_shape(robot, link, None).vertices_m
        outward, up = robot.link_vectors_m[link]
        along = np.array([outward, 0.0, up]) / np.hypot(outward, up)
        reach = vertices_m @ along
        assert reach.min() == pytest.approx(-radius_m, rel=0.1)
        assert reach.max() == pytest.approx(np.hypot(outward, up) + radius_m, rel=0.1)
    size_m = np.ptp(trunk_shape(robot, None).vertices_m, axis=0)
    assert size_m[[0, 2]] == pytest.approx(np.array(robot.body.size_m)[[0, 2]], rel=0.02)


def test_meshes_are_drawn_with_their_scale_and_place(tmp_path: Path) -> None:
    solid = trimesh.creation.box((20.0, 10.0, 6.0))
    solid.export(tmp_path / "link.stl")
    (tmp_path / "mine.yaml").write_text(
        (Path("configs/robots/ant.yaml").read_text(encoding="utf-8"))
        + "meshes:\n  femur: {file: link.stl, scale: 0.001, position_m: [0.05, 0, 0], "
        + "rotation_deg: [0, 0, 90]}\n"
    )
    shape = link_shape(load_robot("ant"), 1, load_meshes(tmp_path / "mine.yaml")["femur"])
    assert shape.vertices_m.min(axis=0) == pytest.approx([0.045, -0.01, -0.003])
    assert shape.vertices_m.max(axis=0) == pytest.approx([0.055, 0.01, 0.003])


def test_failed_legs_are_red_and_suspected_ones_amber(scene: Any) -> None:
    drawn = RobotScene(scene, "/world/robot", load_robot("ant"), {}, LEVEL)
    drawn.color(
        {2: Failure(leg=2, kind="limp", joint="femur"), 5: Failure(leg=5, kind="missing")},
        {3: Failure(leg=3, kind="unknown")},
    )
    coxa, femur, tibia = drawn._links
    assert tuple(femur.batched_colors[1]) == FAILED_COLORS["femur"]
    assert tuple(tibia.batched_colors[1]) == LINK_COLORS["tibia"]
    assert tuple(coxa.batched_colors[4]) == FAILED_COLORS["coxa"]
    assert tuple(tibia.batched_colors[2]) == NOTICED_COLORS["tibia"]
    assert drawn._feet.batched_opacities[4] == pytest.approx(MISSING_OPACITY)
    assert tibia.batched_opacities.tolist() == pytest.approx([1, 1, 1, 1, MISSING_OPACITY, 1])
    drawn.color({}, {})
    assert tuple(femur.batched_colors[1]) == LINK_COLORS["femur"]
    assert tibia.batched_opacities is None
    drawn.remove()


def test_feet_show_contacts_and_shadows_lie_on_the_floor(scene: Any) -> None:
    servos = SimServos("ant", world="slope")
    servos.connect()
    floor = servos.compiled.floor
    drawn = RobotScene(scene, "/world/robot", servos.robot, {}, floor)
    for _ in range(20):
        servos.clock.tick()
    state = servos.true_state()
    drawn.show(state)
    contacts = state.foot_contacts
    assert contacts is not None
    assert contacts.any()
    colors = [tuple(color) for color in drawn._feet.batched_colors]
    assert colors == [TOUCHING_COLOR if one else LIFTED_COLOR for one in contacts]
    shadows = drawn._shadows.batched_positions @ matrix_of(floor.quaternion_world).T
    assert shadows @ floor.normal_world == pytest.approx(0.002, abs=1e-6)
    drawn.remove()
    servos.close()


def test_a_state_without_a_pose_is_refused(scene: Any) -> None:
    robot = load_robot("ant")
    drawn = RobotScene(scene, "/world/robot", robot, {}, LEVEL)
    with pytest.raises(InputError, match="pose"):
        drawn.show(RobotState(robot.stance_angles_rad, stamp_s=0.0, measured=True))
    drawn.remove()


def physics_height_m(servos: SimServos, x: float, y: float) -> float:
    """Height of the floor by a ray of MuJoCo from above."""
    import mujoco

    physics = servos.compiled.physics
    at, hit = np.array([x, y, 3.0]), np.array([-1], np.int32)
    groups = np.ones(6, np.uint8)
    trunk = physics.model.jnt_bodyid[0]
    down = np.array([0.0, 0.0, -1.0])
    distance = mujoco.mj_ray(physics.model.ptr, physics.data.ptr, at, down, groups, 1, trunk, hit)
    return 3.0 - float(distance)


def ground_vertices(scene: Any, floor: Floor) -> FloatArray:
    handle = scene.get_handle_by_name("/world/floor/ground")
    turned: FloatArray = handle.vertices.astype(float) @ matrix_of(floor.quaternion_world).T
    return turned


@pytest.mark.parametrize("world", plain_worlds())
def test_the_floor_is_drawn_where_the_physics_has_it(scene: Any, world: str) -> None:
    servos = SimServos("ant", world=world)
    servos.connect()
    floor = make_floor(load_world(world), 0)
    drawn = FloorScene(scene, "/world/floor", floor)
    drawn.follow(np.array([1.3, -0.7, 0.0]))
    vertices = ground_vertices(scene, floor)
    generator = np.random.default_rng(5)
    inner = vertices[(np.abs(vertices[:, :2] - [1.3, -0.7]) < 0.9 * UNEVEN_HALF_M).all(axis=1)]
    errors_m = [
        abs(physics_height_m(servos, x, y) - z)
        for x, y, z in (inner if len(inner) else vertices)[generator.permutation(max(len(inner), 4))[:60]]
    ]
    # MuJoCo has two triangles in a cell; the sides of blocks are one cell of 1 cm wide.
    assert np.median(errors_m) < 5e-4
    assert np.mean(np.array(errors_m) > 2e-3) < 0.15
    drawn.remove()
    servos.close()


def test_the_piece_of_floor_follows_the_robot(scene: Any) -> None:
    floor = make_floor(load_world("rough"), 0)
    drawn = FloorScene(scene, "/world/floor", floor)
    drawn.begin(np.zeros(3), 0.0)
    for x in np.arange(0.0, 2.6, 0.05):
        drawn.follow(np.array([x, 0.0, 0.1]))
    drawn.draw_path()
    vertices = ground_vertices(scene, floor)
    assert vertices[:, 0].min() < 2.5 < vertices[:, 0].max()
    path = scene.get_handle_by_name("/world/floor/path").points
    assert path[-1, 1, :2] == pytest.approx([2.55, 0.0], abs=0.06)
    assert path[:, :, 2].max() == pytest.approx(
        float(heights_at(floor, path[:, 1, :2].astype(float)).max()) + 0.01, abs=0.01
    )
    drawn.remove()
