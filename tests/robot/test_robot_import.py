"""Imports of robot descriptions, by the kinds of faults that files of others showed."""

import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.formats.importing.mesh_files import collada_points
from hexctl.robot.formats.importing.robot_import import ImportedRobot, import_robot
from tests.robot.hexapods import (
    BOX,
    COXA_M,
    FEMUR_M,
    LIMIT,
    MOUNTS,
    SHIN,
    TIBIA_M,
    TRUNK,
    fixed,
    hexapod,
    imported,
    solid,
)
from tests.robot.meshmaking import obj, stl, text_stl


def mounts_m(made: ImportedRobot) -> Any:
    return np.array([mount["position_m"] for mount in made.content["mounts"]])


def length_m(made: ImportedRobot) -> float:
    return math.hypot(*made.content["links"]["tibia"]["end_m"])


# -- the root of the file


@pytest.mark.parametrize("root_m", [(0.11, 0.09, 0.0), (-0.25, 0.0, 0.1), (0.0, 0.4, -0.3)])
def test_the_body_frame_goes_between_the_mounts(root_m: tuple[float, float, float], tmp_path: Path) -> None:
    made = imported(tmp_path, hexapod(root_m=root_m))
    assert mounts_m(made).mean(axis=0) == pytest.approx([0, 0, 0], abs=1e-9)
    assert mounts_m(made)[0] == pytest.approx([0.11, 0.05, 0], abs=1e-9)
    assert "The body frame is at" in made.text
    # A file without a centre of mass has it in the root, wherever that is.
    assert "com_m" not in made.content["body"]


@pytest.mark.parametrize("rpy", ["1.5707963 0 0", "-1.5707963 0 0", "3.1415927 0 0"])
def test_the_vertical_is_that_of_the_coxa_axes(rpy: str, tmp_path: Path) -> None:
    """Roots whose y axis, -y axis or -z axis is up."""
    limits = (LIMIT, LIMIT.replace("-1.5", "-0.5"), LIMIT.replace("1.5", "0.6"))
    level = imported(tmp_path, hexapod(limits=limits))
    made = imported(tmp_path, hexapod(root_rpy=rpy, limits=limits))
    # Seen from below, legs of a flipped root are numbered the other way round.
    assert sorted(map(tuple, np.abs(mounts_m(made)).round(6))) == sorted(
        map(tuple, np.abs(mounts_m(level)).round(6))
    )
    assert made.content["stance"]["up_m"] == pytest.approx(level.content["stance"]["up_m"], abs=1e-5)


def test_a_robot_that_seems_to_look_sideways_is_noted(tmp_path: Path) -> None:
    sideways = hexapod(root_rpy="0 0 1.5707963")
    note = next(note for note in imported(tmp_path, sideways).notes if "--forward" in note)
    assert "from side to side" in note
    for text, forward in ((sideways, "y"), (sideways, "-y"), (hexapod(), "x")):
        assert not any("--forward" in note for note in imported(tmp_path, text, forward=forward).notes)


# -- one part looked at, quantities compared that are not alike


@pytest.mark.parametrize(
    "trunk",
    [
        solid('<cylinder radius="0.02" length="0.3"/>'),
        solid('<box size="0.03 0.05 0.04"/>', "0.09 0 0"),
        solid('<sphere radius="0.05"/>'),
        solid('<box size="3 3 0.01"/>'),
    ],
)
def test_what_does_not_cover_the_trunk_is_not_its_size(trunk: str, tmp_path: Path) -> None:
    made = imported(tmp_path, hexapod(trunk=trunk))
    assert "body.size_m" in made.unknown
    assert made.content["body"]["size_m"][:2] == pytest.approx([0.22, 0.16])
    both = imported(tmp_path, hexapod(trunk=trunk + BOX))
    assert "body.size_m" not in both.unknown
    assert both.content["body"]["size_m"] == pytest.approx([0.22, 0.18, 0.05])


#: Legs without a shin and a frame for the foot, but with something else.
FEET: dict[str, dict[str, str]] = {
    "a frame near the knee": {"shin": SHIN, "more_per_leg": fixed("s{n}", "t{n}", xyz="0.03 0 0")},
    "a long part at the knee": {
        "shin": solid('<box size="0.03 0.02 0.02"/>'),
        "more_per_leg": fixed(
            "p{n}", "t{n}", solid(f'<box size="{TIBIA_M} 0.01 0.01"/>', f"{TIBIA_M / 2} 0 0")
        ),
    },
    "a part beyond the frame of an ankle": {
        "more_per_leg": fixed(
            "a{n}",
            "t{n}",
            solid('<cylinder radius="0.006" length="0.05"/>', "0.025 0 0", "0 1.5707963 0"),
            "0.07 0 0",
        ),
    },
    "a ball": {"shin": solid('<sphere radius="0.012"/>', f"{TIBIA_M} 0 0")},
    "a foot on a spring": {"shin": SHIN, "foot": "prismatic"},
    "a foot that turns about itself": {"foot": "continuous"},
    "a foot on a floating joint": {"foot": "floating"},
    "a ball on a planar joint": {
        "more_per_leg": fixed("b{n}", "t{n}", solid('<sphere radius="0.011"/>'), f"{TIBIA_M} 0 0", "planar")
    },
}


