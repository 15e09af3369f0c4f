"""A robot as URDF, the robot description of ROS: primitives, limits and inertias in a single file."""

from collections.abc import Iterable
from xml.etree.ElementTree import Element

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
from hexctl.robot.formats.xml_text import add, color_text, number, numbers, text_of
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS

#: The ros2_control hardware that exchanges JointState over topics (joint_state_topic_hardware_interface).
TOPIC_SYSTEM = "joint_state_topic_hardware_interface/JointStateTopicSystem"
#: Topics of commands from ros2_control, and of the robot's joints.
COMMAND_TOPIC, STATE_TOPIC = "/robot_joint_command", "/joint_states"


def urdf_of(
    robot: Robot,
    *,
    ros2_control: bool = False,
    command_topic: str = COMMAND_TOPIC,
    state_topic: str = STATE_TOPIC,
) -> str:
    """URDF of a robot, as text.

    Joints have hexctl's names (`leg1_coxa`), signs and zeros; links are those of
    `hexctl.robot.formats.link_frames`. The root `base_link` has no mass, as dynamics libraries of ROS
    require. Numbers have all digits.

    Args:
        ros2_control: add a block with which ros2_control commands the joints over topics.
        command_topic: full name of the topic of its commands.
        state_topic: full name of the topic of the robot's joints.
    """
    root = Element("robot", name=robot.name)
    for name, color in {"body": BODY_COLOR, **LINK_COLORS}.items():
        material = add(root, "material", name=name)
        add(material, "color", rgba=f"{color_text(color)} 1")
    add(root, "link", name=BASE_LINK)
    _add_trunk(root, robot)
    for joint in range(N_JOINTS):
        _add_link(root, robot, joint)
        _add_joint(root, robot, joint)
    for foot in FOOT_LINKS:
        add(root, "link", name=foot)
    _add_fixed_joints(root, robot)
    if ros2_control:
        _add_ros2_control(root, robot, command_topic, state_topic)
    return text_of(root)


def _add_trunk(root: Element, robot: Robot) -> None:
    link = add(root, "link", name=TRUNK_LINK)
    length, width, height = robot.body.size_m
    for use in ("visual", "collision"):
        geometry = _shape(link, use, (0.0, 0.0, 0.0), 0.0, "body")
        if robot.body.shape == "box":
            add(geometry, "box", size=numbers(length, width, height))
        else:
            add(geometry, "cylinder", radius=number(length / 2), length=number(height))
    _add_inertial(link, trunk_mass(robot.body))


def _add_link(root: Element, robot: Robot, joint: int) -> None:
    """Add a link: a cylinder along it, a ball at its joint, at the end of a tibia the foot."""
    index = joint % JOINTS_PER_LEG
    kind, capsule = JOINT_KINDS[index], link_capsule(robot, index)
    link = add(root, "link", name=JOINT_LINKS[joint])
    middle = (capsule.end_m[0] / 2, 0.0, capsule.end_m[1] / 2)
    ball = add(_shape(link, "visual", (0.0, 0.0, 0.0), 0.0, kind), "sphere")
    ball.set("radius", number(capsule.radius_m))
    # Neighbours overlap at their joints, and coxae touch the trunk: only links near the floor collide.
    for use in ("visual", "collision") if kind != "coxa" else ("visual",):
        cylinder = add(_shape(link, use, middle, capsule.tilt_rad, kind), "cylinder")
        cylinder.set("radius", number(capsule.radius_m))
        cylinder.set("length", number(capsule.length_m))
        if kind == "tibia":
            outward_m, up_m = robot.link_vectors_m[-1].tolist()
            foot = add(_shape(link, use, (outward_m, 0.0, up_m), 0.0, kind), "sphere")
            foot.set("radius", number(robot.foot_radius_m))
    _add_inertial(link, link_mass(robot, index))


def _shape(link: Element, use: str, at_m: Iterable[float], tilt_rad: float, material: str) -> Element:
    """Add a `visual` or a `collision` and return its `geometry`."""
    part = add(link, use)
    add(part, "origin", xyz=numbers(*at_m), rpy=numbers(0.0, tilt_rad, 0.0))
    geometry = add(part, "geometry")
    if use == "visual":
        add(part, "material", name=material)
    return geometry


def _add_inertial(link: Element, mass: PartMass) -> None:
    inertial = add(link, "inertial")
    add(inertial, "origin", xyz=numbers(*mass.com_m), rpy=numbers(0.0, mass.tilt_rad, 0.0))
    add(inertial, "mass", value=number(mass.mass_kg))
    moments = dict(zip(("ixx", "iyy", "izz"), map(number, mass.moments_kg_m2), strict=True))
    add(inertial, "inertia", **moments, ixy="0", ixz="0", iyz="0")


def _add_joint(root: Element, robot: Robot, joint: int) -> None:
    kind = JOINT_KINDS[joint % JOINTS_PER_LEG]
    element = add(root, "joint", name=JOINT_NAMES[joint], type="revolute")
    at_m = link_transforms(robot, robot.stance_angles_rad).translations_m[joint].tolist()
    yaw_rad = float(robot.mount_yaws_rad[joint // JOINTS_PER_LEG]) if kind == "coxa" else 0.0
    add(element, "origin", xyz=numbers(*at_m), rpy=numbers(0.0, 0.0, yaw_rad))
    add(element, "parent", link=JOINT_PARENTS[joint])
    add(element, "child", link=JOINT_LINKS[joint])
    add(element, "axis", xyz="0 0 1" if kind == "coxa" else "0 -1 0")
    add(
        element,
        "limit",
        lower=number(robot.joint_lower_rad[joint]),
        upper=number(robot.joint_upper_rad[joint]),
        effort=number(robot.joint_max_torque_nm[joint]),
        velocity=number(robot.joint_max_speed_rad_s[joint]),
    )
    # The back-EMF of the motor; `velocity` limits only commands.
    damping = number(robot.back_emf_nm_s_per_rad[joint])
    add(element, "dynamics", damping=damping, friction=number(robot.dry_friction_nm[joint]))


def _add_fixed_joints(root: Element, robot: Robot) -> None:
    fixed = fixed_transforms(robot)
    for parent, child, at_m in zip(fixed.parents, fixed.children, fixed.translations_m.tolist(), strict=True):
        element = add(root, "joint", name=f"{child}_joint", type="fixed")
        add(element, "origin", xyz=numbers(*at_m), rpy="0 0 0")
        add(element, "parent", link=parent)
        add(element, "child", link=child)


def _add_ros2_control(root: Element, robot: Robot, command_topic: str, state_topic: str) -> None:
    """Add the hardware that commands joints over topics.

    Its threshold is -1: with the default nothing is sent while the robot is to hold still, and the robot
    takes silence for a lost controller.
    """
    system = add(root, "ros2_control", name=robot.name, type="system")
    hardware = add(system, "hardware")
    add(hardware, "plugin").text = TOPIC_SYSTEM
    parameters = {
        "joint_commands_topic": command_topic,
        "joint_states_topic": state_topic,
        "trigger_joint_command_threshold": "-1",
    }
    for name, value in parameters.items():
        add(hardware, "param", name=name).text = value
    for index, name in enumerate(JOINT_NAMES):
        joint = add(system, "joint", name=name)
        command = add(joint, "command_interface", name="position")
        for end, limits in (("min", robot.joint_lower_rad), ("max", robot.joint_upper_rad)):
            add(command, "param", name=end).text = number(limits[index])
        state = add(joint, "state_interface", name="position")
        add(state, "param", name="initial_value").text = number(robot.stance_angles_rad[index])
