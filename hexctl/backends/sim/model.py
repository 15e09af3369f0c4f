"""The simulated model: robot, world and failure compiled into one dm_control Physics in its start state."""

import math
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hexctl.backends.sim.dm import mjcf
from hexctl.backends.sim.terrain import ROUGH_CELLS, ROUGH_HALF_SIZE_M, Floor, make_floor
from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from hexctl.robot.model import Body, Robot
from hexctl.types import (
    JOINT_KINDS,
    JOINTS_PER_LEG,
    N_JOINTS,
    N_LEGS,
    ArrayFields,
    BoolArray,
    FloatArray,
    leg_slice,
)

#: Where the joints begin in qpos: after the free joint's position and quaternion.
FIRST_JOINT = 7

#: Where the joints begin in qvel: after the free joint's velocities.
FIRST_SPEED = 6

#: Passive damping of a gearbox without power, in N m s/rad.
GEAR_DAMPING = 0.02

#: A geom collides with the floor only; legs pass through one another.
ROBOT_CONTACT = {"contype": 0, "conaffinity": 1}
NO_CONTACT = {"contype": 0, "conaffinity": 0}

#: Impedance of dry friction. With MuJoCo's 0.9 a joint creeps at degrees per second under half the torque
#: that would break it loose; with this, at hundredths.
STICTION = [0.999, 0.999, 0.001]

#: Tolerance of the constraint solver. With MuJoCo's 1e-8 what is left of the last iteration depends on the
#: compass direction of a walk, and 2 cm may grow of it in 30 s; with this, 0.1 mm for most walks.
SOLVER_TOLERANCE = 1e-12

#: Stiffness and torque limit of a jammed joint, as multiples of its servo's.
JAM_STIFFNESS = 20.0

#: Remaining share of the mass of a missing leg: MuJoCo needs some.
MISSING_MASS_SHARE = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Simulation(ArrayFields):
    """A compiled simulation in its start state.

    Attributes:
        physics: dm_control Physics; qpos is base position, base quaternion, 18 joints.
        world: the world it was made from.
        floor: the floor it stands on.
        joint_offsets_rad: calibration error per joint: true angle - angle reported by the servo, (18,).
        jammed: joints that hold `jammed_at_rad` regardless of their targets, (18,).
        jammed_at_rad: (18,).
    """

    physics: Any
    world: World
    floor: Floor
    joint_offsets_rad: FloatArray
    jammed: BoolArray
    jammed_at_rad: FloatArray


def make_simulation(
    robot: Robot, world: World, failure: Failure | None = None, seed: int = 0, facing_rad: float = 0.0
) -> Simulation:
    """The simulation of a robot that stands in a world, with a failed leg if one is given.

    `facing_rad` is the yaw in which the robot is put down.
    """
    floor = make_floor(world, seed)
    body = make_body(robot)
    _load_trunk(body, robot, world)
    _load_payload(body, world)
    root = _make_world(world, floor)
    root.attach(body).add("freejoint")
    physics = mjcf.Physics.from_mjcf_model(root)
    # The plain mj_step order, which mujoco.batch also takes: results are then equal to the last bit.
    physics.legacy_step = False
    _check_order(physics)
    _fill_heights(physics, floor)
    _scale_servos(physics, world)
    jammed, jammed_at = inject_failure(physics, robot, failure)
    _set_start_state(physics, robot, floor, facing_rad)
    offsets = _joint_offsets(world, seed)
    return Simulation(physics, world, floor, offsets, jammed, jammed_at)


def _load_trunk(body: Any, robot: Robot, world: World) -> None:
    """Change and shift the mass of the trunk; its shape stays where it is."""
    if not world.added_mass_share and not any(world.body_mass_shift_m):
        return
    mass_kg = robot.body.mass_kg + world.added_mass_share * robot.mass_kg
    if mass_kg <= 0:
        least = -robot.body.mass_kg / robot.mass_kg
        raise InputError(
            f"added_mass_share: got {world.added_mass_share:g}; allowed for {robot.name}: above {least:.3g}"
        )
    # A solid beside the trunk's own carries the mass.
    solid = body.find("geom", "mass") or body.find("geom", "trunk")
    at = np.zeros(3) if solid.pos is None else np.array(solid.pos)
    body.find("body", "trunk").add(
        "geom",
        name="ballast",
        type=solid.type,
        size=solid.size,
        pos=at + world.body_mass_shift_m,
        mass=mass_kg,
        **NO_CONTACT,
    )
    solid.mass = 0