@pytest.mark.parametrize("case", FEET)
def test_the_foot_is_the_far_end_of_all_that_is_fixed_to_the_tibia(case: str, tmp_path: Path) -> None:
    parts: dict[str, Any] = {"shin": "", "foot": "", **FEET[case]}
    made = imported(tmp_path, hexapod(**parts))
    assert length_m(made) == pytest.approx(TIBIA_M, abs=1e-6)
    assert "links.tibia.end_m" not in made.unknown


# -- one-sided plausibility


@pytest.mark.parametrize("velocity", ["0.00002", "0.01", "500"])
@pytest.mark.parametrize("effort", ["0.0005", "0.01", "900"])
def test_speeds_and_torques_of_no_servo_are_unknown(velocity: str, effort: str, tmp_path: Path) -> None:
    limit = f'<limit lower="-1.5" upper="1.5" effort="{effort}" velocity="{velocity}"/>'
    made = imported(tmp_path, hexapod(limits=(limit, limit, LIMIT)))
    for key in ("max_torque_nm", "max_speed_deg_s"):
        assert f"joints.femur.{key}" in made.unknown
        assert f"joints.tibia.{key}" not in made.unknown


@pytest.mark.parametrize("mass", ["0.0001", "0.01", "90"])
def test_a_trunk_that_is_too_light_or_too_heavy_is_unknown(mass: str, tmp_path: Path) -> None:
    made = imported(tmp_path, hexapod(trunk=BOX, trunk_inertial=TRUNK.replace("1.2", mass)))
    assert "body.mass_kg" in made.unknown


def test_products_of_inertia_that_are_left_out_are_noted(tmp_path: Path) -> None:
    for xy, count in (("0.0005", 0), ("0.002", 1)):
        trunk = TRUNK.replace('ixy="0"', f'ixy="{xy}"')
        notes = imported(tmp_path, hexapod(trunk=BOX, trunk_inertial=trunk)).notes
        assert sum("products of inertia, up to 20 %" in note for note in notes) == count


@pytest.mark.parametrize("moment", ["1e-9", "2.5", "0"])
def test_moments_of_inertia_of_no_body_are_unknown(moment: str, tmp_path: Path) -> None:
    inertial = TRUNK.replace("0.005", moment).replace("0.007", moment).replace("0.01", moment)
    made = imported(
        tmp_path, hexapod(trunk=BOX, trunk_inertial=inertial, inertial=inertial.replace("1.2", "0.05"))
    )
    assert "body.inertia_kg_m2" in made.unknown
    assert "links.femur.inertia_kg_m2" in made.unknown
    assert made.robot().link_inertias_kg_m2 is None


@pytest.mark.parametrize("ends", ['lower="0" upper="0"', 'lower="-4" upper="4"', 'lower="0.1" upper="0.17"'])
def test_ranges_of_no_leg_are_unknown(ends: str, tmp_path: Path) -> None:
    limit = f'<limit {ends} effort="2" velocity="5"/>'
    made = imported(tmp_path, hexapod(limits=(limit, LIMIT, LIMIT)))
    turning = imported(tmp_path, hexapod().replace('type="revolute"', 'type="continuous"', 1))
    for unlimited in (made, turning):
        assert {"joints.coxa.min_deg", "joints.coxa.max_deg"} <= set(unlimited.unknown)


# -- sizes and units


def scaled(text: str, share: float, effort: str = "2") -> str:
    """A description with other lengths, and masses that follow from them."""
    powers = {"value": 3, "ixx": 5, "iyy": 5, "izz": 5}
    texts = re.split(r'(xyz|size|length|radius|value|ixx|iyy|izz)="([^"]*)"', text)
    for at in range(1, len(texts), 3):
        key, values = texts[at : at + 2]
        numbers = (float(one) * share ** powers.get(key, 1) for one in values.split())
        texts[at : at + 2] = [key + '="', " ".join(map(str, numbers)) + '"']
    return "".join(texts).replace('effort="2"', f'effort="{effort}"')


