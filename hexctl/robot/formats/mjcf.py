"""A robot as MJCF, the model format of MuJoCo: the body of hexctl's simulation as a file."""

import math
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

from hexctl.palette import BACKGROUND, BODY_COLOR, GROUND_COLOR, LINK_COLORS
from hexctl.robot.formats.link_frames import BASE_LINK, FOOT_LINKS, JOINT_LINKS
from hexctl.robot.formats.link_masses import PartMass, link_capsule, link_mass, trunk_mass
from hexctl.robot.formats.xml_text import add, color_text, number, numbers, text_of
from hexctl.robot.model import STICTION, Robot
from hexctl.robot.rotations import about_z, quaternion_about
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, N_LEGS

#: Numbers of hexctl in a file, which MJCF has no place for; those of joints are for coxa, femur and tibia.
GEAR_KEY, LOAD_KEY, PLAY_KEY = "gear_damping_nm_s_per_rad", "load_friction", "play_rad"
SIZE_KEY, GAIT_KEY, SPEED_KEY = "size_m", "gait", "max_speed_rad_s"

#: Step of the physics in a file.
STEP_S = 0.002

#: The robot collides with only the floor; legs pass through one another.
_TOUCHES = {"contype": "0", "conaffinity": "1"}
_PASSES = {"contype": "0", "conaffinity": "0"}

#: The other colour of the chequered floor.
_LIGHTER = (GROUND_COLOR[0] + 14, GROUND_COLOR[1] + 14, GROUND_COLOR[2] + 14)

#: Cameras: direction of view as azimuth and elevation.
CAMERAS = {"side": (-90.0, 12.0), "top": (-90.0, 89.0), "follow": (-145.0, 25.0)}
#: Vertical angle of view of the cameras.
FOVY_DEG = 35.0


#: Physics and friction of the world `flat`, colours, a chequered floor and light. Shadows would take most of
#: the time. Pictures larger than MuJoCo's 640 x 480 need a larger buffer. The usual haze is white: a bright
#: line at the dark background's horizon.
_SCENE = f"""<mujoco>
<compiler angle="radian"/>
<option timestep="{STEP_S}" integrator="implicitfast" cone="elliptic" tolerance="1e-12"/>
<visual>
  <headlight ambient="0.4 0.4 0.4" diffuse="0.35 0.35 0.35" specular="0 0 0"/>
  <global offwidth="1920" offheight="1920"/>
  <rgba haze="{color_text(BACKGROUND)} 1"/>
  <quality shadowsize="0"/>
</visual>
<asset>
  <texture name="floor" rgb1="{color_text(GROUND_COLOR)}" rgb2="{color_text(_LIGHTER)}" type="2d"
    builtin="checker" width="256" height="256"/>
  <texture type="skybox" builtin="flat" rgb1="{color_text(BACKGROUND)}" width="32" height="32"/>
  <material name="floor" texture="floor" texrepeat="5 5" texuniform="true"/>
</asset>
<worldbody>
  <light pos="0 0 3" dir="0 0 -1" directional="true" castshadow="false" diffuse="0.35 0.35 0.35"
    specular="0 0 0"/>
  <geom name="floor" type="plane" size="0 0 0.05" material="floor" contype="1" conaffinity="0"
    friction="0.8 0.005 0.0001" priority="1"/>
</worldbody>
</mujoco>"""


def mjcf_of(robot: Robot) -> str:
    """MJCF of a robot on an even floor, as text: masses, limits, servos and friction of the simulation.

    Joints and actuators have hexctl's names (`leg1_coxa`), bodies those of
    `hexctl.robot.formats.link_frames`. The keyframe is `stance`; the cameras `side`, `top` and `follow` move
    with the robot.
    """
    root = ElementTree.fromstring(_SCENE)  # noqa: S314  our own text
    root.set("model", robot.name)
    assets, world = root.find("asset"), root.find("worldbody")
    assert assets is not None  # noqa: S101  both are in the text
    assert world is not None  # noqa: S101
    for name, color in {"body": BODY_COLOR, **LINK_COLORS}.items():
        add(assets, "material", name=name, rgba=f"{color_text(color)} 1")
    _add_robot(world, robot)
    _add_servos(root, robot)
    stance = numbers(*robot.stance_angles_rad)
    _add_numbers(root, robot)
    keyframes = add(root, "keyframe")
    qpos = f"0 0 {number(robot.standing_height_m)} 1 0 0 0 {stance}"
    add(keyframes, "key", name="stance", qpos=qpos, ctrl=stance)
    return text_of(root)


def _add_numbers(root: Element, robot: Robot) -> None:
    """Add what MJCF has no place for, so that `hexctl robot import` finds it."""
    gait = robot.gait
    speeds = robot.joint_max_speed_rad_s[:JOINTS_PER_LEG]
    values = {SIZE_KEY: [robot.size_m], GAIT_KEY: [gait.pace_hz, gait.amplitude, gait.height]}
    custom = add(root, "custom")
    servo = robot.servo
    values |= {SPEED_KEY: speeds.tolist(), GEAR_KEY: [servo.gear_damping_nm_s_per_rad]}
    if servo.load_friction:
        values[LOAD_KEY] = [servo.load_friction]
    if robot.joint_play_rad is not None:
        values[PLAY_KEY] = robot.joint_play_rad[:JOINTS_PER_LEG].tolist()
    for name, data in values.items():
        add(custom, "numeric", name=name, data=numbers(*data))


