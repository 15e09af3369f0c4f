"""Robot files: the shipped numbers, a robot that is not symmetric, and what is refused in one line."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.ik.legs import solve_legs
from hexctl.robot.configs import config_names
from hexctl.robot.loader import load_robot, load_robot_file
from tests.robot.meshmaking import stl_box
from tests.robots import ROBOT_NAMES, Content, Edit, drop, edited_file, put, shipped


def test_ant_has_the_numbers_of_the_paper() -> None:
    ant = shipped("ant")
    azimuths = np.radians(np.arange(6) * 60)
    circle = np.stack([np.cos(azimuths), np.sin(azimuths), np.zeros(6)], axis=-1)
    np.testing.assert_allclose(ant.mount_positions_body, 0.080 * circle, atol=1e-12)
    np.testing.assert_allclose(ant.mount_yaws_rad, azimuths, atol=1e-12)
    np.testing.assert_allclose(ant.link_vectors_m, [[0.0503, -0.0112], [0.0724, 0.0], [0.1165, 0.0]])
    np.testing.assert_allclose(ant.stance_feet_body, 0.204 * circle + [0, 0, -0.121], atol=1e-12)
    np.testing.assert_allclose(ant.joint_max_torque_nm, 2.5)
    np.testing.assert_allclose(ant.joint_max_speed_rad_s, np.radians(450))
    assert ant.mass_kg == pytest.approx(1.000)
    assert (ant.body.mass_kg, ant.size_m) == (0.100, 1.0)
    assert (ant.gait.pace_hz, ant.gait.amplitude, ant.gait.height) == (0.9, 0.11, 0.02)


def test_phantomx_has_the_vendors_numbers() -> None:
    phantomx = shipped("phantomx")
    lengths = np.hypot(*phantomx.link_vectors_m.T)
    np.testing.assert_allclose(lengths, [0.0529, 0.0618, 0.1309], atol=1e-4)
    np.testing.assert_allclose(
        phantomx.mount_positions_body[:, :2],
        [[0.125, 0.065], [0, 0.1], [-0.125, 0.065], [-0.125, -0.065], [0, -0.1], [0.125, -0.065]],
    )
    np.testing.assert_allclose(np.degrees(phantomx.mount_yaws_rad), [45, 90, 135, -135, -90, -45])
    assert phantomx.body.mass_kg == 1.522
    assert phantomx.mass_kg == pytest.approx(3.22, abs=0.005)
    np.testing.assert_allclose(phantomx.link_masses_kg, [0.0247, 0.0858, 0.1718])
    np.testing.assert_allclose(phantomx.body.com_m, [0.001522, 0.000302, 0.015345], atol=5e-5)
    assert phantomx.body.inertia_kg_m2 == (0.004466, 0.008489, 0.009202)
    assert phantomx.link_coms_m is not None
    np.testing.assert_allclose(
        phantomx.link_coms_m, [[0.019066, 0.006577], [0.020226, -0.00063], [0.036797, -0.011991]], atol=6e-5
    )
    np.testing.assert_allclose(phantomx.dry_friction_nm, 0.5)
    np.testing.assert_allclose(np.degrees(phantomx.joint_max_speed_rad_s), 180)
    np.testing.assert_allclose(np.degrees(phantomx.joint_upper_rad[0]), 55)


def test_phantomx_has_the_torque_and_speed_of_its_servo() -> None:
    """An XL430-W250 at 12 V: 1.5 N m, 61 rev/min. The vendor's description has an effort of 3 N m."""
    phantomx = shipped("phantomx")
    np.testing.assert_allclose(phantomx.joint_max_torque_nm, 1.5)
    assert phantomx.joint_no_load_speed_rad_s is not None
    np.testing.assert_allclose(phantomx.joint_no_load_speed_rad_s, 61 / 60 * 2 * np.pi)


