"""The static part of a recording, and the layout that it opens with."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.terrain import make_floor
from hexctl.backends.sim.world import World
from hexctl.control.log import TickLog
from hexctl.recording import paths
from hexctl.recording.blueprint import make_blueprint
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.recording import Recording
from hexctl.recording.scene import MAX_VERTICES, make_floor_mesh
from hexctl.recording.series import DEVIATION
from hexctl.recording.side_by_side import names_of, write_together
from hexctl.robot.failure import Failure
from hexctl.robot.loader import load_meshes
from hexctl.runs.run import run
from hexctl.types import JointTargets
from tests.recording.conftest import ReadBack, Trial, make_plan
from tests.robot.meshmaking import glb_box, stl_box
from tests.robots import edited_file, put, shipped


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> ReadBack:
    folder = tmp_path_factory.mktemp("looks")
    (folder / "trunk.stl").write_bytes(stl_box())
    (folder / "shin.glb").write_bytes(glb_box())
    turned = {"file": "shin.glb", "scale": 0.02, "position_m": [0.0, 0.0, -0.06], "rotation_deg": [0, 0, 90]}
    file = edited_file(folder, put("meshes", {"body": {"file": "trunk.stl"}, "tibia": turned}))
    plan = make_plan(shipped(), belief=Failure(leg=5))
    log = TickLog()
    with (
        Recording(folder / "a.rrd", shipped(), plan, title="looks", meshes=load_meshes(file)) as recording,
        SimServos(shipped()) as servos,
    ):
        clock, targets = servos.clock, JointTargets(shipped().stance_angles_rad, 0.0)
        log.record(clock.tick(), servos.read(), targets.joint_positions_rad, targets)
        recording.write_block(log, 0, 1)
    return ReadBack(folder / "a.rrd")


def test_a_mesh_takes_the_place_of_the_solid(read: ReadBack) -> None:
    assert bytes(read.values(f"/{paths.BODY}", "Asset3D:blob")[0][0]) == stl_box()
    assert not read.values(f"/{paths.BODY}", "Cylinders3D:lengths")
    for leg in paths.LEGS:
        path = f"/{paths.link_path(leg, 'tibia')}"
        assert bytes(read.values(path, "Asset3D:blob")[0][0]) == glb_box()
        assert read.values(path, "Asset3D:media_type") == [["model/gltf-binary"]]
        assert not read.values(path, "Capsules3D:lengths")
    assert read.values(f"/{paths.link_path(2, 'femur')}", "Capsules3D:lengths"), "without a mesh"


def test_a_mesh_is_put_in_its_place(read: ReadBack) -> None:
    path = f"/{paths.link_path(1, 'tibia')}"
    assert read.values(path, "InstancePoses3D:translations")[0][0] == pytest.approx([0, 0, -0.06])
    assert read.values(path, "InstancePoses3D:scales")[0][0] == pytest.approx([0.02] * 3)
    half = 0.5**0.5
    assert read.values(path, "InstancePoses3D:quaternions")[0][0] == pytest.approx([0, 0, half, half])


def floor_mesh(heights_m: np.ndarray | None, path_end_m: np.ndarray) -> list[np.ndarray]:
    """Positions, triangles and normals of the floor's mesh."""
    mesh = make_floor_mesh(heights_m, path_end_m)
    parts = (mesh.vertex_positions, mesh.triangle_indices, mesh.vertex_normals)
    return [np.array(part.as_arrow_array().to_pylist(), dtype=float) for part in parts]


def test_an_even_floor_is_two_triangles_around_the_whole_path() -> None:
    positions, triangles, _ = floor_mesh(None, np.array([4.0, 0.0]))
    assert len(triangles) == 2
    assert positions[:, 0].min() < -1
    assert positions[:, 0].max() > 5


