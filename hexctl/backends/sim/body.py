"""The simulated body, generated from the robot description: one leg element, attached six times."""

from typing import Any

from hexctl.backends.sim.dm import mjcf
from hexctl.robot.model import Robot
from hexctl.types import JOINT_KINDS, N_LEGS

#: Passive damping of a gearbox without power, in N m s/rad.
GEAR_DAMPING = 0.02

#: A geom collides with the floor only; legs pass through one another.
ROBOT_CONTACT = {"contype": 0, "conaffinity": 1}
NO_CONTACT = {"contype": 0, "conaffinity": 0}


def make_body(robot: Robot) -> Any:
    """Return the mjcf model of a robot; its leg k is the attachment `leg{k}`."""
    root = mjcf.RootElement(model=robot.name)
    trunk = root.worldbody.add("body", name="trunk")
    length, width, height = robot.body.size_m
    shape = {
        "box": {"type": "box", "size": [length / 2, width / 2, height / 2]},
        "cylinder": {"type": "cylinder", "size": [length / 2, height / 2]},
    }[robot.body.shape]
    trunk.add("geom", name="trunk", mass=robot.body.mass_kg, **shape, **ROBOT_CONTACT)
    for index in range(N_LEGS):
        mount = trunk.add(
            "site",
            name=f"mount{index + 1}",
            pos=robot.mount_positions_body[index],
            euler=[0, 0, robot.mount_yaws_rad[index]],
        )
        mount.attach(_make_leg(robot, f"leg{index + 1}"))
    return root


def _make_leg(robot: Robot, name: str) -> Any:
    """Return one leg whose plane is x outward, z up: three links, three servos, a foot and its sensor."""
    leg = mjcf.RootElement(model=name)
    leg.compiler.angle = "radian"
    parent: Any = leg.worldbody
    start = [0.0, 0.0, 0.0]
    for index, kind in enumerate(JOINT_KINDS):
        link = parent.add("body", name=kind, pos=start)
        _add_servo(leg, link, robot, index)
        outward, up = robot.link_vectors_m[index]
        start = [outward, 0.0, up]
        contact = NO_CONTACT if kind == "coxa" else ROBOT_CONTACT
        link.add(
            "geom",
            name=kind,
            type="capsule",
            fromto=[0, 0, 0, *_link_end(robot, index)],
            size=[robot.link_radii_m[index]],
            mass=robot.link_masses_kg[index],
            **contact,
        )
        parent = link
    parent.add(
        "geom", name="foot", type="sphere", pos=start, size=[robot.foot_radius_m], mass=0, **ROBOT_CONTACT
    )
    touch = parent.add("site", name="foot", type="sphere", pos=start, size=[1.5 * robot.foot_radius_m])
    leg.sensor.add("touch", name="foot", site=touch)
    return leg


def _link_end(robot: Robot, index: int) -> list[float]:
    """Return where a link's solid ends; the tibia's ends short of the foot, so the foot touches first."""
    outward, up = robot.link_vectors_m[index]
    share = 1.0
    if JOINT_KINDS[index] == "tibia":
        share = max(0.5, 1 - robot.foot_radius_m / float((outward**2 + up**2) ** 0.5))
    return [share * outward, 0.0, share * up]


def _add_servo(leg: Any, link: Any, robot: Robot, index: int) -> None:
    """Add a joint and the position servo that drives it."""
    kind = JOINT_KINDS[index]
    low, high = robot.joint_lower_rad[index], robot.joint_upper_rad[index]
    # A negative turn about y lifts what points along x.
    axis = [0, 0, 1] if kind == "coxa" else [0, -1, 0]
    joint = link.add(
        "joint",
        name=kind,
        type="hinge",
        axis=axis,
        limited=True,
        range=[low, high],
        armature=robot.servo.rotor_inertia_kg_m2,
        damping=GEAR_DAMPING,
    )
    torque = robot.joint_max_torque_nm[index]
    leg.actuator.add(
        "position",
        name=kind,
        joint=joint,
        kp=robot.servo.stiffness_nm_per_rad,
        kv=robot.servo.damping_nm_s_per_rad,
        forcelimited=True,
        forcerange=[-torque, torque],
    )
