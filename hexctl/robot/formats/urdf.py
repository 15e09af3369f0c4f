"""A robot as URDF, the robot description of ROS: primitives, limits and inertias, without files beside it."""

from collections.abc import Iterable
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

from hexctl.palette import BODY_COLOR, LINK_COLORS
from hexctl.robot.formats.link_frames import (
    BASE_LINK,
    FOOT_LINKS,
    JOINT_LINKS,
    JOINT_PARENTS,
    TRUNK_LINK,
    fixed_transforms,
    link_transforms,
)
from hexctl.robot.formats.link_masses import PartMass, link_capsule, link_mass, trunk_mass
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS

#: The ros2_control hardware that speaks JointState over topics (joint_state_topic_hardware_interface).
TOPIC_SYSTEM = "joint_state_topic_hardware_interface/JointStateTopicSystem"
#: Topic of commands from ros2_control, and that of the robot's joints.
COMMAND_TOPIC, STATE_TOPIC = "/robot_joint_command", "/joint_states"


def urdf_of(robot: Robot, *, ros2_control: bool = False) -> str:
    """URDF of a robot, as text.

    Joints are called as everywhere in hexctl (`leg1_coxa`), with its signs and zeros; links are those of
    `hexctl.robot.formats.link_frames`. The root link `base_link` has no mass, which dynamics libraries of
    ROS insist on. Numbers have all their digits: the same kinematics come back.

    Args:
        robot: the robot.
        ros2_control: add a block with which ros2_control commands the joints over topics.
    """
    root = Element("robot", name=robot.name)
    for name, color in {"body": BODY_COLOR, **LINK_COLORS}.items():
        material = SubElement(root, "material", name=name)
        SubElement(material, "color", rgba=_numbers(*(round(part / 255, 4) for part in color), 1.0))
    SubElement(root, "link", name=BASE_LINK)
    _add_trunk(root, robot)
    for joint in range(N_JOINTS):
        _add_link(root, robot, joint)
        _add_joint(root, robot, joint)
    for foot in FOOT_LINKS:
        SubElement(root, "link", name=foot)
    _add_fixed_joints(root, robot)
    if ros2_control:
        _add_ros2_control(root, robot)
    ElementTree.indent(root)
    # No encoding in the declaration: lxml refuses one in a text.
    return f'<?xml version="1.0"?>\n{ElementTree.tostring(root, encoding="unicode")}\n'


def _add_trunk(root: Element, robot: Robot) -> None:
    link = SubElement(root, "link", name=TRUNK_LINK)
    length, width, height = robot.body.size_m
    for use in ("visual", "collision"):
        geometry = _shape(link, use, (0.0, 0.0, 0.0), 0.0, "body")
        if robot.body.shape == "box":
            SubElement(geometry, "box", size=_numbers(length, width, height))
        else:
            SubElement(geometry, "cylinder", radius=_number(length / 2), length=_number(height))
    _add_inertial(link, trunk_mass(robot.body))


def _add_link(root: Element, robot: Robot, joint: int) -> None:
    """Add a link: a cylinder along it, a ball at its joint, at the end of a tibia the foot."""
    index = joint % JOINTS_PER_LEG
    kind, capsule = JOINT_KINDS[index], link_capsule(robot, index)
    link = SubElement(root, "link", name=JOINT_LINKS[joint])
    middle = (capsule.end_m[0] / 2, 0.0, capsule.end_m[1] / 2)
    ball = SubElement(_shape(link, "visual", (0.0, 0.0, 0.0), 0.0, kind), "sphere")
    ball.set("radius", _number(capsule.radius_m))
    # Neighbours overlap at their joints, and coxae touch the trunk: only what may reach the floor collides.
    for use in ("visual", "collision") if kind != "coxa" else ("visual",):
        cylinder = SubElement(_shape(link, use, middle, capsule.tilt_rad, kind), "cylinder")
        cylinder.set("radius", _number(capsule.radius_m))
        cylinder.set("length", _number(capsule.length_m))
        if kind == "tibia":
            outward_m, up_m = robot.link_vectors_m[-1].tolist()
            foot = SubElement(_shape(link, use, (outward_m, 0.0, up_m), 0.0, kind), "sphere")
            foot.set("radius", _number(robot.foot_radius_m))
    _add_inertial(link, link_mass(robot, index))