@pytest.mark.parametrize("share", [0.12, 2.0])
def test_guesses_follow_from_the_size(share: float, tmp_path: Path) -> None:
    """Trunk, stance and masses; known small masses are no placeholders."""
    usual, made = (imported(tmp_path, scaled(hexapod(trunk=BOX), one, "60")) for one in (1.0, share))
    assert made.unknown == usual.unknown
    for part, key in (("body", "size_m"), ("stance", "up_m"), ("stance", "outward_m")):
        assert made.content[part][key] == pytest.approx(
            np.multiply(share, usual.content[part][key]), rel=1e-6
        )
    assert made.content["body"]["mass_kg"] == pytest.approx(share**3 * 1.2)
    bare = scaled(hexapod(trunk_inertial="", inertial=""), share, "60")
    guess = imported(tmp_path, bare)
    assert guess.content["body"]["size_m"][2] == pytest.approx(0.05 * share * 0.24 / 0.25)
    assert guess.robot().mass_kg == pytest.approx(2.08 * (share * 0.24 / 0.25) ** 3, rel=0.02)
    assert f"{guess.content['body']['mass_kg']:g} kg" in guess.reasons["body.mass_kg"]
    assert "for its size" in guess.reasons["body.mass_kg"]
    # No more than what a known torque carries, unless it carries no robot of this size.
    mass_kg = guess.robot().mass_kg
    for carried, expected in ((0.7, 0.7 if share > 1 else 1.0), (0.1, 1.0)):
        effort = carried * 3.27 * mass_kg * share * (FEMUR_M + TIBIA_M)
        made = imported(tmp_path, bare.replace('effort="60"', f'effort="{effort}"'))
        assert made.robot().mass_kg == pytest.approx(expected * mass_kg, rel=0.02)
        assert ("for its torque" in made.reasons["body.mass_kg"]) == (expected < 1)


def test_limits_in_degrees_and_swapped_limits_are_noted(tmp_path: Path) -> None:
    limit = '<limit lower="-80" upper="75" effort="2" velocity="0.1"/>'
    made = imported(
        tmp_path, hexapod(limits=(limit, LIMIT, LIMIT.replace('1.5"', '-1.5"').replace("--", "")))
    )
    assert "in deg that is -80 to 75 deg" in made.reasons["joints.coxa.min_deg"]
    assert "got 5.73; plausible: 11.46 to 3438 deg/s; 200" in made.reasons["joints.coxa.max_speed_deg_s"]
    assert sum("were swapped" in note for note in made.notes) == 6


# -- meshes


TRIANGLE = np.array([[0, 0, 0.003], [TIBIA_M, 0, 0], [0, 0, -0.003]])


def dae(scene: str, scale: float = 1.0, metre: float = 1.0, more: str = "") -> bytes:
    numbers = " ".join(str(value * scale) for corner in TRIANGLE for value in corner)
    return f'''<?xml version="1.0"?>
<COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">
<asset><unit name="u" meter="{metre}"/><up_axis>Y_UP</up_axis></asset>
<library_geometries><geometry id="g"><mesh>
<source id="n"><float_array id="na" count="3">900 900 900</float_array></source>
<source id="p"><float_array id="pa" count="9">{numbers}</float_array><technique_common><accessor source="#pa"
count="3" stride="3"/></technique_common></source><vertices id="v"><input semantic="POSITION" source="#p"/>
</vertices><triangles count="1"><input semantic="VERTEX" source="#v" offset="0"/><input semantic="NORMAL"
source="#n" offset="1"/><p>0 0 1 0 2 0</p></triangles></mesh></geometry></library_geometries>
<library_nodes><node id="l"><instance_geometry url="#g"/></node>{more}</library_nodes><library_visual_scenes>
<visual_scene id="s">{scene}</visual_scene></library_visual_scenes><scene><instance_visual_scene url="#s"/>
</scene></COLLADA>'''.encode()


USE = '<instance_geometry url="#g"/>'
#: The triangle in other units, turned and moved; nodes bring it back.
DAE = {
    "plain": dae(f"<node>{USE}</node>"),
    "in millimetres": dae(f"<node>{USE}</node>", 1000, 0.001),
    "scaled by its node": dae(f"<node><scale>2 2 2</scale>{USE}</node>", 0.5),
    "turned by a matrix": dae(
        "<node><matrix>0 -1 0 0 1 0 0 0 0 0 1 0 0 0 0 1</matrix><node><rotate>0 0 1 -90</rotate>"
        f"{USE}</node></node>"
    ),
    "moved, in inches": dae(
        "<node><translate>1 2 3</translate><node><translate>-1 -2 -3</translate>"
        '<instance_node url="#l"/></node></node>',
        1 / 0.0254,
        0.0254,
    ),
}

