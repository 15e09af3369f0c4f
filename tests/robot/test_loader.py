"""Robot files, the robots and meshes that they give, and what is refused in one line."""

import math
import os
import pickle
import sys
from dataclasses import replace
from importlib.machinery import PathFinder
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from hexctl.backends.registry import raw_map_of
from hexctl.errors import InputError, WrongTypeError
from hexctl.ik.legs import solve_legs
from hexctl.robot.configs import config_names
from hexctl.robot.loader import load_meshes, load_robot, load_robot_file
from hexctl.robot.plugins import load_named, made_of, module_here
from hexctl.robot.schema import Body, even_box_m
from hexctl.robot.yaml_text import yaml_content
from tests.robot.meshmaking import MAKERS, glb_box, stl_box
from tests.robots import ROBOT_NAMES, Edit, drop, edited_file, put, shipped


def test_friction_stiffness_and_speed_without_load_are_per_joint_kind(tmp_path: Path) -> None:
    edits = [put("joints", kind, "no_load_speed_deg_s", 720) for kind in ("coxa", "femur", "tibia")]
    edits += [
        put("joints", "tibia", "stiffness_nm_per_rad", 9.0),
        put("joints", "femur", "dry_friction_nm", 0.1),
    ]
    robot = load_robot(edited_file(tmp_path, *edits))
    np.testing.assert_array_equal(robot.stiffness_nm_per_rad, np.tile([15.0, 15.0, 9.0], 6))
    np.testing.assert_array_equal(robot.dry_friction_nm, np.tile([0.0, 0.1, 0.0], 6))
    np.testing.assert_allclose(robot.back_emf_nm_s_per_rad, 2.5 / (4 * np.pi))


def test_links_without_a_centre_of_mass_have_it_in_the_middle(tmp_path: Path) -> None:
    robot = load_robot(edited_file(tmp_path, put("links", "tibia", "com_m", [0.03, 0.01])))
    assert robot.link_coms_m is not None
    np.testing.assert_allclose(robot.link_coms_m, [[0.02515, -0.0056], [0.0362, 0], [0.03, 0.01]])


RAISED = [(1, 0.04, 0.0692820323, 60), (4, -0.04, -0.0692820323, 240)]


def test_a_mount_of_its_own_moves_that_leg_only(tmp_path: Path) -> None:
    odd = {"position_m": [0.03, -0.10, 0.01], "yaw_deg": -75}
    robot = load_robot(edited_file(tmp_path, put("mounts", 5, odd)))
    ant = shipped("ant")
    np.testing.assert_array_equal(robot.stance_feet_body[:5], ant.stance_feet_body[:5])
    yaw = np.radians(-75)
    np.testing.assert_allclose(
        robot.stance_feet_body[5],
        [0.03 + 0.124 * np.cos(yaw), -0.10 + 0.124 * np.sin(yaw), -0.121],
    )


def test_mounts_of_different_heights_stand_on_one_floor(tmp_path: Path) -> None:
    edits = [put("mounts", leg, {"position_m": [x, y, 0.02], "yaw_deg": yaw}) for leg, x, y, yaw in RAISED]
    robot = load_robot(edited_file(tmp_path, *edits))
    assert np.ptp(robot.stance_feet_body[:, 2]) == 0
    angles = robot.stance_angles_rad.reshape(6, 3)
    assert not np.allclose(angles[0], angles[1])
    np.testing.assert_allclose(
        solve_legs(robot, robot.stance_feet_body).joint_positions_rad, robot.stance_angles_rad, atol=1e-12
    )