def test_pexod_has_the_numbers_of_its_papers() -> None:
    pexod = shipped("pexod")
    np.testing.assert_allclose(np.hypot(*pexod.link_vectors_m.T), [0.060, 0.085, 0.140])
    np.testing.assert_allclose(
        pexod.mount_yaws_rad[:3], [np.pi / 2 - 0.3, np.pi / 2, np.pi / 2 + 0.3], atol=1e-5
    )
    np.testing.assert_allclose(pexod.mount_yaws_rad[3:], -pexod.mount_yaws_rad[2::-1])
    np.testing.assert_allclose(
        pexod.mount_positions_body[:3, :2], [[0.11, 0.04], [-0.01, 0.08], [-0.13, 0.04]]
    )
    assert pexod.mass_kg == pytest.approx(2.495)
    assert pexod.foot_radius_m == 0.025
    np.testing.assert_allclose(np.degrees(pexod.joint_upper_rad[:3]), [90, 45, 45])
    np.testing.assert_allclose(pexod.joint_max_speed_rad_s, 7.0, atol=0.002)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_shipped_robots_have_their_legs_counter_clockwise_from_the_front(name: str) -> None:
    robot = shipped(name)
    azimuths = np.degrees(robot.leg_azimuths_rad) % 360
    assert (np.diff(azimuths) > 0).all()
    assert (robot.stance_feet_body[[1, 2], 1] > 0).all(), "legs 2 and 3 stand on the left"
    assert (robot.stance_feet_body[[4, 5], 1] < 0).all(), "legs 5 and 6 stand on the right"
    assert robot.stance_feet_body[0, 0] > 0, "leg 1 stands in front"


def test_what_a_joint_may_leave_out_is_without_friction_at_any_speed_and_of_the_servos_stiffness() -> None:
    ant = shipped("ant")
    np.testing.assert_array_equal(ant.dry_friction_nm, np.zeros(18))
    np.testing.assert_array_equal(ant.back_emf_nm_s_per_rad, np.zeros(18))
    np.testing.assert_array_equal(ant.stiffness_nm_per_rad, np.full(18, 15.0))
    assert (ant.body.com_m, ant.body.inertia_kg_m2, ant.link_coms_m) == ((0, 0, 0), None, None)


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


def test_a_path_without_a_suffix_or_with_one_both_work(tmp_path: Path) -> None:
    path = edited_file(tmp_path, put("name", "mine"))
    plain = tmp_path / "mine"
    plain.write_bytes(path.read_bytes())
    assert load_robot(str(path)).name == "mine"
    assert load_robot(plain).name == "mine"


def test_one_parse_gives_robot_servo_map_and_meshes(tmp_path: Path) -> None:
    (tmp_path / "box.stl").write_bytes(stl_box())
    path = edited_file(
        tmp_path,
        put("servos", {"leg1_coxa": {"offset_deg": 12}}),
        put("meshes", {"body": {"file": "box.stl"}}),
    )
    file = load_robot_file(path)
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
    with pytest.raises(InputError, match=r"robot.yaml: servos: got channel 2 for leg1_coxa and leg1_femur"):
        _ = file.servo_map
    with pytest.raises(InputError, match=r"robot.yaml: meshes.body.file: .*missing.stl cannot be read"):
        _ = file.meshes


def _reversed_legs(content: Content) -> None:
    content["mounts"].reverse()


def _seventh_leg(content: Content) -> None:
    content["mounts"].append(content["mounts"][0])


def _swapped_range(content: Content) -> None:
    content["joints"]["femur"].update(min_deg=40, max_deg=-30)