MESHES: dict[str, Callable[[], bytes]] = {
    "a.stl": lambda: text_stl(TRIANGLE),
    "b.STL": lambda: stl(TRIANGLE),
    "c.obj": lambda: obj(TRIANGLE),
    "d.dae": lambda: DAE["plain"],
}


@pytest.mark.parametrize("name", MESHES)
@pytest.mark.parametrize(
    "where", ["meshes/{}", "package://some_description/meshes/{}", "file://{folder}/meshes/{}"]
)
def test_meshes_show_the_foot(name: str, where: str, tmp_path: Path) -> None:
    (tmp_path / "meshes").mkdir()
    (tmp_path / "meshes" / name).write_bytes(MESHES[name]())
    mesh = solid(f'<mesh filename="{where.format(name, folder=tmp_path)}"/>')
    made = imported(tmp_path, hexapod(shin=mesh, foot=""))
    assert length_m(made) == pytest.approx(TIBIA_M, abs=1e-6)
    assert "links.tibia.end_m" not in made.unknown


@pytest.mark.parametrize("case", DAE)
def test_nodes_and_units_of_collada_count_and_its_up_axis_does_not(case: str) -> None:
    assert collada_points(DAE[case]) == pytest.approx(TRIANGLE, abs=1e-12)


def test_collada_nodes_that_use_one_another_end() -> None:
    circle = '<node id="a"><instance_node url="#b"/></node><node id="b"><instance_node url="#a"/></node>'
    with pytest.raises(ValueError, match="10000 nodes"):
        collada_points(dae('<node><instance_node url="#a"/></node>', more=circle))


@pytest.mark.parametrize("name", ["missing.stl", "tibia.dae", "torn.stl", "torn.obj", f"{300 * 'm'}.stl"])
def test_a_mesh_that_is_not_read_is_named(name: str, tmp_path: Path) -> None:
    for file, content in {"tibia.dae": b"<COLLADA/>", "torn.stl": b"solid", "torn.obj": b"v 1"}.items():
        (tmp_path / file).write_bytes(content)
    mesh = solid(f'<mesh filename="{name}"/>')
    for shin in (mesh, mesh + solid('<box size="0.05 0.02 0.02"/>', "0.025 0 0")):
        made = imported(tmp_path, hexapod(shin=shin, foot=""))
        assert name in made.reasons["links.tibia.end_m"]
    assert name in imported(tmp_path, hexapod(trunk=mesh)).reasons["body.size_m"]
    assert "links.tibia.end_m" not in imported(tmp_path, hexapod(shin=mesh)).unknown  # a frame marks the foot


# -- more files


@pytest.mark.parametrize("foot_y_m", [0.012, -0.03, 0.055])
def test_a_foot_next_to_the_plane_of_its_leg_is_projected_with_an_error(
    foot_y_m: float, tmp_path: Path
) -> None:
    made = imported(tmp_path, hexapod(foot_y_m=foot_y_m))
    note = next(note for note in made.notes if "outside the planes" in note)
    assert f"{1000 * abs(foot_y_m):.1f} mm" in note
    assert re.search(r"steps are off by up to \d+\.\d mm$", note)
    robot = made.robot()
    # In the stance the feet are those of the file.
    outward_m = made.content["stance"]["outward_m"]
    real_m = math.sqrt(outward_m**2 - foot_y_m**2)
    angle = math.radians(40) + math.atan2(foot_y_m, real_m)
    wanted_m = np.array([0.11, 0.05]) + outward_m * np.array([math.cos(angle), math.sin(angle)])
    assert foot_positions_body(robot, robot.stance_angles_rad)[0, :2] == pytest.approx(wanted_m, abs=1e-6)


def test_legs_may_have_zeros_of_their_own(tmp_path: Path) -> None:
    text = hexapod().replace('rpy="0 1.1 0"', 'rpy="0 0.6 0"', 2)
    made = imported(tmp_path, text)
    # Legs 1 and 2 of the file turn half a radian less far down at zero; that changes tibias only.
    assert re.findall(r"jc(\d), jf\1, jt\1 -28\.65 deg", made.text) == ["3", "4", "5", "6"]
    assert length_m(made) == pytest.approx(TIBIA_M, abs=1e-6)
    assert made.content["joints"]["tibia"]["max_deg"] - made.content["joints"]["tibia"][
        "min_deg"
    ] == pytest.approx(math.degrees(2.5), abs=1e-4)


