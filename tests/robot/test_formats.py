"""Robots as JSON, MJCF and URDF, as others read them and write them, and as they come back.

`phantomx_humarobotics.urdf` is from phantomx_description by HumaRobotics (Generation Robots), under the
Simplified BSD License beside it.
"""

import math
import re
from dataclasses import fields, replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulation_model import make_simulation
from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body, link_points_body
from hexctl.robot.configs import config_names
from hexctl.robot.formats.importing.robot_import import import_robot
from hexctl.robot.formats.json_model import robot_from_json, robot_to_json
from hexctl.robot.formats.link_frames import FOOT_LINKS, fixed_transforms, link_transforms
from hexctl.robot.formats.link_masses import link_capsule, link_mass, trunk_mass
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.formats.urdf import COMMAND_TOPIC, TOPIC_SYSTEM, urdf_of
from hexctl.robot.formats.xml_text import parse_xml
from hexctl.robot.loader import load_robot, load_robot_file
from hexctl.robot.model import Robot
from hexctl.runs.run import run
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray
from tests.robot.hexapods import BOX, hexapod, imported
from tests.robots import ROBOT_NAMES, shipped


@pytest.mark.parametrize("encoding", ["utf-8", "utf-16", "iso-8859-1"])
def test_xml_is_read_in_any_encoding_without_entities(encoding: str) -> None:
    head, element = f'<?xml version="1.0" encoding="{encoding}"?>', '<a name="é"/>'
    assert parse_xml(f"{head}{element}".encode(encoding)).get("name") == "é"
    with pytest.raises(ValueError, match="entities"):
        parse_xml(f'{head}<!DOCTYPE a [<!ENTITY b "c">]>{element}'.encode(encoding))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_an_equal_robot_comes_back(name: str) -> None:
    robot = shipped(name)
    back = robot_from_json(robot_to_json(robot))
    assert back == robot
    assert back.fingerprint == robot.fingerprint


def test_what_is_no_robot_is_refused() -> None:
    whole = robot_to_json(shipped())
    wrong_type = whole.replace('"size_m": 1.0', '"size_m": "x"', 1)
    unknown_key = whole.replace('"size_m"', '"length_m"', 1)
    not_finite = whole.replace("0.08", "NaN", 1)
    assert whole not in (wrong_type, unknown_key, not_finite)
    for text in ("", "[]", "{}", '{"version": 2}', "null", "nonsense", wrong_type, unknown_key, not_finite):
        with pytest.raises(InputError, match="robot description"):
            robot_from_json(text)


@pytest.mark.slow
@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_masses_servos_and_friction_are_those_of_the_simulation(name: str) -> None:
    robot = shipped(name)
    model = mujoco.MjModel.from_xml_string(mjcf_of(robot))
    with SimServos(robot) as servos:
        ours = servos.compiled.physics.model
        order = ours.body_mass > 0  # without the frames by which legs are attached
        assert model.body_mass[1:] == pytest.approx(ours.body_mass[order], rel=1e-9)
        assert np.sort(model.body_inertia[1:]) == pytest.approx(np.sort(ours.body_inertia[order]), rel=1e-9)
        for field in ("dof_armature", "dof_damping", "dof_frictionloss", "dof_solimp"):
            assert getattr(model, field) == pytest.approx(getattr(ours, field)), field
        for field in ("actuator_gainprm", "actuator_biasprm", "actuator_forcerange"):
            assert getattr(model, field) == pytest.approx(getattr(ours, field)), field


def poses(robot: Robot, count: int = 100) -> FloatArray:
    """Joint angles within their ranges, (count, 18) in rad."""
    shares = np.random.default_rng(17).uniform(size=(count, N_JOINTS))
    return robot.joint_lower_rad + shares * (robot.joint_upper_rad - robot.joint_lower_rad)