#: What is wrong, how to make it, and what the message must hold: key, value got, what is allowed.
BAD_VALUES: dict[str, tuple[Edit, list[str]]] = {
    "unknown key": (put("colour", "red"), ["unknown key colour", "mounts, name, servo"]),
    "unknown nested key": (
        put("links", "coxa", "lenght_m", 1),
        ["links.coxa.lenght_m", "end_m, inertia_kg_m2, mass_kg, radius_m"],
    ),
    "unknown key of a mount": (put("mounts", 2, "yaw", 1), ["mounts[2].yaw", "yaw_deg"]),
    "misspelt key": (
        lambda content: content["body"].update(mas_kg=content["body"].pop("mass_kg")),
        ["unknown key body.mas_kg", "mass_kg", "1 more"],
    ),
    "key is no text": (put(5, 1), ["5", "allowed"]),
    "missing key": (drop("size_m"), ["size_m is missing"]),
    "missing nested key": (drop("joints", "tibia", "max_deg"), ["joints.tibia.max_deg is missing"]),
    "missing section": (drop("stance"), ["stance is missing"]),
    "half a mount": (drop("mounts", 3, "radius_m"), ["mounts[3]", "azimuth_deg", "radius_m and azimuth_deg"]),
    "both kinds of mount": (
        put("mounts", 0, "yaw_deg", 3),
        ["mounts[0]", "yaw_deg", "position_m and yaw_deg"],
    ),
    "five legs": (drop("mounts", 5), ["mounts", "got 5 legs", "exactly 6"]),
    "seven legs": (_seventh_leg, ["mounts", "got 7 legs", "exactly 6"]),
    "text for a number": (
        put("links", "coxa", "mass_kg", "heavy"),
        ["links.coxa.mass_kg", "'heavy'", "a number"],
    ),
    "yes for a number": (put("size_m", True), ["size_m", "True", "a number"]),
    "list for a number": (put("size_m", [1]), ["size_m", "[1]", "a number"]),
    "nothing for a number": (put("size_m", None), ["size_m", "None", "a number"]),
    "text for a section": (put("links", "coxa", "long"), ["links.coxa", "'long'", "a mapping"]),
    "text for a mount": (put("mounts", 1, "front"), ["mounts[1]", "'front'", "a mapping"]),
    "mapping for the mounts": (put("mounts", {"front": 1}), ["mounts", "'front'", "a list"]),
    "short list": (put("body", "size_m", [0.1, 0.2]), ["body.size_m", "[0.1, 0.2]", "longer list"]),
    "long list": (put("body", "size_m", [0.1] * 4), ["body.size_m", "0.1, 0.1", "a list of 3"]),
    "number in a list": (put("body", "size_m", [0.1, -1, 0.1]), ["body.size_m[1]", "-1", "above 0"]),
    "not a number": (put("body", "mass_kg", float("nan")), ["body.mass_kg", "nan", "finite"]),
    "infinite": (
        put("joints", "coxa", "max_speed_deg_s", float("inf")),
        ["joints.coxa.max_speed_deg_s", "inf", "finite"],
    ),
    "negative infinite": (put("stance", "up_m", float("-inf")), ["stance.up_m", "-inf", "finite"]),
    "negative mass": (put("body", "mass_kg", -1), ["body.mass_kg", "-1", "above 0"]),
    "zero radius": (put("foot_radius_m", 0), ["foot_radius_m", "got 0", "above 0"]),
    "huge mass": (put("body", "mass_kg", 1e6), ["body.mass_kg", "1000000", "1000 or less"]),
    "angle beyond a turn": (put("joints", "coxa", "max_deg", 400), ["joints.coxa.max_deg", "400", "360"]),
    "range upside down": (_swapped_range, ["joints.femur", "min_deg 40", "max_deg -30", "below"]),
    "unknown shape": (put("body", "shape", "ball"), ["body.shape", "'ball'", "'box' or 'cylinder'"]),
    "an inertia that no body has": (
        put("body", "inertia_kg_m2", [0.001, 0.001, 0.003]),
        ["body.inertia_kg_m2", "0.001, 0.001, 0.003", "below the sum of the other two"],
    ),
    "a negative inertia": (
        put("body", "inertia_kg_m2", [0.001, -0.001, 0.001]),
        ["body.inertia_kg_m2[1]", "-0.001", "above 0"],
    ),
    "a centre of mass in the plane": (put("body", "com_m", [0.0, 0.1]), ["body.com_m", "[0.0, 0.1]"]),
    "friction above the torque": (
        put("joints", "femur", "dry_friction_nm", 2.5),
        ["joints.femur", "dry_friction_nm 2.5", "max_torque_nm 2.5", "below the torque"],
    ),
    "faster than without load": (
        put("joints", "femur", "no_load_speed_deg_s", 300),
        ["joints.femur", "max_speed_deg_s 450", "no_load_speed_deg_s 300", "up to the speed without load"],
    ),
    "a speed without load for one joint": (
        put("joints", "coxa", "no_load_speed_deg_s", 500),
        ["joints: ", "no no_load_speed_deg_s for femur, tibia", "every joint kind, or for none"],
    ),
    "no stiffness": (
        put("joints", "tibia", "stiffness_nm_per_rad", 0),
        ["joints.tibia.stiffness_nm_per_rad", "got 0", "above 0"],
    ),
    "name with spaces": (put("name", "My Robot!"), ["name", "'My Robot!'", "allowed"]),
    "link of length zero": (
        put("links", "femur", "end_m", [0, 0]),
        ["links.femur.end_m", "length 0", "above 0"],
    ),
    "stance too far": (put("stance", "outward_m", 0.5), ["stance", "out of reach", "0.4629", "0.1889"]),
    "stance too near": (put("stance", {"outward_m": 0.06, "up_m": -0.02}), ["stance", "0.0131", "0.0441"]),
    "stance beyond a joint": (put("joints", "tibia", "max_deg", -120), ["stance", "tibia", "-160 to -120"]),
    "clockwise legs": (_reversed_legs, ["mounts", "-60, -120", "counter-clockwise"]),
    "two feet at one place": (
        put("mounts", 1, "azimuth_deg", 2),
        ["mounts", "feet 1 and 2", "0.0071", "0.016"],
    ),
}