@pytest.mark.parametrize(
    "ends",
    [
        'lower="0.3" upper="1.3"',
        'lower="-1.1" upper="-0.2"',
        'lower="0" upper="0.8"',
        'lower="0" upper="3.1416"',
    ],
)
def test_coxae_whose_range_lacks_the_zero_get_it_in_the_middle(ends: str, tmp_path: Path) -> None:
    limit = f'<limit {ends} effort="2" velocity="5"/>'
    made = imported(tmp_path, hexapod(limits=(limit, LIMIT, LIMIT)))
    low, high = (float(end) for end in ends.replace('"', "=").split("=")[2:6:3])
    coxa = made.content["joints"]["coxa"]
    assert coxa["max_deg"] == pytest.approx(math.degrees(high - low) / 2)
    assert coxa["min_deg"] == pytest.approx(-coxa["max_deg"])
    assert made.content["mounts"][0]["yaw_deg"] == pytest.approx(40 + math.degrees(high + low) / 2)


def test_a_missing_end_of_a_range_is_zero(tmp_path: Path) -> None:
    """URDF says so."""
    made, full = (
        imported(
            tmp_path, hexapod(limits=(LIMIT, LIMIT, f'<limit {lower} upper="1.5" effort="2" velocity="5"/>'))
        )
        for lower in ("", 'lower="0"')
    )
    assert made.content["joints"]["tibia"] == full.content["joints"]["tibia"]


def test_friction_and_damping_come_along(tmp_path: Path) -> None:
    made = imported(tmp_path, hexapod(dynamics='<dynamics friction="0.3" damping="0.25"/>'))
    joint = made.content["joints"]["femur"]
    assert joint["dry_friction_nm"] == 0.3
    assert joint["no_load_speed_deg_s"] == pytest.approx(math.degrees(2 / 0.25))
    made = imported(tmp_path, hexapod(dynamics='<dynamics friction="7" damping="40"/>'))
    assert {"joints.femur.dry_friction_nm", "joints.femur.no_load_speed_deg_s"} <= set(made.unknown)


#: An MJCF by hand: degrees, several joints in a body, no names for feet.
MJCF_LEGS = "".join(
    f'<body pos="{x} {y} 0" euler="0 0 {yaw}"><joint axis="0 0 1" range="-50 50"/>'
    f'<geom type="capsule" fromto="0 0 0 {COXA_M} 0 0" size="0.01" mass="0.05"/>'
    f'<body pos="{COXA_M} 0 0"><joint axis="0 1 0" range="-80 80"/>'
    f'<geom type="capsule" fromto="0 0 0 {FEMUR_M} 0 0" size="0.01" mass="0.05"/>'
    f'<body><joint axis="0 1 0" pos="{FEMUR_M} 0 0" range="-60 90"/>'
    f'<geom type="capsule" fromto="{FEMUR_M} 0 0 {FEMUR_M} 0 {-TIBIA_M}" size="0.008" mass="0.05"/>'
    "</body></body></body>"
    for x, y, yaw in MOUNTS
)
MJCF = (
    '<mujoco model="by hand"><compiler angle="degree"/><worldbody><geom type="plane" size="9 9 1"/>'
    f'<body pos="0 0 1"><freejoint/><geom type="box" size="0.11 0.09 0.025" mass="1"/>{MJCF_LEGS}</body>'
    "</worldbody></mujoco>"
)


def test_an_mjcf_by_hand(tmp_path: Path) -> None:
    named = MJCF.replace("<body><joint", '<body name="body2"><joint', 1)  # as bodies without a name may be
    assert named != MJCF
    made = imported(tmp_path, named)
    assert made.content["links"]["femur"]["end_m"] == pytest.approx([FEMUR_M, 0], abs=1e-9)
    assert made.content["links"]["tibia"]["end_m"] == pytest.approx([0, -TIBIA_M], abs=1e-9)
    assert made.content["body"]["size_m"] == pytest.approx([0.22, 0.18, 0.05])
    assert made.content["joints"]["tibia"]["min_deg"] == pytest.approx(-90)  # it turns the other way
    assert {"joints.coxa.max_torque_nm", "joints.coxa.max_speed_deg_s"} <= set(made.unknown)


# -- legs of more hinges, feet on joints


def hinge(name: str, parent: str, place: str, axis: str, limits: str = LIMIT) -> str:
    """A link on a hinge."""
    return (
        f'<link name="{name}"/><joint name="j{name}" type="revolute"><parent link="{parent}"/><child '
        f'link="{name}"/><origin {place}/><axis xyz="{axis}"/>{limits}</joint>'
    )