def compiled(text: str) -> Any:
    """A URDF in MuJoCo, with its frames kept and its base free."""
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.body("base_link").add_freejoint()
    return spec.compile()


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_mujoco_finds_feet_and_links_where_our_kinematics_do(name: str) -> None:
    robot = shipped(name)
    model = compiled(urdf_of(robot))
    data = mujoco.MjData(model)
    joints = [model.joint(joint).qposadr[0] for joint in JOINT_NAMES]
    feet = [model.body(foot).id for foot in FOOT_LINKS]
    links = [model.body(f"{joint}_link").id for joint in JOINT_NAMES]
    assert model.body_mass[model.body("base_link").id] == 0
    for pose_rad in poses(robot):
        data.qpos[joints] = pose_rad
        mujoco.mj_kinematics(model, data)
        off_m = data.xpos[feet] - foot_positions_body(robot, pose_rad)
        assert np.abs(off_m).max() < 1e-9
        points_m = link_points_body(robot, pose_rad)[:, :3].reshape(N_JOINTS, 3)
        assert np.abs(data.xpos[links] - points_m).max() < 1e-9
    for transforms in (link_transforms(robot, pose_rad), fixed_transforms(robot)):
        for index, (parent, child) in enumerate(zip(transforms.parents, transforms.children, strict=True)):
            above, below = model.body(parent).id, model.body(child).id
            turn = data.xmat[above].reshape(3, 3).T
            found_m = turn @ (data.xpos[below] - data.xpos[above])
            matrix = np.empty(9)
            mujoco.mju_quat2Mat(matrix, transforms.quaternions[index])
            assert found_m == pytest.approx(transforms.translations_m[index], abs=1e-9)
            assert turn @ data.xmat[below].reshape(3, 3) == pytest.approx(matrix.reshape(3, 3), abs=1e-9)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_yourdfpy_finds_the_feet_where_our_kinematics_do(name: str, tmp_path: Path) -> None:
    import yourdfpy

    robot = shipped(name)
    file = tmp_path / "robot.urdf"
    file.write_text(urdf_of(robot), encoding="utf-8")
    urdf = yourdfpy.URDF.load(str(file))
    assert urdf.validate()
    for pose_rad in poses(robot):
        urdf.update_cfg(dict(zip(JOINT_NAMES, pose_rad.tolist(), strict=True)))
        found_m = [urdf.get_transform(foot, "base_link")[:3, 3] for foot in FOOT_LINKS]
        assert np.abs(found_m - foot_positions_body(robot, pose_rad)).max() < 1e-9


def test_rerun_reads_it(tmp_path: Path) -> None:
    rerun_urdf = pytest.importorskip("rerun.urdf", reason="this Rerun has no URDF reader")
    robot = shipped("phantomx")
    file = tmp_path / "robot.urdf"
    file.write_text(urdf_of(robot), encoding="utf-8")
    tree = rerun_urdf.UrdfTree.from_file_path(str(file))
    assert {joint.name for joint in tree.joints()} >= set(JOINT_NAMES)
    pose_rad = poses(robot, 1)[0]
    transforms = link_transforms(robot, pose_rad)
    for index, name in enumerate(JOINT_NAMES):
        joint = tree.get_joint_by_name(name)
        found = joint.compute_transform(float(pose_rad[index]))
        at_m = np.array(found.translation.as_arrow_array().to_pylist()[0])
        xyzw = np.array(found.quaternion.as_arrow_array().to_pylist()[0])
        assert at_m == pytest.approx(transforms.translations_m[index], abs=1e-6)
        wxyz = np.roll(xyzw, 1)
        assert abs(float(wxyz @ transforms.quaternions[index])) == pytest.approx(1, abs=1e-6)


def test_the_block_of_ros2_control_commands_every_joint_and_is_never_silent() -> None:
    assert "ros2_control" not in urdf_of(shipped())
    text = urdf_of(shipped(), ros2_control=True, command_topic="/lab/command", state_topic="/lab/states")
    block = ElementTree.fromstring(text).find("ros2_control")  # noqa: S314  our own text
    assert block is not None
    assert block.findtext("hardware/plugin") == TOPIC_SYSTEM
    parameters = {one.get("name"): one.text for one in block.findall("hardware/param")}
    assert parameters["joint_commands_topic"] == "/lab/command"
    assert parameters["joint_states_topic"] == "/lab/states"
    assert parameters["trigger_joint_command_threshold"] == "-1"
    assert [joint.get("name") for joint in block.findall("joint")] == list(JOINT_NAMES)
    commands = list(block.iter("command_interface"))
    assert {one.get("name") for one in commands} == {"position"}
    # A first value would be sent before any controller is active: the robot would go there.
    assert {param.get("name") for one in commands for param in one} == {"min", "max"}
    assert COMMAND_TOPIC in urdf_of(shipped(), ros2_control=True)


# Out and in again.


def differences(first: Robot, second: Robot) -> dict[str, float]:
    """Largest relative or absolute difference of each number of two robots, if above 1e-9."""
    found = {}
    for field in fields(Robot):
        one, other = getattr(first, field.name), getattr(second, field.name)
        if isinstance(one, np.ndarray):
            # A yaw may differ by a full turn.
            off = (one - other + np.pi) % (2 * np.pi) - np.pi if "yaws" in field.name else one - other
            found[field.name] = float(np.max(np.abs(off) / np.maximum(1.0, np.abs(one))))
        elif isinstance(one, float):
            found[field.name] = abs(one - other)
    return {name: value for name, value in found.items() if value > 1e-9}


ROBOTS = ("ant", "lukas", "phantomx", "pexod")