def _load_payload(body: Any, world: World) -> None:
    """Put the payload on the trunk, as a mass without contact."""
    if world.payload_kg:
        trunk = body.find("body", "trunk")
        trunk.add(
            "geom",
            name="payload",
            type="box",
            size=[0.02, 0.02, 0.02],
            pos=world.payload_position_m,
            mass=world.payload_kg,
            **NO_CONTACT,
        )


def _make_world(world: World, floor: Floor) -> Any:
    """An mjcf model with the physics options and the floor."""
    root = mjcf.RootElement(model="world")
    root.compiler.angle = "radian"
    root.option.timestep = world.time_step_s
    root.option.integrator = "implicitfast"
    root.option.cone = world.friction_cone
    root.option.tolerance = SOLVER_TOLERANCE
    contact: dict[str, Any] = {
        "contype": 1,
        "conaffinity": 0,
        "friction": [world.friction, 0.005, 0.0001],
        "solref": [world.contact_time_s, 1],
        "priority": 1,  # the floor's friction and softness count, whatever the feet are made of
        "quat": floor.quaternion_world,
    }
    depth = 0.0
    if floor.heights_m is not None:
        low, high = floor.heights_m.min(), floor.heights_m.max()
        root.asset.add(
            "hfield",
            name="bumps",
            nrow=ROUGH_CELLS,
            ncol=ROUGH_CELLS,
            size=[ROUGH_HALF_SIZE_M, ROUGH_HALF_SIZE_M, high - low, 0.1],
        )
        root.worldbody.add(
            "geom", name="bumps", type="hfield", hfield="bumps", pos=low * floor.normal_world, **contact
        )
        depth = low
    root.worldbody.add(
        "geom", name="floor", type="plane", size=[0, 0, 1], pos=depth * floor.normal_world, **contact
    )
    return root


def _check_order(physics: Any) -> None:
    """Raise unless joints and actuators are in leg-major order, which every array relies on."""
    expected = [f"leg{leg}/{kind}" for leg in range(1, N_LEGS + 1) for kind in JOINT_KINDS]
    model = physics.model
    joints = [model.id2name(index, "joint") for index in range(1, N_JOINTS + 1)]
    actuators = [model.id2name(index, "actuator") for index in range(N_JOINTS)]
    for names in (joints, actuators):
        if [name.split("/", 1)[1] for name in names] != expected:
            raise RuntimeError(f"the compiled model has an unexpected order: {names}")


def _fill_heights(physics: Any, floor: Floor) -> None:
    """Write the bumps into the compiled height field, scaled to 0..1."""
    if floor.heights_m is not None:
        spread = floor.heights_m - floor.heights_m.min()
        physics.model.hfield_data[:] = (spread / spread.max()).ravel()


def _scale_servos(physics: Any, world: World) -> None:
    """Scale torque limit and stiffness of the servos by the world."""
    model = physics.model
    model.actuator_forcerange[:] *= world.servo_strength
    model.actuator_gainprm[:, 0] *= world.servo_stiffness
    model.actuator_biasprm[:, 1] *= world.servo_stiffness


def _set_start_state(physics: Any, robot: Robot, floor: Floor, facing_rad: float) -> None:
    """Put the robot on the floor in its nominal stance."""
    radius = robot.stance_radius_m + 2 * robot.foot_radius_m
    height = robot.standing_height_m + max(0.0, floor.highest_near_origin_m(radius))
    data = physics.data
    data.qpos[:3] = height * floor.normal_world
    data.qpos[3:FIRST_JOINT] = _turned(floor.quaternion_world, facing_rad)
    data.qpos[FIRST_JOINT:] = robot.stance_angles_rad
    data.ctrl[:] = robot.stance_angles_rad
    physics.forward()