def tarsus(axis: str, foot: str, limits: str = LIMIT, name: str = "s", on: str = "t") -> str:
    """A fourth hinge at the middle of a tibia, and a foot beyond it."""
    at = f'xyz="{TIBIA_M / 2} 0 0"' if on == "t" else ""
    end = fixed(name + "foot{n}", name + "{n}", xyz=foot) if foot else ""
    return hinge(name + "{n}", on + "{n}", at, axis, limits) + end


HALF_M, TURNED_RAD = TIBIA_M / 2, 0.8
LONG_LEGS = {
    "a tarsus": (tarsus("0 1 0", f"{HALF_M} 0 0"), "js1", TIBIA_M),
    "an ankle about its shin": (tarsus("1 0 0", f"{HALF_M} 0.02 0"), "js1", TIBIA_M),
    "no zero in the range": (
        tarsus("0 -1 0", f"{HALF_M} 0 0", LIMIT.replace("-1.5", "0.1")),
        "js1",
        math.hypot(HALF_M + HALF_M * math.cos(TURNED_RAD), HALF_M * math.sin(TURNED_RAD)),
    ),
    "five hinges": (
        tarsus("0 1 0", "") + tarsus("0 0 1", f"{HALF_M} 0.02 0", name="u", on="s"),
        "js1, js2",
        TIBIA_M,
    ),
}


@pytest.mark.parametrize("case", LONG_LEGS)
def test_further_hinges_of_legs_are_held_and_named(case: str, tmp_path: Path) -> None:
    more, held, tibia_m = LONG_LEGS[case]
    made = imported(tmp_path, hexapod(foot="", shin="", more_per_leg=more))
    assert length_m(made) == pytest.approx(tibia_m, abs=1e-6)
    note = next(note for note in made.notes if "hold" in note)
    assert held in note
    assert f"6 at {math.degrees(TURNED_RAD) if 'zero' in case else 0:.4g} deg" in note
    assert note[note.index("hold") + 5 :].split(";")[0] in made.text


def test_a_hinge_between_trunk_and_coxa_is_held(tmp_path: Path) -> None:
    text = hexapod(more_per_leg=hinge("r{n}", "base", "", "1 0 0"))
    for n in range(1, 7):
        text = text.replace(
            f'<parent link="base"/><child link="c{n}"/>', f'<parent link="r{n}"/><child link="c{n}"/>'
        )
    assert imported(tmp_path, text).content["mounts"] == imported(tmp_path, hexapod()).content["mounts"]
    assert any("jr1, jr2" in note for note in imported(tmp_path, text).notes)


def test_a_foot_on_a_ball_joint_of_an_mjcf_is_the_foot(tmp_path: Path) -> None:
    ball = (
        f'<body pos="{FEMUR_M} 0 {-TIBIA_M}"><joint type="ball"/>'
        '<geom type="sphere" size="0.012" mass="0.01"/></body>'
    )
    shin = f'fromto="{FEMUR_M} 0 0 {FEMUR_M} 0 {-TIBIA_M}" size="0.008" mass="0.05"/>'
    text = MJCF
    assert text.count(shin) == 6
    made = imported(tmp_path, text.replace(shin, shin.replace(f'{-TIBIA_M}"', f'{-HALF_M}"') + ball))
    assert made.content["links"]["tibia"]["end_m"] == pytest.approx([0, -TIBIA_M], abs=1e-9)
    assert made.content["foot_radius_m"] == 0.012


def test_a_world_is_no_part_of_the_robot(tmp_path: Path) -> None:
    text = hexapod(trunk=BOX).replace('name="r" type="fixed"', 'name="r" type="floating"')
    made = imported(tmp_path, text)
    assert made.content["body"] == imported(tmp_path, hexapod(trunk=BOX)).content["body"]


@pytest.mark.parametrize(("kp", "kv"), [(20, 9), (50, 25), (5, 1.2)])
def test_a_control_that_lags_as_no_servo_does_is_unknown(kp: float, kv: float, tmp_path: Path) -> None:
    drives = "".join(
        f'<position joint="j{index}" kp="{kp}" kv="{kv}" forcerange="-3 3"/>' for index in range(18)
    )
    names = itertools.count()
    text = re.sub("<joint axis", lambda _: f'<joint name="j{next(names)}" axis', MJCF)
    text = text.replace("</mujoco>", f"<actuator>{drives}</actuator></mujoco>")
    made = imported(tmp_path, text)
    assert made.content["servo"]["stiffness_nm_per_rad"] == kp
    assert "lags by" in made.reasons["servo.damping_nm_s_per_rad"]
    assert made.content["servo"]["damping_nm_s_per_rad"] == pytest.approx(0.02 * kp)
    quick = imported(tmp_path, text.replace(f'kv="{kv}"', f'kv="{0.1 * kp}"'))
    assert quick.content["servo"]["damping_nm_s_per_rad"] == pytest.approx(0.1 * kp)


