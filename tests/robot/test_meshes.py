"""The `meshes:` section: looks that a recording shows, and nothing else about the robot."""

import os
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_meshes, load_robot
from tests.robot.meshmaking import MAKERS, glb_box, stl_box
from tests.robots import edited_file, put


def robot_file(folder: Path, **meshes: Any) -> Path:
    return edited_file(folder, put("meshes", meshes))


@pytest.mark.parametrize("name", MAKERS)
def test_each_kind_of_file_is_taken_whole(name: str, tmp_path: Path) -> None:
    content = MAKERS[name]()
    (tmp_path / "looks").mkdir()
    (tmp_path / "looks" / name).write_bytes(content)
    meshes = load_meshes(robot_file(tmp_path, tibia={"file": f"looks/{name}"}))
    assert list(meshes) == ["tibia"]
    mesh = meshes["tibia"]
    assert mesh.content == content
    assert mesh.scale == 1
    np.testing.assert_array_equal(mesh.position_m, 0)
    np.testing.assert_array_equal(mesh.quaternion, [1, 0, 0, 0])
    assert mesh.coloured == (not name.endswith(".stl"))


def test_scale_and_pose_are_those_of_the_file(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(stl_box())
    where = {"scale": 0.001, "position_m": [0.1, 0.2, 0.3], "rotation_deg": [90, 0, 90]}
    mesh = load_meshes(robot_file(tmp_path, body={"file": "box.stl"} | where))["body"]
    assert mesh.scale == 0.001
    np.testing.assert_array_equal(mesh.position_m, [0.1, 0.2, 0.3])
    # About x first: y points up then, and stays up when turned about z.
    np.testing.assert_allclose(mesh.quaternion, [0.5, 0.5, 0.5, 0.5], atol=1e-12)


@pytest.mark.parametrize(
    ("file", "content"),
    [
        ("none.stl", None),
        ("box.ply", b"ply"),
        ("cut.stl", stl_box()[:-7]),
        ("empty.obj", b"# nothing\n"),
        ("cut.glb", glb_box()[:-7]),
        ("pipe.stl", None),
        ("zeros.obj", None),
    ],
)
def test_a_missing_or_broken_mesh_is_refused_in_one_line(
    file: str, content: bytes | None, tmp_path: Path
) -> None:
    os.mkfifo(tmp_path / "pipe.stl")
    (tmp_path / "zeros.obj").symlink_to("/dev/zero")
    if content is not None:
        (tmp_path / file).write_bytes(content)
    path = robot_file(tmp_path, femur={"file": file})
    with pytest.raises(InputError) as refusal:
        load_meshes(path)
    message = str(refusal.value)
    assert message.startswith(f"{path}: meshes.femur.file: {tmp_path / file}")
    assert "\n" not in message


@pytest.mark.parametrize(
    ("section", "key"),
    [
        ({"wheel": {"file": "box.stl"}}, "meshes.wheel"),
        ({"body": {"file": "box.stl", "scale": 0}}, "meshes.body.scale"),
        ({"body": {"scale": 1}}, "meshes.body.file"),
        ({"body": {"file": "box.stl", "position_m": [0, 0]}}, "meshes.body.position_m"),
    ],
)
def test_a_wrong_section_is_refused_when_the_robot_is_loaded(
    section: dict[str, Any], key: str, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=key.replace(".", r"\.")):
        load_robot(robot_file(tmp_path, **section))