def _shape(link: Element, use: str, at_m: Iterable[float], tilt_rad: float, material: str) -> Element:
    """Add a `visual` or a `collision` and give its `geometry`."""
    part = SubElement(link, use)
    SubElement(part, "origin", xyz=_numbers(*at_m), rpy=_numbers(0.0, tilt_rad, 0.0))
    geometry = SubElement(part, "geometry")
    if use == "visual":
        SubElement(part, "material", name=material)
    return geometry


def _add_inertial(link: Element, mass: PartMass) -> None:
    inertial = SubElement(link, "inertial")
    SubElement(inertial, "origin", xyz=_numbers(*mass.com_m), rpy=_numbers(0.0, mass.tilt_rad, 0.0))
    SubElement(inertial, "mass", value=_number(mass.mass_kg))
    moments = dict(zip(("ixx", "iyy", "izz"), map(_number, mass.moments_kg_m2), strict=True))
    SubElement(inertial, "inertia", {**moments, "ixy": "0", "ixz": "0", "iyz": "0"})


def _add_joint(root: Element, robot: Robot, joint: int) -> None:
    kind = JOINT_KINDS[joint % JOINTS_PER_LEG]
    element = SubElement(root, "joint", name=JOINT_NAMES[joint], type="revolute")
    at_m = link_transforms(robot, robot.stance_angles_rad).translations_m[joint].tolist()
    yaw_rad = float(robot.mount_yaws_rad[joint // JOINTS_PER_LEG]) if kind == "coxa" else 0.0
    SubElement(element, "origin", xyz=_numbers(*at_m), rpy=_numbers(0.0, 0.0, yaw_rad))
    SubElement(element, "parent", link=JOINT_PARENTS[joint])
    SubElement(element, "child", link=JOINT_LINKS[joint])
    SubElement(element, "axis", xyz="0 0 1" if kind == "coxa" else "0 -1 0")
    SubElement(
        element,
        "limit",
        lower=_number(robot.joint_lower_rad[joint]),
        upper=_number(robot.joint_upper_rad[joint]),
        effort=_number(robot.joint_max_torque_nm[joint]),
        velocity=_number(robot.joint_max_speed_rad_s[joint]),
    )
    SubElement(element, "dynamics", damping="0", friction=_number(robot.dry_friction_nm[joint]))


def _add_fixed_joints(root: Element, robot: Robot) -> None:
    fixed = fixed_transforms(robot)
    for parent, child, at_m in zip(fixed.parents, fixed.children, fixed.translations_m.tolist(), strict=True):
        element = SubElement(root, "joint", name=f"{child}_joint", type="fixed")
        SubElement(element, "origin", xyz=_numbers(*at_m), rpy="0 0 0")
        SubElement(element, "parent", link=parent)
        SubElement(element, "child", link=child)


def _add_ros2_control(root: Element, robot: Robot) -> None:
    """Add the hardware that commands joints over topics.

    Its threshold is -1: with the usual one nothing is sent while the robot is to hold still, and the robot
    takes silence for a lost controller.
    """
    system = SubElement(root, "ros2_control", name=robot.name, type="system")
    hardware = SubElement(system, "hardware")
    SubElement(hardware, "plugin").text = TOPIC_SYSTEM
    parameters = {
        "joint_commands_topic": COMMAND_TOPIC,
        "joint_states_topic": STATE_TOPIC,
        "trigger_joint_command_threshold": "-1",
    }
    for name, value in parameters.items():
        SubElement(hardware, "param", name=name).text = value
    for index, name in enumerate(JOINT_NAMES):
        joint = SubElement(system, "joint", name=name)
        command = SubElement(joint, "command_interface", name="position")
        for end, limits in (("min", robot.joint_lower_rad), ("max", robot.joint_upper_rad)):
            SubElement(command, "param", name=end).text = _number(limits[index])
        state = SubElement(joint, "state_interface", name="position")
        SubElement(state, "param", name="initial_value").text = _number(robot.stance_angles_rad[index])


def _number(value: float) -> str:
    """The shortest text that gives the same number again."""
    return repr(float(value))


def _numbers(*values: float) -> str:
    return " ".join(map(_number, values))