def test_one_parse_gives_robot_servo_map_and_meshes(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(stl_box())
    path = edited_file(
        tmp_path,
        put("servos", {"leg1_coxa": {"offset_deg": 12}}),
        put("meshes", {"body": {"file": "box.stl"}}),
    )
    file = load_robot_file(path)
    (tmp_path / "plain").write_bytes(path.read_bytes())
    assert load_robot(tmp_path / "plain") == file.robot
    assert file.path == path
    path.write_text("changed since", encoding="utf-8")
    assert file.robot == shipped()
    assert file.servo_map.offsets_deg[0] == 12
    assert file.meshes["body"].content == stl_box()


def test_who_needs_neither_servo_map_nor_meshes_is_not_stopped_by_them(tmp_path: Path) -> None:
    path = edited_file(
        tmp_path,
        put("servos", {"leg1_coxa": {"channel": 2}}),
        put("meshes", {"body": {"file": "missing.stl"}}),
    )
    file = load_robot_file(path)
    assert file.robot == shipped()
    with pytest.raises(InputError, match=r"robot.yaml: servos"):
        _ = file.servo_map
    with pytest.raises(InputError, match=r"robot.yaml: meshes.body.file"):
        _ = file.meshes


def test_what_is_unknown_is_no_part_of_the_robot(tmp_path: Path) -> None:
    unknown = ["joints.coxa", "mounts.yaw_deg", "servos.leg6_tibia.min_count", "body.inertia_kg_m2"]
    path = edited_file(tmp_path, put("unknown", unknown))
    assert load_robot_file(path).content.unknown == tuple(unknown)
    assert load_robot(path).fingerprint == shipped().fingerprint


def test_what_all_joints_of_a_kind_have_is_known(tmp_path: Path) -> None:
    legs = {f"leg{leg}_coxa": {"sign": -1} for leg in range(1, 6)}
    unknown = put("unknown", ["servos.coxa.sign", "servos.coxa.min_count", "body.mass_kg"])
    five = load_robot_file(edited_file(tmp_path, unknown, put("servos", legs)))
    assert five.to_measure == ("servos.coxa.sign", "servos.coxa.min_count", "body.mass_kg")
    six = load_robot_file(edited_file(tmp_path, unknown, put("servos", legs | {"leg6_coxa": {"sign": 1}})))
    assert six.to_measure == ("servos.coxa.min_count", "body.mass_kg")


@pytest.mark.parametrize(
    ("driver", "unit"),
    [(None, "us"), ("servo2040", "us"), ("pca9685", "us"), ("dynamixel", "counts"), ("lx16a", "counts")],
)
def test_the_raw_map_is_that_of_the_driver(driver: str | None, unit: str, tmp_path: Path) -> None:
    section = {"tibia": {"offset_deg": 30}} | ({} if driver is None else {"driver": driver})
    file = load_robot_file(edited_file(tmp_path, put("servos", section)))
    assert raw_map_of(file).unit == unit
    assert raw_map_of(file).offsets_deg[2] == 30


def _refusal(name_or_path: str | Path) -> str:
    with pytest.raises(InputError) as refused:
        load_robot(name_or_path)
    message = str(refused.value)
    assert "\n" not in message
    return message


def _clockwise(content: dict[str, Any]) -> None:
    content["mounts"].reverse()


#: What is wrong, how to make it, and what the message names.
BAD_VALUES: dict[str, tuple[Edit, str]] = {
    "unknown key": (put("colour", "red"), "colour"),
    "unknown key of a mount": (put("mounts", 2, "yaw", 1), "mounts[2].yaw"),
    "key is no text": (put(5, 1), "5"),
    "missing key": (drop("size_m"), "size_m"),
    "missing section": (drop("stance"), "stance"),
    "half a mount": (drop("mounts", 3, "radius_m"), "mounts[3]"),
    "five legs": (drop("mounts", 5), "a list of 6"),
    "text for a number": (put("links", "coxa", "mass_kg", "heavy"), "links.coxa.mass_kg"),
    "yes for a number": (put("size_m", True), "size_m"),
    "text for a section": (put("links", "coxa", "long"), "links.coxa"),
    "short list": (put("body", "size_m", [0.1, 0.2]), "body.size_m"),
    "number in a list": (put("body", "size_m", [0.1, -1, 0.1]), "body.size_m[1]"),
    "not a number": (put("body", "mass_kg", float("nan")), "body.mass_kg"),
    "angle beyond a turn": (put("joints", "coxa", "max_deg", 400), "joints.coxa.max_deg"),
    "range upside down": (put("joints", "femur", "min_deg", 200), "joints.femur"),
    "an inertia that no body has": (
        put("body", "inertia_kg_m2", [0.001, 0.001, 0.003]),
        "body.inertia_kg_m2",
    ),
    "a centre of mass in the plane": (put("body", "com_m", [0.0, 0.1]), "body.com_m"),
    "friction above the torque": (put("joints", "femur", "dry_friction_nm", 2.5), "joints.femur"),
    "faster than without load": (put("joints", "femur", "no_load_speed_deg_s", 300), "joints.femur"),
    "a speed without load for one joint": (put("joints", "coxa", "no_load_speed_deg_s", 500), "femur, tibia"),
    "name with spaces": (put("name", "My Robot!"), "name"),
    "link of length zero": (put("links", "femur", "end_m", [0, 0]), "links.femur.end_m"),
    "stance too far": (put("stance", "outward_m", 0.5), "stance"),
    "stance beyond a joint": (put("joints", "tibia", "max_deg", -120), "stance"),
    "clockwise legs": (_clockwise, "mounts"),
    "two feet at one place": (put("mounts", 1, "azimuth_deg", 2), "feet 1 and 2"),
    "an unknown key that is unknown": (put("unknown", ["body.mas_kg"]), "body.mas_kg"),
    "an unknown key with more behind it": (put("unknown", ["size_m.x"]), "size_m.x"),
    "a mesh of no part": (put("meshes", {"wheel": {"file": "box.stl"}}), "meshes.wheel"),
    "a mesh without a scale": (put("meshes", {"body": {"file": "box.stl", "scale": 0}}), "meshes.body.scale"),
    "a mesh without a file": (put("meshes", {"body": {"scale": 1}}), "meshes.body.file"),
    "a mesh in a plane": (
        put("meshes", {"body": {"file": "box.stl", "position_m": [0, 0]}}),
        "meshes.body.position_m",
    ),
}


@pytest.mark.parametrize("what", BAD_VALUES)
def test_a_bad_value_is_refused_in_one_line_with_file_and_key(what: str, tmp_path: Path) -> None:
    edit, named = BAD_VALUES[what]
    path = edited_file(tmp_path, edit)
    message = _refusal(path)
    assert message.startswith(f"{path}: ")
    assert named in message.removeprefix(str(path))
    assert "input should" not in message.lower()


#: What is no mapping; the hostile texts below are no YAML.
BAD_TEXTS = {
    "list": b"- 1\n- 2\n",
    "empty": b"",
    "binary": bytes(range(256)),
    "syntax": b"a: [1, 2\nb: {\n",
    "two documents": b"a: 1\n---\nb: 2\n",
}


@pytest.mark.parametrize("what", BAD_TEXTS)
def test_a_file_that_is_no_mapping_is_refused_in_one_line(what: str, tmp_path: Path) -> None:
    path = tmp_path / "robot.yaml"
    path.write_bytes(BAD_TEXTS[what])
    assert _refusal(path).startswith(f"{path}: ")


def test_a_tag_never_runs_code(tmp_path: Path) -> None:
    path, witness = tmp_path / "robot.yaml", tmp_path / "witness"
    path.write_text(f"!!python/object/apply:os.mkdir ['{witness}']\n", encoding="utf-8")
    _refusal(path)
    assert not witness.exists()


def test_a_path_or_a_name_without_a_file_is_refused_with_the_known_names(tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    known = ", ".join(config_names("robots"))
    for where in (".", "folder.yaml", "missing/robot", "a\nb\0.yaml", "x" * 5000):
        assert known in _refusal(f"{tmp_path}/{where}")
    for name in ("spider", "", "an t"):
        assert known in _refusal(name)
    for value in (3, None, ["ant"], shipped()):
        with pytest.raises(WrongTypeError, match="robot"):
            load_robot(value)  # type: ignore[arg-type]


def test_a_module_in_the_working_folder_replaces_no_library(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("my_robot_parts", "numpy"):
        (tmp_path / f"{name}.py").write_text("ANSWER = 42\n", encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    try:
        assert module_here("my_robot_parts").ANSWER == 42
        library = PathFinder.find_spec("numpy", sys.path)
        assert library is not None
        assert str(library.origin).endswith("numpy/__init__.py")
    finally:
        sys.modules.pop("my_robot_parts", None)


def test_what_a_script_has_defined_is_given_from_python() -> None:
    with pytest.raises(ImportError):
        load_named("__main__:Mine", "optimizer")
    assert load_named("hexctl.robot.plugins:load_named", "optimizer") is load_named


@pytest.mark.parametrize("name", ["ours", f"{__name__}:Counted", f"{__name__}:MADE"])
def test_a_class_of_ones_own_is_made_as_a_shipped_one_is(name: str) -> None:
    assert isinstance(made_of(name, {"ours": Counted}, Counted, "recovery"), Counted)


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("hope", "recovery"),
        ("no.such.module:Hope", "recovery"),
        (f"{__name__}:Nothing", "recovery"),
        ("pathlib:Path", "pathlib:Path"),
    ],
)
def test_what_is_not_of_the_kind_is_refused(name: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        made_of(name, {"ours": Counted}, Counted, "recovery")


class Counted:
    """Something that can be made."""


MADE = Counted()


#: Nine to the eighth entries in nine lines.
MERGES = "a0: &a0 {x: 1}\n" + "".join(
    f"a{level}: &a{level} {{<<: [{', '.join([f'*a{level - 1}'] * 9)}]}}\n" for level in range(1, 9)
)
ALIASES = "a0: &a0 [1]\n" + "".join(
    f"a{level}: &a{level} [{', '.join([f'*a{level - 1}'] * 9)}]\n" for level in range(1, 12)
)

HOSTILE = {
    "a long hexadecimal number": "x: 0x" + "f" * 200_000,
    "a long number of base 60": "x: 1" + ":59" * 20_000,
    "merges": MERGES,
    "aliases": ALIASES,
    "a list that refers to itself": "&a [*a]",
    "no int": 'x: !!int ""',
    "an impossible date": "x: 2026-13-01",
    "a list as a key": "? [1]\n: 2",
    "a key twice": "x: 1\nx: 2",
    "a deep list": "[" * 400,
}


@pytest.mark.parametrize("what", HOSTILE)
def test_hostile_text_is_refused(what: str) -> None:
    with pytest.raises(ValueError, match=r"."):
        yaml_content(HOSTILE[what])


def test_anchors_as_a_person_writes_them_are_read() -> None:
    text = "leg: &leg {mass_kg: 0.1, at: [1, 2]}\nother: {<<: *leg, mass_kg: 0.2}\nlist: [*leg, *leg]\n"
    content = yaml_content(text)
    assert content["other"] == {"mass_kg": 0.2, "at": [1, 2]}
    assert content["list"] == [content["leg"]] * 2
    assert yaml_content("") is None
    assert yaml_content("x: 0x1f\ny: 1:30\nz: 1e3\n") == {"x": 31, "y": 90, "z": "1e3"}


# The model: comparable, read-only, and refused if its arrays are no robot's.

#: Fingerprints that shipped priors, repertoires and uncertainties name.
FINGERPRINTS = {
    "ant": "977850e5e368bbb671c6d1113073b5cd4e3155d5744d1e562ad93657ed6e6c28",
    "pexod": "03474e14803b036830878662745cd09400e0c374e30be028085a2f8d58fe84c5",
}


@pytest.mark.parametrize("name", FINGERPRINTS)
def test_keys_at_their_defaults_do_not_change_the_fingerprint(name: str, tmp_path: Path) -> None:
    assert shipped(name).fingerprint == FINGERPRINTS[name]
    spelled_out = edited_file(
        tmp_path,
        put("body", "com_m", [0.0, 0.0, 0.0]),
        put("joints", "coxa", "dry_friction_nm", 0),
        base=name,
    )
    assert load_robot(spelled_out).fingerprint == FINGERPRINTS[name]


#: Edits that each make another robot; the first five are of optional keys.
CHANGES = (
    put("body", "com_m", [0.0, 0.0, 0.01]),
    put("body", "inertia_kg_m2", [0.001, 0.001, 0.001]),
    put("links", "femur", "com_m", [0.03, 0.0]),
    put("joints", "coxa", "dry_friction_nm", 0.1),
    put("joints", "coxa", "stiffness_nm_per_rad", 9.0),
    put("body", "mass_kg", 0.11),
    put("joints", "coxa", "max_deg", 41),
)


def test_robots_are_equal_exactly_if_their_descriptions_are(tmp_path: Path) -> None:
    ant, again = shipped(), load_robot("ant")
    sent = pickle.loads(pickle.dumps(ant))  # noqa: S301
    assert ant == again == sent
    assert hash(ant) == hash(again)
    assert sent.fingerprint == ant.fingerprint
    with pytest.raises(ValueError, match="read-only"):
        sent.stance_angles_rad[0] = 1.0
    others = [load_robot(edited_file(tmp_path, edit)) for edit in CHANGES]
    assert ant not in others
    assert len({robot.fingerprint for robot in [ant, *others]}) == len(CHANGES) + 1


@given(st.tuples(*[st.floats(1e-5, 0.1)] * 3), st.floats(0.05, 5))
def test_the_even_box_has_the_inertia_or_the_inertia_is_refused(
    moments: tuple[float, float, float], mass_kg: float
) -> None:
    possible = all(2 * own < sum(moments) * (1 - 1e-9) for own in moments)
    if not possible:
        if any(2 * own > sum(moments) * (1 + 1e-9) for own in moments):
            with pytest.raises(InputError, match="inertia_kg_m2"):
                Body(shape="box", size_m=(0.1, 0.1, 0.1), mass_kg=mass_kg, inertia_kg_m2=moments)
        return
    x, y, z = np.square(even_box_m(mass_kg, moments))
    np.testing.assert_allclose(mass_kg / 12 * np.array([y + z, x + z, x + y]), moments, rtol=1e-9)


def test_a_trunk_that_cannot_be_is_refused() -> None:
    for key, value in (("mass_kg", math.nan), ("shape", "ball"), ("size_m", (0.1, 0.1)), ("mas_kg", 1.0)):
        with pytest.raises(InputError, match=f"body: .*{key}"):
            Body(**{"size_m": (0.1, 0.1, 0.1), "mass_kg": 1.0, key: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("name", 3),
        ("size_m", "1"),
        ("gait", "tripod"),
        ("link_radii_m", [0.01] * 3),
        ("stance_angles_rad", np.zeros((6, 3))),
        ("link_masses_kg", np.array([1.0, np.nan, 1.0])),
        ("link_masses_kg", np.array(["1", "1", "1"])),
    ],
)
def test_a_value_of_a_wrong_type_or_shape_is_refused(field: str, value: Any) -> None:
    with pytest.raises(InputError, match=f"robot.{field}"):
        replace(shipped(), **{field: value})


# Meshes: looks that a recording shows, and nothing else about the robot.


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


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_shipped_robots_have_their_legs_counter_clockwise_from_the_front(name: str) -> None:
    robot = shipped(name)
    azimuths = np.degrees(robot.leg_azimuths_rad) % 360
    assert (np.diff(azimuths) > 0).all()
    assert (robot.stance_feet_body[[1, 2], 1] > 0).all(), "legs 2 and 3 stand on the left"
    assert (robot.stance_feet_body[[4, 5], 1] < 0).all(), "legs 5 and 6 stand on the right"
    assert robot.stance_feet_body[0, 0] > 0, "leg 1 stands in front"