@pytest.mark.parametrize("name", ROBOTS)
def test_our_own_mjcf_comes_back_as_the_same_robot(name: str, tmp_path: Path) -> None:
    robot = shipped(name)
    robot = replace(robot, servo=replace(robot.servo, load_friction=0.4))
    made = imported(tmp_path, mjcf_of(robot))
    assert made.unknown == ()
    back = made.robot()
    assert differences(robot, back) == {}
    for part in ("body", "servo", "gait"):
        own, other = vars(getattr(robot, part)), vars(getattr(back, part))
        assert all(own[key] == pytest.approx(other[key], rel=1e-8) for key in own if own[key] != other[key])


@pytest.mark.parametrize("name", config_names("robots"))
def test_our_own_urdf_comes_back_without_what_it_cannot_hold(name: str, tmp_path: Path) -> None:
    robot = replace(shipped(name), joint_play_rad=None, joint_stiffness_nm_per_rad=None)
    made = imported(tmp_path, urdf_of(robot))
    assert all(key.startswith("servo.") for key in made.unknown)
    assert differences(robot, made.robot()).keys() <= {"size_m", "stance_feet_body", "stance_angles_rad"}
    check_masses(robot, made.robot(), 1e-9)


def check_masses(robot: Robot, back: Robot, error: float) -> None:
    assert trunk_mass(back.body).mass_kg == pytest.approx(trunk_mass(robot.body).mass_kg, rel=error)
    assert trunk_mass(back.body).moments_kg_m2 == pytest.approx(
        trunk_mass(robot.body).moments_kg_m2, rel=error
    )
    for index in range(3):
        own, other = link_mass(robot, index), link_mass(back, index)
        assert other.mass_kg == pytest.approx(own.mass_kg, rel=error)
        assert other.com_m == pytest.approx(own.com_m, abs=error)
        assert other.link_moments_kg_m2 == pytest.approx(own.link_moments_kg_m2, abs=error)


@pytest.mark.parametrize("index", range(3))
def test_an_even_link_has_the_moments_that_mujoco_gives_its_capsule(index: int) -> None:
    robot = shipped()
    own, capsule = link_mass(robot, index), link_capsule(robot, index)
    size = f"{capsule.radius_m} {capsule.length_m / 2}"
    geom = f'<geom type="capsule" size="{size}" mass="{own.mass_kg}"/>'
    model = mujoco.MjModel.from_xml_string(f"<mujoco><worldbody><body>{geom}</body></worldbody></mujoco>")
    assert sorted(own.moments_kg_m2) == pytest.approx(sorted(model.body_inertia[1]), rel=1e-6)


@pytest.mark.parametrize(("zz", "xz"), [("7e-5", "1e-5"), ("8e-5", "0")], ids=["solid", "tilted plate"])
def test_inertias_of_links_reach_urdf_mjcf_and_simulation(zz: str, xz: str, tmp_path: Path) -> None:
    inertial = (
        '<inertial><origin xyz="0.03 0 -0.004" rpy="0 0.4 0"/><mass value="0.06"/>'
        f'<inertia ixx="2e-5" iyy="6e-5" izz="{zz}" ixy="0" ixz="{xz}" iyz="0"/></inertial>'
    )
    robot = imported(tmp_path, hexapod(inertial=inertial, trunk=BOX)).robot()
    assert robot.link_inertias_kg_m2 is not None
    for text in (urdf_of(robot), mjcf_of(robot)):
        check_masses(robot, imported(tmp_path, text).robot(), 1e-9)
    simulated = make_simulation(robot, World()).physics.model
    model = mujoco.MjModel.from_xml_string(mjcf_of(robot))
    for kind in ("coxa", "femur", "tibia"):
        own = simulated.name2id(f"{robot.name}/leg1/{kind}", "body")
        other = model.body(f"leg1_{kind}_link").id
        assert np.sort(simulated.body_inertia[own]) == pytest.approx(
            np.sort(model.body_inertia[other]), rel=1e-6
        )
        assert simulated.body_ipos[own] == pytest.approx(model.body_ipos[other], abs=1e-9)


# In, as others write it.

PHANTOMX = Path(__file__).parents[1] / "data" / "phantomx_humarobotics.urdf"
PHANTOMX_FOOT_M = (0.0, 0.13, 0.0)