@pytest.mark.parametrize("trunk_kg", [0.8, 5.0, 14.0])
def test_an_assumed_torque_carries_the_robot(trunk_kg: float, tmp_path: Path) -> None:
    limit = LIMIT.replace('effort="2"', 'effort="300"')
    text = hexapod(limits=(limit,) * 3, trunk_inertial=TRUNK.replace("1.2", str(trunk_kg)))
    made = imported(tmp_path, text)
    torque_nm = made.content["joints"]["femur"]["max_torque_nm"]
    robot = made.robot()
    held_nm = robot.mass_kg * 9.81 / 3 * (robot.stance_radius_m - math.hypot(0.11, 0.05) - COXA_M)
    assert torque_nm > 1.3 * held_nm
    assert torque_nm == pytest.approx(max(1.5, 3.27 * robot.mass_kg * (FEMUR_M + TIBIA_M)), rel=1e-6)
    assert ("for its weight" in made.reasons["joints.femur.max_torque_nm"]) == (trunk_kg > 1)
    known = imported(tmp_path, text.replace('effort="300"', 'effort="2.5"'))
    assert known.content["joints"]["femur"]["max_torque_nm"] == 2.5


#: By what they are: parts before the world, in it, and at the end of an MJCF.
NO_PART_OF_THE_ROBOT = {
    "a missing height field": (
        '<asset><hfield name="hills" file="lost.png" size="5 5 0.3 0.1"/></asset>',
        '<geom type="hfield" hfield="hills"/>',
        "",
    ),
    "materials of sites and tendons": (
        '<asset><material name="red"/></asset>',
        '<site name="a" material="red"/><site name="b" pos="0 0 1"/>',
        '<tendon><spatial material="red"><site site="a"/><site site="b"/></spatial></tendon>',
    ),
    "a sensor and a contact pair of a missing mesh": (
        '<asset><mesh name="lost" file="lost.stl"/></asset>',
        '<geom name="lost" type="mesh" mesh="lost"/><geom name="ball" size="1"/>',
        '<contact><pair geom1="lost" geom2="ball"/></contact>'
        '<sensor><framepos objtype="geom" objname="lost"/></sensor>',
    ),
}


@pytest.mark.parametrize("case", NO_PART_OF_THE_ROBOT)
def test_what_is_no_part_of_the_robot_changes_nothing(case: str, tmp_path: Path) -> None:
    before, inside, after = NO_PART_OF_THE_ROBOT[case]
    plain = MJCF
    text = plain.replace("<worldbody>", f"{before}<worldbody>{inside}")
    text = text.replace("</mujoco>", f"{after}</mujoco>")
    changed = imported(tmp_path, text)
    assert changed.content == imported(tmp_path, plain).content


@pytest.mark.parametrize("bodies", [1, 7, 19])
def test_bodies_of_an_mjcf_whose_meshes_are_missing_have_no_mass(bodies: int, tmp_path: Path) -> None:
    """The trunk, coxae too, tibiae too."""
    text, mesh = MJCF, '<geom type="mesh" mesh="lost"'
    text = text.replace("<worldbody>", '<asset><mesh name="lost" file="lost.stl"/></asset><worldbody>')
    parts = [r'<geom type="box" size="[^"]*" mass="1"']
    parts += [r'<geom type="capsule" fromto="0 0 0 0.0[^"]*" size="[^"]*" mass="0.05"'] * (bodies > 1)
    parts += [r'<geom type="capsule" fromto="0.0[^"]*" size="[^"]*" mass="0.05"'] * (bodies > 7)
    for part in parts:
        text = re.sub(part, mesh, text)
    assert text.count(mesh) >= bodies
    made = imported(tmp_path, text)
    assert "lost.stl (not found)" in made.reasons["body.size_m"]
    assert "body.mass_kg" in made.unknown
    assert ("links.tibia.mass_kg" in made.unknown) == (bodies > 7)


# -- what is no hexapod


def changed(old: str, new: str, text: str = "") -> str:
    """A description with one thing replaced, of the plain hexapod unless a text is given."""
    text = text or hexapod()
    assert old in text
    return text.replace(old, new, 1)


def followed(joint: str) -> str:
    """The plain hexapod with a joint that follows another one."""
    return re.sub(rf'(<joint name="{joint}".*?)<axis', r'\1<mimic joint="jt3"/><axis', hexapod(), count=1)