def test_bumps_have_the_heights_of_the_floor_and_face_up() -> None:
    floor = make_floor(World(roughness_m=0.01), seed=3)
    assert floor.heights_m is not None
    positions, triangles, normals = floor_mesh(floor.heights_m, np.array([1.0, 0.0]))
    axis = np.linspace(-8, 8, 400)
    column, row = (np.searchsorted(axis, positions[:, i] - 1e-5) for i in (0, 1))
    np.testing.assert_allclose(positions[:, 2], floor.heights_m[row, column], atol=1e-6)
    corners = positions[triangles.astype(int)]
    facing = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    assert (facing[:, 2] > 0).all()
    assert (normals[:, 2] > 0).all()
    positions, _, _ = floor_mesh(floor.heights_m, np.array([50.0, 50.0]))
    assert len(positions) <= 1.1 * MAX_VERTICES


def test_a_recording_opens_with_the_time_of_the_walk_and_a_live_view_follows_it(
    trial: Trial, tmp_path: Path
) -> None:
    import rerun as rr

    shown = {}
    for live in (False, True):
        path = tmp_path / f"{live}.rbl"
        layout = make_blueprint(trial.robot, trial.plan.heading_rad, trial.floor, watched=True, live=live)
        layout.save("hexctl", str(path))
        reader = rr.chunk.RrdReader(path)
        columns: dict[str, Any] = {}
        for chunk in reader.stream(store=reader.blueprints()[0]).to_chunks():
            batch = chunk.to_record_batch()
            columns |= {
                name: batch.column(name).to_pylist()[-1] for name in batch.schema.names if ":" in name
            }
        shown[live] = columns
    assert all(shown[live]["TimePanelBlueprint:timeline"] == [paths.WALK_TIMELINE] for live in shown)
    playing, following = (shown[live]["TimePanelBlueprint:play_state"] for live in (False, True))
    assert playing != following


@pytest.fixture(scope="module")
def recordings(tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    folder = tmp_path_factory.mktemp("walks")
    made = [folder / "a walk.rrd", folder / "b.rrd"]
    for path, policy in zip(made, ("walk-on", "glide"), strict=True):
        run(
            gait="tripod",
            failure="5:locked@1",
            policy=policy,
            duration_s=1.5,
            record=path,
        )
    return made


@pytest.fixture(scope="module")
def written(recordings: list[Path], tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    return write_together(recordings, tmp_path_factory.mktemp("together") / "new")


@pytest.mark.slow
def test_all_walks_are_in_one_scene_each_in_a_lane(written: list[Path], recordings: list[Path]) -> None:
    scene = ReadBack(written[0])
    left_m, names = [], []
    for number, recording in enumerate(recordings, start=1):
        trial = read_trial(recording)
        ((place,),) = scene.values(f"/lane{number}", "Transform3D:translation")
        left_m.append(place[1])
        moved = scene.values(f"/lane{number}/{paths.ROBOT}", "Transform3D:translation")
        np.testing.assert_allclose(moved[-1][0][:2], trial.base_position_world[-1, :2], atol=1e-3)
        assert scene.values(f"/lane{number}/{DEVIATION.path}", "Scalars:scalars")
        (name,) = [one for (one,) in scene.values(f"/lane{number}/{paths.BODY}/name", "Points3D:labels")]
        names.append(name)
    assert len(set(names)) == 2
    assert len(set(names_of([read_trial(recordings[0])] * 2))) == 2
    assert abs(left_m[0] - left_m[1]) > 2 * read_trial(recordings[0]).robot.stance_radius_m
    grounds = [entity for entity in scene.entities if entity.endswith(paths.GROUND)]
    assert grounds == [f"/lane1/{paths.GROUND}"], "two floors in one place would flicker"


def test_the_scene_leads_to_a_copy_of_each_walk(written: list[Path], recordings: list[Path]) -> None:
    scene = ReadBack(written[0])
    for number, (recording, copy) in enumerate(zip(recordings, written[1:], strict=True), start=1):
        ((text,),) = scene.values(f"/lane{number}/{paths.SUMMARY}", "TextDocument:text")
        assert copy.as_uri() in text
        before, after = read_trial(recording), read_trial(copy)
        np.testing.assert_array_equal(before.measured_rad, after.measured_rad)
        assert before.properties == after.properties
        assert before.floor_quaternion.tolist() == after.floor_quaternion.tolist()