@pytest.mark.parametrize("what", BAD_VALUES)
def test_a_bad_value_is_refused_in_one_line_with_file_key_value_and_what_is_allowed(
    what: str, tmp_path: Path
) -> None:
    edit, parts = BAD_VALUES[what]
    path = edited_file(tmp_path, edit)
    message = _refusal(path)
    assert message.startswith(f"{path}: ")
    for part in parts:
        assert part in message.removeprefix(str(path))
    assert "input should" not in message.lower()


BAD_TEXTS: dict[str, tuple[bytes, str]] = {
    "list": (b"- 1\n- 2\n", r"\[1, 2\].*a mapping"),
    "text": (b"hello\n", r"'hello'.*a mapping"),
    "number": (b"5", r"got 5.*a mapping"),
    "empty": (b"", r"name is missing"),
    "binary": (bytes(range(256)), r"cannot be read as text"),
    "zeros": (bytes(100), r"is not valid YAML"),
    "utf-16": ("name: ant".encode("utf-16"), r"cannot be read as text"),
    "syntax": (b"a: [1, 2\nb: {\n", r"is not valid YAML: line 2, column 2"),
    "tab": (b"a:\n\t- b\n", r"is not valid YAML: line 2"),
    "deep": (b"[" * 5000, r"nested too deeply"),
    "two documents": (b"a: 1\n---\nb: 2\n", r"another document"),
    "key twice": (
        b"body: {mass_kg: 1, mass_kg: 2}\n",
        r"line 1, column 20: the key 'mass_kg' is given twice",
    ),
    "key is a list": (b"? [1, 2]\n: 3\n", r"unhashable key"),
    "impossible date": (b"name: 2020-13-45\n", r"line 1, column 7: got '2020-13-45', which is no timestamp"),
    "newline in a key": (b'"a\\nb": 1\n', r"unknown key 'a\\nb'"),
    "object": (b"!!python/object/apply:os.system ['exit 1']\n", r"python/object/apply:os.system"),
    "name of code": (b"name: !!python/name:os.system\n", r"python/name:os.system"),
    "tag": (b"name: !mine x\n", r"!mine"),
    "refers to itself": (b"name: &a [*a]\n", r"line 1, column 7: it refers to itself"),
    "expands without end": (
        b"name: [&a [1,1,1,1,1,1,1,1], "
        + b", ".join(
            b"&%c [%s]" % (new, b",".join([b"*%c" % old] * 8))
            for old, new in zip(b"abcdefghijk", b"bcdefghijkl", strict=True)
        )
        + b"]",
        r"line 1, column 150: it is larger than 100000 values with its aliases followed",
    ),
}