def four_hinges(*axes: str) -> str:
    """Legs of four hinges about some axes."""
    text = hexapod(foot="", shin="", more_per_leg=tarsus(axes[3], f"{HALF_M} 0.02 0"))
    for part, axis in zip("cft", axes, strict=False):
        text = re.sub(rf'(<joint name="j{part}\d".*?<axis xyz=)"[^"]*"', rf'\1"{axis}"', text)
    return text


def chain(links: int) -> str:
    """Links that are fixed to one another and to a tibia."""
    return "".join(fixed(f"m{number}", f"m{number - 1}" if number else "t1") for number in range(links))


HEAVY = hexapod(trunk=solid('<box size="0.3 0.3 4"/>'), trunk_inertial=TRUNK.replace("1.2", "1200"))
LACKING = r"4 hinges \(jc1 about .*make the other hinges `fixed`"

#: Descriptions that are refused, and what the message says.
REFUSED = {
    "lengths in mm": (scaled(hexapod(), 1000), "legs of 240 m.*in mm that is 0.24 m"),
    "masses in grams": (HEAVY, "trunk of 1200 kg.*in g that is 1.2 kg"),
    "radians in an MJCF of degrees": (re.sub('range="[^"]*"', 'range="-1.2 1.3"', MJCF), 'angle="radian"'),
    "a foot beside its leg": (hexapod(foot_y_m=0.07), "outside the plane of its leg; allowed: 60 mm"),
    "five legs": (changed('"jc6" type="revolute"', '"jc6" type="fixed"'), "5 chains"),
    "a leaning hip": (changed('<axis xyz="0 0 1"/>', '<axis xyz="0 0.5 1"/>'), "jc1"),
    "a femur about x": (changed('<axis xyz="0 -1 0"/>', '<axis xyz="1 0 0"/>'), "jf1 and jt1"),
    "a long leg": (changed(f'xyz="{FEMUR_M} 0 0"', 'xyz="0.175 0 0"'), "the femur links"),
    "a hinge beyond the coxa": (four_hinges("0 0 1", "1 0 0", "0 -1 0", "1 0 0"), LACKING),
    "three vertical hinges": (four_hinges("0 0 1", "0 0 1", "0 0 1", "0 -1 0"), LACKING),
    "hinges in turn": (four_hinges("1 0 0", "0 0 1", "1 0 0", "0 0 1"), LACKING),
    **{
        f"{joint} follows": (followed(joint), f"{joint} of a leg follows jt3")
        for joint in ("jc1", "jf2", "jt6")
    },
    "two links of a name": (hexapod(more='<link name="c3"/>'), "2 links named 'c3'"),
    "two roots": (hexapod(more='<link name="loose"/>'), "2 links"),
    "a link that is not there": (changed('<parent link="base"/>', '<parent link="nowhere"/>'), "nowhere"),
    "a link carried twice": (changed('<child link="c2"/>', '<child link="c1"/>'), "c1"),
    "thousands of links": (hexapod(more=chain(2500)), "links"),
    "a number that is none": (changed(f'xyz="{COXA_M} 0 0"', 'xyz="0 nan 0"'), "xyz"),
    "an axis of length 0": (changed('xyz="0 0 1"', 'xyz="0 0 0"'), "axis of length 0"),
    "xacro": (changed("<mass ", '<mass a="${m}" '), "xacro"),
    "no XML": (changed("</robot>", ""), "XML"),
    "another XML": ("<sdf/>", "sdf"),
    "entities": ('<!DOCTYPE a [<!ENTITY b "c">]><robot/>', "entities"),
    "an unknown encoding": ('<?xml version="1.0" encoding="nothing"?><robot/>', "encoding"),
    "no MJCF": (changed("</mujoco>", "<nothing/></mujoco>", MJCF), "allowed: a valid MJCF"),
}


@pytest.mark.parametrize("case", REFUSED)
def test_what_is_no_hexapod_is_refused_in_one_line(case: str, tmp_path: Path) -> None:
    text, match = REFUSED[case]
    with pytest.raises(InputError, match=match) as refused:
        imported(tmp_path, text)
    assert "\n" not in str(refused.value)


def test_a_missing_file_and_options_of_no_robot_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"missing\.urdf"):
        import_robot("missing.urdf")
    with pytest.raises(InputError, match="3 m from the knee"):
        imported(tmp_path, hexapod(), foot_m=(0.0, 0.0, -3.0))
    with pytest.raises(InputError, match="forward"):
        imported(tmp_path, hexapod(), forward="up")


def test_a_robot_of_hundreds_of_links_is_imported(tmp_path: Path) -> None:
    imported(tmp_path, hexapod(more=chain(400)))