def _add_servos(root: Element, robot: Robot) -> None:
    actuators = add(root, "actuator")
    steps = round(robot.servo.dead_time_s / STEP_S)
    delay = {"delay": number(robot.servo.dead_time_s), "nsample": str(steps + 1)} if steps else {}
    for joint, name in enumerate(JOINT_NAMES):
        torque_nm = number(robot.joint_max_torque_nm[joint])
        add(
            actuators,
            "position",
            name=name,
            joint=name,
            kp=number(robot.stiffness_nm_per_rad[joint]),
            kv=number(robot.servo.damping_nm_s_per_rad),
            forcerange=f"-{torque_nm} {torque_nm}",
            ctrlrange=numbers(robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]),
            **delay,
        )


def _add_robot(world: Element, robot: Robot) -> None:
    base = add(world, "body", name=BASE_LINK, pos=f"0 0 {number(robot.standing_height_m)}")
    add(base, "freejoint", name="base")
    _add_cameras(base, robot)
    length, width, height = robot.body.size_m
    sizes = {"box": (length / 2, width / 2, height / 2), "cylinder": (length / 2, height / 2)}
    shape = robot.body.shape
    size = numbers(*sizes[shape])
    add(base, "geom", name="trunk", type=shape, size=size, material="body", mass="0", **_TOUCHES)
    _add_inertial(base, trunk_mass(robot.body))
    for leg in range(N_LEGS):
        parent = base
        for index in range(JOINTS_PER_LEG):
            parent = _add_link(parent, robot, JOINTS_PER_LEG * leg + index)
        outward_m, up_m = robot.link_vectors_m[-1].tolist()
        foot = {"name": FOOT_LINKS[leg], "pos": numbers(outward_m, 0.0, up_m), "type": "sphere"}
        radius = number(robot.foot_radius_m)
        add(parent, "geom", **foot, size=radius, material="tibia", mass="0", **_TOUCHES)
        add(parent, "site", **foot, size=number(1.5 * robot.foot_radius_m), rgba="0 0 0 0")


def _add_cameras(base: Element, robot: Robot) -> None:
    reach_m = 1.3 * robot.stance_radius_m
    away_m = reach_m / math.tan(math.radians(FOVY_DEG / 2))
    for name, (azimuth_deg, elevation_deg) in CAMERAS.items():
        azimuth, elevation = math.radians(azimuth_deg), math.radians(elevation_deg)
        toward = (
            math.cos(elevation) * math.cos(azimuth),
            math.cos(elevation) * math.sin(azimuth),
            math.sin(elevation),
        )
        right = (-math.sin(azimuth), math.cos(azimuth), 0.0)
        up = (
            -math.sin(elevation) * math.cos(azimuth),
            -math.sin(elevation) * math.sin(azimuth),
            math.cos(elevation),
        )
        at = numbers(*(away_m * part for part in toward))
        looks = {"fovy": number(FOVY_DEG), "xyaxes": numbers(*right, *up)}
        add(base, "camera", name=name, mode="trackcom", pos=at, **looks)


def _add_link(parent: Element, robot: Robot, joint: int) -> Element:
    leg, index = divmod(joint, JOINTS_PER_LEG)
    kind, capsule = JOINT_KINDS[index], link_capsule(robot, index)
    if kind == "coxa":
        place = {"pos": numbers(*robot.mount_positions_body[leg])}
        place["quat"] = numbers(*about_z(float(robot.mount_yaws_rad[leg])))
    else:
        outward_m, up_m = robot.link_vectors_m[index - 1].tolist()
        place = {"pos": numbers(outward_m, 0.0, up_m)}
    link = add(parent, "body", name=JOINT_LINKS[joint], **place)
    _add_inertial(link, link_mass(robot, index))
    add(
        link,
        "joint",
        name=JOINT_NAMES[joint],
        axis="0 0 1" if kind == "coxa" else "0 -1 0",
        range=numbers(robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]),
        armature=number(robot.servo.rotor_inertia_kg_m2),
        damping=number(robot.servo.gear_damping_nm_s_per_rad + float(robot.back_emf_nm_s_per_rad[joint])),
        frictionloss=number(robot.dry_friction_nm[joint]),
        solimpfriction=numbers(*STICTION),
    )
    add(
        link,
        "geom",
        name=f"{JOINT_LINKS[joint]}_solid",
        type="capsule",
        fromto=f"0 0 0 {numbers(capsule.end_m[0], 0.0, capsule.end_m[1])}",
        size=number(capsule.radius_m),
        material=kind,
        mass="0",
        **(_PASSES if kind == "coxa" else _TOUCHES),
    )
    return link


def _add_inertial(body: Element, mass: PartMass) -> None:
    add(
        body,
        "inertial",
        pos=numbers(*mass.com_m),
        mass=number(mass.mass_kg),
        quat=numbers(*quaternion_about((0.0, 1.0, 0.0), mass.tilt_rad)),
        diaginertia=numbers(*mass.moments_kg_m2),
    )