def test_names_frames_and_directions_of_turning_do_not_matter(tmp_path: Path) -> None:
    """The same legs with other names, in another order, and with the tibiae turning the other way."""
    robot = shipped("phantomx")
    text = urdf_of(robot)
    for leg in range(1, 7):
        text = text.replace(f"leg{leg}_", f"bein{(leg * 5) % 7}_")
    text = text.replace("_coxa", "_a").replace("_femur", "_b").replace("_tibia", "_c")
    head, tail = text.split('<joint name="bein1_c"', 1)
    tail = tail.replace('xyz="0 -1 0"', 'xyz="0 1 0"', 1)
    tail = re.sub(
        r'lower="(\S+)" upper="(\S+)"',
        lambda m: f'lower="{-float(m[2])}" upper="{-float(m[1])}"',
        tail,
        count=1,
    )
    made = imported(tmp_path, head + '<joint name="bein1_c"' + tail)
    back = made.robot()
    assert back.link_vectors_m == pytest.approx(robot.link_vectors_m, abs=1e-4)
    assert back.mount_positions_body == pytest.approx(robot.mount_positions_body, abs=1e-4)
    assert back.joint_lower_rad == pytest.approx(robot.joint_lower_rad, abs=1e-4)
    assert "(bein1_c)" in made.text
    assert "(bein2_c)" not in made.text


def test_a_robot_that_looks_elsewhere_is_turned(tmp_path: Path) -> None:
    robot = shipped("phantomx")
    text = urdf_of(robot).replace(
        '<link name="base_link" />', '<link name="root" /><link name="base_link" />'
    )
    turned = '<joint name="turn" type="fixed"><parent link="root" /><child link="base_link" />'
    turned += f'<origin xyz="0 0 0.2" rpy="0 0 {math.pi / 2}" /></joint></robot>'
    text = text.replace("</robot>", turned)
    back = imported(tmp_path, text, forward="y").robot()
    assert back.mount_positions_body == pytest.approx(robot.mount_positions_body, abs=1e-4)
    sideways = imported(tmp_path, text).robot()
    assert abs(sideways.mount_positions_body[:, 0]).max() == pytest.approx(0.1, abs=1e-4)


def test_a_urdf_that_others_wrote_agrees_with_mujoco_and_walks(tmp_path: Path) -> None:
    made = import_robot(PHANTOMX, foot_m=PHANTOMX_FOOT_M)
    assert {"body.size_m", "foot_radius_m", "links.tibia.inertia_kg_m2"} <= set(made.unknown)
    assert "links.tibia.end_m" not in made.unknown
    file = tmp_path / "mine.yaml"
    file.write_text(made.text, encoding="utf-8")
    robot = load_robot(file)
    assert load_robot_file(file).to_measure == made.unknown
    # MuJoCo reads the file itself, without its meshes; joints and signs are those of the comments.
    text = re.sub(r"<(visual|collision)>.*?</\1>", "", PHANTOMX.read_text(encoding="utf-8"), flags=re.DOTALL)
    spec = mujoco.MjSpec.from_string(text)
    spec.compiler.fusestatic = False
    spec.compiler.balanceinertia = True
    for body in spec.bodies:
        if body.name.startswith("tibia"):
            body.add_site(name=f"foot_{body.name[6:]}", pos=PHANTOMX_FOOT_M)
    model = spec.compile()
    data = mujoco.MjData(model)
    legs = re.findall(r"# +leg \d: (.*)", made.text)
    frame_m = np.array(re.findall(r"frame is at (\S+), (\S+), (\S+) m", made.text)[0], dtype=float)
    assert [leg.split(",")[0] for leg in legs] == [
        f"j_c1_{side}" for side in ("lf", "lm", "lr", "rr", "rm", "rf")
    ]
    shares = np.random.default_rng(17).uniform(size=(20, N_JOINTS))
    for pose_rad in robot.joint_lower_rad + shares * (robot.joint_upper_rad - robot.joint_lower_rad):
        for leg, names in enumerate(legs):
            for index, name in enumerate(names.split(", ")):
                sign = -1 if name.startswith("(") else 1
                joint = model.joint(name.strip("()")).qposadr[0]
                data.qpos[joint] = sign * pose_rad[3 * leg + index]
        mujoco.mj_kinematics(model, data)
        feet_m = np.array([data.site(f"foot_{leg.split(',')[0][5:]}").xpos for leg in legs])
        # Its author wrote 1.5707 and 4.7123 for quarter turns.
        assert feet_m - frame_m == pytest.approx(foot_positions_body(robot, pose_rad), abs=5e-4)
    walked = run(robot=str(file), gait="tripod", duration_s=6, record=False).trial
    assert walked.status == "ok"
    assert walked.distance_m is not None
    assert walked.ideal_distance_m is not None
    assert walked.distance_m > 0.7 * walked.ideal_distance_m


def test_a_foot_that_nothing_shows_is_a_guess_that_names_the_mesh() -> None:
    made = import_robot(PHANTOMX)
    assert "tibia_l.STL" in made.reasons["links.tibia.end_m"]
    assert "--foot" in made.reasons["links.tibia.end_m"]