def _joint_offsets(world: World, seed: int) -> FloatArray:
    """Calibration errors of the joints, (18,)."""
    given = world.joint_offset_deg
    if isinstance(given, tuple):
        return np.radians(given)
    # A stream of its own, so that bumps and offsets do not depend on one another.
    return np.random.default_rng([seed, 1]).normal(scale=np.radians(given), size=N_JOINTS)


def _turned(quaternion: FloatArray, yaw_rad: float) -> FloatArray:
    """An orientation (w, x, y, z) after a turn about the vertical of the body."""
    cos, sin = math.cos(yaw_rad / 2), math.sin(yaw_rad / 2)
    w, x, y, z = quaternion
    return np.array([w * cos - z * sin, x * cos + y * sin, y * cos - x * sin, z * cos + w * sin])


def make_body(robot: Robot) -> Any:
    """The mjcf model of a robot; its leg k is the attachment `leg{k}`."""
    root = mjcf.RootElement(model=robot.name)
    trunk = root.worldbody.add("body", name="trunk")
    length, width, height = robot.body.size_m
    shape = {
        "box": {"type": "box", "size": [length / 2, width / 2, height / 2]},
        "cylinder": {"type": "cylinder", "size": [length / 2, height / 2]},
    }[robot.body.shape]
    trunk.add("geom", name="trunk", mass=robot.body.mass_kg, **shape, **ROBOT_CONTACT)
    _place_mass(trunk, robot.body)
    for index in range(N_LEGS):
        mount = trunk.add(
            "site",
            name=f"mount{index + 1}",
            pos=robot.mount_positions_body[index],
            euler=[0, 0, robot.mount_yaws_rad[index]],
        )
        mount.attach(_make_leg(robot, f"leg{index + 1}"))
    return root


def _place_mass(trunk: Any, body: Body) -> None:
    """Give the trunk its own centre of mass and inertia, where the robot file has them.

    A solid without contact carries the mass: the trunk's own shape, or the box that has the inertia.
    """
    box_m = body.even_box_m
    if box_m is None and not any(body.com_m):
        return
    shape = trunk.geom["trunk"]
    solid = (
        {"type": shape.type, "size": shape.size}
        if box_m is None
        else {"type": "box", "size": [side / 2 for side in box_m]}
    )
    trunk.add("geom", name="mass", pos=body.com_m, mass=body.mass_kg, **solid, **NO_CONTACT)
    shape.mass = 0


def _make_leg(robot: Robot, name: str) -> Any:
    """One leg in the plane of x outward and z up: three links, three servos, a foot and its touch sensor."""
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
        _shift_link_mass(link, robot, index)
        parent = link
    parent.add(
        "geom", name="foot", type="sphere", pos=start, size=[robot.foot_radius_m], mass=0, **ROBOT_CONTACT
    )
    touch = parent.add("site", name="foot", type="sphere", pos=start, size=[1.5 * robot.foot_radius_m])
    leg.sensor.add("touch", name="foot", site=touch)
    return leg


def _shift_link_mass(link: Any, robot: Robot, index: int) -> None:
    """Move the mass of a link to its centre of mass, where the robot file has one."""
    if robot.link_coms_m is None:
        return
    shape = link.geom[JOINT_KINDS[index]]
    off = robot.link_coms_m[index] - robot.link_vectors_m[index] / 2
    start = [off[0], 0.0, off[1]]
    end = [off[0] + robot.link_vectors_m[index][0], 0.0, off[1] + robot.link_vectors_m[index][1]]
    link.add(
        "geom",
        name=f"{JOINT_KINDS[index]}_mass",
        type="capsule",
        fromto=[*start, *end],
        size=shape.size,
        mass=shape.mass,
        **NO_CONTACT,
    )
    shape.mass = 0


