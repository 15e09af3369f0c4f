"""The robot's parts in a recording: meshes where there are some, solids of its geometry elsewhere."""

import pytest

from hexctl.record import paths, style
from hexctl.record.recording import Recording
from hexctl.robot.failure import Failure
from hexctl.robot.meshes import load_meshes
from tests.record.conftest import ReadBack, make_plan
from tests.robot.meshmaking import glb_box, stl_box
from tests.robots import edited_file, put, shipped


@pytest.fixture(scope="module")
def read(tmp_path_factory: pytest.TempPathFactory) -> ReadBack:
    folder = tmp_path_factory.mktemp("looks")
    (folder / "trunk.stl").write_bytes(stl_box())
    (folder / "shin.glb").write_bytes(glb_box())
    turned = {"file": "shin.glb", "scale": 0.02, "position_m": [0.0, 0.0, -0.06], "rotation_deg": [0, 0, 90]}
    file = edited_file(folder, put("meshes", {"body": {"file": "trunk.stl"}, "tibia": turned}))
    plan = make_plan(shipped(), failure=Failure(leg=5))
    Recording(folder / "a.rrd", shipped(), plan, title="looks", meshes=load_meshes(file)).close()
    return ReadBack(folder / "a.rrd")


def test_a_mesh_takes_the_place_of_the_solid(read: ReadBack) -> None:
    assert bytes(read.values(f"/{paths.BODY}", "Asset3D:blob")[0][0]) == stl_box()
    assert not read.values(f"/{paths.BODY}", "Cylinders3D:lengths")
    for leg in paths.LEGS:
        path = f"/{paths.link_path(leg, 'tibia')}"
        assert bytes(read.values(path, "Asset3D:blob")[0][0]) == glb_box()
        assert read.values(path, "Asset3D:media_type") == [["model/gltf-binary"]]
        assert not read.values(path, "Capsules3D:lengths")


def test_parts_without_a_mesh_stay_solids(read: ReadBack) -> None:
    assert read.values(f"/{paths.link_path(2, 'femur')}", "Capsules3D:lengths")
    assert not read.values(f"/{paths.link_path(2, 'femur')}", "Asset3D:blob")


def test_a_mesh_is_put_in_its_place(read: ReadBack) -> None:
    path = f"/{paths.link_path(1, 'tibia')}"
    assert read.values(path, "InstancePoses3D:translations")[0][0] == pytest.approx([0, 0, -0.06])
    assert read.values(path, "InstancePoses3D:scales")[0][0] == pytest.approx([0.02] * 3)
    half = 0.5**0.5
    assert read.values(path, "InstancePoses3D:quaternions")[0][0] == pytest.approx([0, 0, half, half])


def test_only_a_mesh_without_colours_or_of_the_failed_leg_is_tinted(read: ReadBack) -> None:
    assert read.values(f"/{paths.BODY}", "Asset3D:albedo_factor") == [[style.packed(style.BODY_COLOR)]]
    assert not read.values(f"/{paths.link_path(1, 'tibia')}", "Asset3D:albedo_factor")
    failed = read.values(f"/{paths.link_path(5, 'tibia')}", "Asset3D:albedo_factor")
    assert failed == [[style.packed(style.FAILED_COLORS["tibia"])]]