@pytest.mark.slow
@pytest.mark.parametrize("what", BAD_TEXTS)
def test_a_file_that_is_no_mapping_is_refused_in_one_line(what: str, tmp_path: Path) -> None:
    text, pattern = BAD_TEXTS[what]
    path = tmp_path / "robot.yaml"
    path.write_bytes(text)
    message = _refusal(path)
    assert message.startswith(f"{path}: ")
    assert re.search(pattern, message.removeprefix(str(path)))


def test_a_tag_never_runs_code(tmp_path: Path) -> None:
    path, witness = tmp_path / "robot.yaml", tmp_path / "witness"
    path.write_text(f"!!python/object/apply:os.mkdir ['{witness}']\n", encoding="utf-8")
    _refusal(path)
    assert not witness.exists()


@pytest.mark.parametrize(
    "where",
    [".", "folder.yaml", "missing.yaml", "missing/robot", "a\nb.yaml", "a\0b.yaml", "x" * 5000 + ".yaml"],
)
def test_a_path_without_a_file_is_refused_with_the_path(where: str, tmp_path: Path) -> None:
    (tmp_path / "folder.yaml").mkdir()
    message = _refusal(f"{tmp_path}/{where}")
    assert str(tmp_path) in message
    assert ", ".join(config_names("robots")) in message


@pytest.mark.parametrize("name", ["spider", "", "an t"])
def test_an_unknown_name_lists_the_known_ones(name: str) -> None:
    message = _refusal(name)
    assert repr(name) in message
    assert ", ".join(config_names("robots")) in message


@pytest.mark.parametrize("value", [3, None, ["ant"], shipped()])
def test_a_name_of_a_wrong_type_is_refused(value: Any) -> None:
    with pytest.raises(WrongTypeError, match=r"robot: got .*; allowed: a shipped name or the path"):
        load_robot(value)


def _refusal(name_or_path: str | Path) -> str:
    with pytest.raises(InputError) as refused:
        load_robot(name_or_path)
    message = str(refused.value)
    assert "\n" not in message
    return message


@pytest.mark.parametrize(
    ("unknown", "message"),
    [
        (
            "body.mas_kg",
            "got body.mas_kg; allowed: keys of a robot file; in place of 'mas_kg', one of com_m, ",
        ),
        ("legs", "in place of 'legs', one of body, description"),
        ("size_m.x", "in place of 'x', nothing after it"),
        ("mounts.yaw", "in place of 'yaw', one of azimuth_deg, position_m"),
    ],
)
def test_only_keys_can_be_unknown(unknown: str, message: str, tmp_path: Path) -> None:
    with pytest.raises(InputError) as refused:
        load_robot(edited_file(tmp_path, put("unknown", ["joints.coxa", "mounts.yaw_deg", unknown])))
    assert message in str(refused.value)


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
    assert file.raw_map.unit == unit
    assert file.raw_map.offsets_deg[2] == 30
    wrong = edited_file(tmp_path, put("servos", section | {"leg1_coxa": {"id": 2}, "leg1_femur": {"id": 2}}))
    if driver is not None:
        with pytest.raises(InputError, match=r"robot\.yaml: servos: got id 2 for leg1_coxa and leg1_femur"):
            _ = load_robot_file(wrong).raw_map