def _link_end(robot: Robot, index: int) -> list[float]:
    """End of the capsule of a link; the tibia ends before the foot, so that the foot touches first."""
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
    friction_nm = float(robot.dry_friction_nm[index])
    joint = link.add(
        "joint",
        name=kind,
        type="hinge",
        axis=axis,
        limited=True,
        range=[low, high],
        armature=robot.servo.rotor_inertia_kg_m2,
        # The servo is a motor at a share of its voltage, limited to 1, of which its back-EMF takes a part.
        damping=GEAR_DAMPING + float(robot.back_emf_nm_s_per_rad[index]),
        frictionloss=friction_nm,
        solimpfriction=STICTION,
    )
    torque = robot.joint_max_torque_nm[index]
    leg.actuator.add(
        "position",
        name=kind,
        joint=joint,
        kp=robot.stiffness_nm_per_rad[index],
        kv=robot.servo.damping_nm_s_per_rad,
        forcelimited=True,
        forcerange=[-torque, torque],
    )


def inject_failure(physics: Any, robot: Robot, failure: Failure | None) -> tuple[BoolArray, FloatArray]:
    """Change the compiled model so that the leg fails.

    The result is which joints hold a fixed angle regardless of their targets, and that angle; (18,) each.
    """
    jammed = np.zeros(N_JOINTS, dtype=bool)
    jammed_at = robot.stance_angles_rad.copy()
    if failure is None:
        return jammed, jammed_at
    joints = leg_slice(failure.leg)
    if failure.kind == "locked":
        jammed[joints] = True
    elif failure.kind == "stuck":
        _check_angle(robot, failure)
        _jam(physics, jammed, jammed_at, failure)
    elif failure.kind == "limp":
        _scale_torque(physics, robot, failure.leg, 0.0)
    elif failure.kind == "weak":
        _scale_torque(physics, robot, failure.leg, failure.torque_fraction)
    else:
        _remove_leg(physics, failure.leg)
    return jammed, jammed_at


def _check_angle(robot: Robot, failure: Failure) -> None:
    """Raise InputError for a joint stuck outside its range."""
    joint = JOINTS_PER_LEG * (failure.leg - 1) + JOINT_KINDS.index(failure.joint)
    if not robot.joint_lower_rad[joint] <= failure.angle_rad <= robot.joint_upper_rad[joint]:
        low, high = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
        raise InputError(
            f"stuck {failure.joint}: got {np.degrees(failure.angle_rad):g} deg; "
            f"allowed: {low:g} to {high:g} deg"
        )


def _jam(physics: Any, jammed: BoolArray, jammed_at: FloatArray, failure: Failure) -> None:
    """Hold one joint at an angle with far more than the servo's stiffness and torque."""
    joint = JOINTS_PER_LEG * (failure.leg - 1) + JOINT_KINDS.index(failure.joint)
    jammed[joint] = True
    jammed_at[joint] = failure.angle_rad
    model = physics.model
    for gains in (model.actuator_gainprm, model.actuator_biasprm):
        gains[joint] *= JAM_STIFFNESS
    model.actuator_forcerange[joint] *= JAM_STIFFNESS


def _scale_torque(physics: Any, robot: Robot, leg: int, fraction: float) -> None:
    """Scale all torques of the servos of a leg, their back-EMF too; the friction of its gears stays."""
    model, joints = physics.model, leg_slice(leg)
    for joint in range(N_JOINTS)[joints]:
        model.dof_damping[FIRST_SPEED + joint] -= (1 - fraction) * robot.back_emf_nm_s_per_rad[joint]
    for array in (model.actuator_gainprm, model.actuator_biasprm, model.actuator_forcerange):
        array[joints] *= fraction


def _remove_leg(physics: Any, leg: int) -> None:
    """Remove the contacts of a leg and almost all of its mass."""
    model = physics.model
    for geom in range(model.ngeom):
        if _belongs_to(model.id2name(geom, "geom"), leg):
            model.geom_conaffinity[geom] = 0
    for body in range(model.nbody):
        if _belongs_to(model.id2name(body, "body"), leg):
            model.body_mass[body] *= MISSING_MASS_SHARE
            model.body_inertia[body] *= MISSING_MASS_SHARE
    mujoco.mj_setConst(model.ptr, physics.data.ptr)


def _belongs_to(name: str, leg: int) -> bool:
    """Whether a compiled name, robot/leg/part, belongs to leg 1..6."""
    return name.split("/")[1:2] == [f"leg{leg}"]
