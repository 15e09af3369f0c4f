"""Robots as JSON, MJCF and URDF, as MuJoCo, yourdfpy and Rerun read them."""

from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import mujoco
import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.formats.json_model import robot_from_json, robot_to_json
from hexctl.robot.formats.link_frames import FOOT_LINKS, fixed_transforms, link_transforms
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.formats.urdf import COMMAND_TOPIC, TOPIC_SYSTEM, urdf_of
from hexctl.robot.formats.xml_text import parse_xml
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray
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


@pytest.fixture(params=ROBOT_NAMES)
def name(request: Any) -> str:
    return str(request.param)


@pytest.mark.slow
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
def test_mujoco_finds_the_feet_where_our_kinematics_do(name: str) -> None:
    robot = shipped(name)
    model = compiled(urdf_of(robot))
    data = mujoco.MjData(model)
    joints = [model.joint(joint).qposadr[0] for joint in JOINT_NAMES]
    feet = [model.body(foot).id for foot in FOOT_LINKS]
    assert model.body_mass[model.body("base_link").id] == 0
    for pose_rad in poses(robot):
        data.qpos[joints] = pose_rad
        mujoco.mj_kinematics(model, data)
        off_m = data.xpos[feet] - foot_positions_body(robot, pose_rad)
        assert np.abs(off_m).max() < 1e-9


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


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_transforms_of_links_are_those_of_the_urdf(name: str) -> None:
    robot = shipped(name)
    model = compiled(urdf_of(robot))
    data = mujoco.MjData(model)
    pose_rad = poses(robot, 1)[0]
    data.qpos[[model.joint(joint).qposadr[0] for joint in JOINT_NAMES]] = pose_rad
    mujoco.mj_kinematics(model, data)
    for transforms in (link_transforms(robot, pose_rad), fixed_transforms(robot)):
        for index, (parent, child) in enumerate(zip(transforms.parents, transforms.children, strict=True)):
            above, below = model.body(parent).id, model.body(child).id
            turn = data.xmat[above].reshape(3, 3).T
            found_m = turn @ (data.xpos[below] - data.xpos[above])
            matrix = np.empty(9)
            mujoco.mju_quat2Mat(matrix, transforms.quaternions[index])
            assert found_m == pytest.approx(transforms.translations_m[index], abs=1e-9)
            assert turn @ data.xmat[below].reshape(3, 3) == pytest.approx(matrix.reshape(3, 3), abs=1e-9)


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
