"""Compiles robot, world and failure into one dm_control Physics in its start state."""

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np

from hexctl.backends.sim.servo_physics import GearFriction
from hexctl.backends.sim.simulated_failure import FIRST_SPEED, FailedLegs, check_stuck_angle
from hexctl.backends.sim.terrain import ROUGH_HALF_SIZE_M, Floor, make_floor
from hexctl.backends.sim.world import World, per_joint, per_leg
from hexctl.errors import InputError
from hexctl.mujoco_import import import_undrawn, mujoco
from hexctl.robot.failure import Failures, each_failure
from hexctl.robot.formats.link_masses import link_capsule, link_mass
from hexctl.robot.model import STICTION, Robot
from hexctl.robot.rotations import about_z, product
from hexctl.robot.schema import Body, even_box_m
from hexctl.types import GRAVITY_M_S2, JOINT_KINDS, N_JOINTS, N_LEGS, ArrayFields, FloatArray

if "DISPLAY" not in os.environ:
    # Nothing here renders; without this, dm_control warns about the missing display at import.
    os.environ.setdefault("MUJOCO_GL", "disable")

mjcf = import_undrawn("dm_control.mjcf")

#: Where the joints begin in qpos: after the free joint's position and quaternion.
FIRST_JOINT = 7

#: Place of the touch sensors of the feet in sensordata, behind the forces of the actuators.
TOUCH = slice(N_JOINTS, N_JOINTS + N_LEGS)

#: Friction of a contact against spinning and rolling; contacts of three dimensions have none.
TURNING_FRICTION = (0.005, 0.0001)

#: A geom collides with the floor only; legs pass through one another.
ROBOT_CONTACT = {"contype": 0, "conaffinity": 1}
NO_CONTACT = {"contype": 0, "conaffinity": 0}


@dataclass(frozen=True, slots=True, eq=False)
class Simulation(ArrayFields):
    """A compiled simulation in its start state.

    Attributes:
        physics: dm_control Physics; qpos is base position, base quaternion, 18 joints.
        joint_offsets_rad: calibration error per joint: true angle - angle reported by the servo, (18,).
        play_rad: play between servo and joint, from stop to stop, (18,).
        gears: friction that grows with the load; None without.
    """

    physics: Any
    world: World
    floor: Floor
    joint_offsets_rad: FloatArray
    play_rad: FloatArray
    gears: GearFriction | None
    failed: FailedLegs


def make_simulation(
    robot: Robot, world: World, failure: Failures = None, seed: int = 0, facing_rad: float = 0.0
) -> Simulation:
    """Simulation of a robot that stands in a world, with initial yaw `facing_rad` and failed legs, if any."""
    floor = make_floor(world, seed)
    missing = tuple(one.leg for one in each_failure(failure) if one.kind == "missing")
    bumps_seed = 0 if world.even_floor else seed
    physics = mjcf.Physics.from_xml_string(_model_xml(robot, world, bumps_seed, missing))
    # The plain mj_step order, which mujoco.batch also takes: results are then equal to the last bit.
    physics.legacy_step = False
    _check_order(physics)
    _fill_heights(physics, floor)
    _change_joints(physics, world)
    gears = GearFriction.of(physics.model.ptr, slice(FIRST_SPEED, None), robot.servo)
    failed = FailedLegs(physics, robot)
    for one in each_failure(failure):
        if one.kind == "stuck":
            check_stuck_angle(robot, one)
        failed.change(one.leg, one, physics.data.ptr)
    _set_start_state(physics, robot, world, floor, facing_rad)
    offsets = _joint_offsets(world, seed)
    return Simulation(physics, world, floor, offsets, _play(robot, world), gears, failed)


def delay_steps(robot: Robot, world: World) -> int:
    """Steps of the physics from a command to its effect: the servo's dead time and the delay of the world."""
    return round((robot.servo.dead_time_s + world.servo_delay_s) / world.time_step_s)


def waiting_commands(model: Any, history: FloatArray) -> FloatArray:
    """View of the latest commands, leading shape + (18, n), n above `delay_steps`; 0 without a delay.

    Args:
        model: MuJoCo's model.
        history: its memory, leading shape + (nhistory,). An actuator's part has two numbers, then the times
            and then the values of its commands.
    """
    kept = int(model.actuator_history[0, 0])
    rows = history[..., : N_JOINTS * (2 + 2 * kept if kept else 0)]
    return rows.reshape(*history.shape[:-1], N_JOINTS, -1)[..., 2 + kept :]


def _delay_commands(body: Any, robot: Robot, world: World) -> None:
    """Delay all actuators, by half a step less, so that rounded times do not matter.

    The memory has room for whole control periods: simulations with similar delays can be stepped together.
    """
    steps = delay_steps(robot, world)
    kept = 1 + world.steps_per_tick * math.ceil(steps / world.steps_per_tick)
    for actuator in body.find_all("actuator") if steps else ():
        actuator.delay, actuator.nsample = (steps - 0.5) * world.time_step_s, kept


def _play(robot: Robot, world: World) -> FloatArray:
    """Play of each joint, (18,): the world's, or the robot file's where the world has none."""
    drawn = np.radians(per_joint(world.servo_backlash_deg))
    return np.where(drawn > 0, drawn, robot.play_rad)


@lru_cache(maxsize=16)
def _model_xml(robot: Robot, world: World, bumps_seed: int, missing_legs: tuple[int, ...]) -> str:
    """The model as MJCF text; writing it takes eight times as long as compiling it, and trials repeat it."""
    body = make_body(robot)
    _stretch_tibias(body, world)
    _load_trunk(body, robot, world)
    _load_payload(body, world)
    floor = make_floor(world, bumps_seed)
    root = _make_world(robot, world, floor)
    frame = root.attach(body)
    frame.add("freejoint")
    if world.on_stand:
        root.equality.add("weld", name="stand", body1=frame)
        frame.pos = _standing_place(robot, world, floor)
    _lay_grain(root, body, world, missing_legs)
    _measure_forces(root, body, world)
    _delay_commands(body, robot, world)
    return str(root.to_xml_string())


def _load_trunk(body: Any, robot: Robot, world: World) -> None:
    """Change and shift the mass of the trunk, not its shape."""
    if not world.added_mass_share and not any(world.body_mass_shift_m):
        return
    mass_kg = robot.body.mass_kg + world.added_mass_share * robot.mass_kg
    if mass_kg <= 0:
        least = -robot.body.mass_kg / robot.mass_kg
        raise InputError(
            f"added_mass_share: got {world.added_mass_share:g}; allowed for {robot.name}: above {least:.3g}"
        )
    # A second solid carries the mass.
    solid = body.find("geom", "mass") or body.find("geom", "trunk")
    at = np.zeros(3) if solid.pos is None else np.array(solid.pos)
    trunk, at = body.find("body", "trunk"), at + world.body_mass_shift_m
    _add_mass(trunk, "ballast", mass_kg, type=solid.type, size=solid.size, pos=at)
    solid.mass = 0


def _load_payload(body: Any, world: World) -> None:
    if world.payload_kg:
        trunk, at = body.find("body", "trunk"), world.payload_position_m
        _add_mass(trunk, "payload", world.payload_kg, type="box", size=[0.02, 0.02, 0.02], pos=at)


def _add_mass(body: Any, name: str, mass_kg: float, **solid: Any) -> None:
    body.add("geom", name=name, mass=mass_kg, **solid, **NO_CONTACT)


def _stretch_tibias(body: Any, world: World) -> None:
    for leg, error in enumerate(per_leg(world.tibia_error).tolist(), start=1):
        if error:
            tibia = body.find("geom", f"leg{leg}/tibia")
            tibia.fromto = [*tibia.fromto[:3], *((1 + error) * np.array(tibia.fromto[3:]))]
            for part in (body.find("geom", f"leg{leg}/foot"), body.find("site", f"leg{leg}/foot")):
                part.pos = (1 + error) * np.array(part.pos)


def _lay_grain(root: Any, body: Any, world: World, missing_legs: Sequence[int]) -> None:
    """Give the feet different friction along the world's y axis, the first tangential axis of contacts.

    It is the y axis projected onto the floor, of a sphere on a plane or height field. Only pairs allow two
    frictions.
    """
    if world.friction_ratio == 1:
        return
    along_y = world.friction * world.friction_ratio
    floors = [geom for name in ("bumps", "floor") if (geom := root.find("geom", name)) is not None]
    for leg in range(1, N_LEGS + 1):
        for floor in floors if leg not in missing_legs else ():
            root.contact.add(
                "pair",
                geom1=floor,
                geom2=body.find("geom", f"leg{leg}/foot"),
                condim=3,
                friction=[along_y, world.friction, *TURNING_FRICTION, TURNING_FRICTION[1]],
                solref=floor.solref,
            )


def _measure_forces(root: Any, body: Any, world: World) -> None:
    """Record forces at every step: they jump once per period, and one moment is far from the mean."""
    for actuator in body.find_all("actuator"):
        root.sensor.add("actuatorfrc", actuator=actuator, nsample=world.steps_per_tick)


def _make_world(robot: Robot, world: World, floor: Floor) -> Any:
    root = mjcf.RootElement(model="world")
    root.compiler.angle = "radian"
    root.option.timestep = world.time_step_s
    root.option.integrator = "implicitfast"
    root.option.cone = world.friction_cone
    root.option.tolerance = world.solver_tolerance
    # One robot on one floor: a sparse Jacobian and no search for islands save a fifth of the time.
    root.option.jacobian = "sparse"
    root.option.flag.island = "disable"
    contact: dict[str, Any] = {
        "contype": 1,
        "conaffinity": 0,
        "friction": [world.friction, *TURNING_FRICTION],
        "solref": [_contact_time_s(robot, world), 1],
        "priority": 1,  # the floor's friction and softness count, whatever the feet are made of
        "quat": floor.quaternion_world,
    }
    depth = 0.0
    if floor.heights_m is not None:
        low, high = floor.heights_m.min(), floor.heights_m.max()
        root.asset.add(
            "hfield",
            name="bumps",
            nrow=len(floor.heights_m),
            ncol=len(floor.heights_m),
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


def _contact_time_s(robot: Robot, world: World) -> float:
    """Time constant of contacts; on blocks short enough that no foot sinks by more than its radius.

    A foot that lands with the speed v sinks by v tau / e; v is that of a fall by half the standing height. A
    height field holds a deeper foot between the inner sides of its cells, which pull it down and throw it up.
    """
    if not (world.step_height_m or world.pit_depth_m):
        return world.contact_time_s
    fall_m_s = math.sqrt(GRAVITY_M_S2 * robot.standing_height_m)
    return min(world.contact_time_s, math.e * robot.foot_radius_m / fall_m_s)


def _check_order(physics: Any) -> None:
    """Raise unless joints and actuators are leg-major and the feet's sensors last."""
    expected = [f"leg{leg}/{kind}" for leg in range(1, N_LEGS + 1) for kind in JOINT_KINDS]
    model = physics.model
    joints = [model.id2name(index, "joint") for index in range(1, N_JOINTS + 1)]
    actuators = [model.id2name(index, "actuator") for index in range(N_JOINTS)]
    for names in (joints, actuators):
        if [name.split("/", 1)[1] for name in names] != expected:
            raise RuntimeError(f"the compiled model has an unexpected order: {names}")
    kinds = [mujoco.mjtSensor.mjSENS_ACTUATORFRC] * N_JOINTS + [mujoco.mjtSensor.mjSENS_TOUCH] * N_LEGS
    if model.sensor_type.tolist() != [int(kind) for kind in kinds]:
        raise RuntimeError(f"the compiled model has unexpected sensors: {model.sensor_type}")


def _fill_heights(physics: Any, floor: Floor) -> None:
    if floor.heights_m is not None:
        spread = floor.heights_m - floor.heights_m.min()
        physics.model.hfield_data[:] = (spread / spread.max()).ravel()


def _change_joints(physics: Any, world: World) -> None:
    model = physics.model
    model.actuator_forcerange[:] *= world.servo_strength
    stiffness = world.servo_stiffness * per_joint(world.joint_stiffness)
    model.actuator_gainprm[:, 0] *= stiffness
    model.actuator_biasprm[:, 1] *= stiffness
    model.actuator_biasprm[:, 2] *= world.servo_damping
    if world.rotor_inertia_kg_m2 is not None:
        model.dof_armature[FIRST_SPEED:] = world.rotor_inertia_kg_m2
        mujoco.mj_setConst(model.ptr, physics.data.ptr)  # the impedance of dry friction follows from it
    if world.joint_friction_nm is not None:
        model.dof_frictionloss[FIRST_SPEED:] = per_joint(world.joint_friction_nm)


def _set_start_state(physics: Any, robot: Robot, world: World, floor: Floor, facing_rad: float) -> None:
    """Put the robot in its stance on the floor or on the stand."""
    data = physics.data
    data.qpos[:3] = _standing_place(robot, world, floor)
    data.qpos[3:FIRST_JOINT] = product(floor.quaternion_world, about_z(facing_rad))
    data.qpos[FIRST_JOINT:] = robot.stance_angles_rad
    data.ctrl[:] = robot.stance_angles_rad
    waiting_commands(physics.model, data.history)[:] = robot.stance_angles_rad[:, np.newaxis]
    physics.forward()


def _standing_place(robot: Robot, world: World, floor: Floor) -> FloatArray:
    """Position of the body frame at the start; a little above the floor if legs are too long.

    On a stand no leg reaches the floor.
    """
    if world.on_stand:
        return np.array([0.0, 0.0, 1.2 * float(robot.link_lengths_m.sum())])
    radius = robot.stance_radius_m + 2 * robot.foot_radius_m
    longest = max(0.0, float(per_leg(world.tibia_error).max())) * float(robot.link_lengths_m[-1])
    height = robot.standing_height_m + longest + max(0.0, floor.highest_near_origin_m(radius))
    return height * floor.normal_world


def _joint_offsets(world: World, seed: int) -> FloatArray:
    given = world.joint_offset_deg
    if isinstance(given, tuple):
        return np.radians(given)
    # A separate stream, so that bumps and offsets do not depend on one another.
    return np.random.default_rng([seed, 1]).normal(scale=np.radians(given), size=N_JOINTS)


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
    """Set the trunk's mass, centre and inertia of the robot file, on its shape or a box without contact."""
    box_m = None if body.inertia_kg_m2 is None else even_box_m(body.mass_kg, body.inertia_kg_m2)
    if box_m is None and not any(body.com_m):
        return
    shape = trunk.geom["trunk"]
    solid = (
        {"type": shape.type, "size": shape.size}
        if box_m is None
        else {"type": "box", "size": [side / 2 for side in box_m]}
    )
    _add_mass(trunk, "mass", body.mass_kg, pos=body.com_m, **solid)
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
        (outward, up), capsule = robot.link_vectors_m[index], link_capsule(robot, index)
        start, (outward_m, up_m) = [outward, 0.0, up], capsule.end_m
        contact = NO_CONTACT if kind == "coxa" else ROBOT_CONTACT
        link.add(
            "geom",
            name=kind,
            type="capsule",
            fromto=[0, 0, 0, outward_m, 0, up_m],
            size=[capsule.radius_m],
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
    """Set the link's mass, centre and inertia of the robot file on a solid without contact."""
    if robot.link_inertias_kg_m2 is not None:
        part = link_mass(robot, index)
        box = {"type": "box", "size": [side / 2 for side in even_box_m(part.mass_kg, part.moments_kg_m2)]}
        turn = [math.cos(part.tilt_rad / 2), 0.0, math.sin(part.tilt_rad / 2), 0.0]
        _add_mass(link, f"{JOINT_KINDS[index]}_mass", part.mass_kg, pos=part.com_m, quat=turn, **box)
        link.geom[JOINT_KINDS[index]].mass = 0
        return
    if robot.link_coms_m is None:
        return
    shape = link.geom[JOINT_KINDS[index]]
    off = robot.link_coms_m[index] - robot.link_vectors_m[index] / 2
    start = [off[0], 0.0, off[1]]
    end = [off[0] + robot.link_vectors_m[index][0], 0.0, off[1] + robot.link_vectors_m[index][1]]
    solid = {"type": "capsule", "fromto": [*start, *end], "size": shape.size}
    _add_mass(link, f"{JOINT_KINDS[index]}_mass", shape.mass, **solid)
    shape.mass = 0


def _add_servo(leg: Any, link: Any, robot: Robot, index: int) -> None:
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
        damping=robot.servo.gear_damping_nm_s_per_rad + float(robot.back_emf_nm_s_per_rad[index]),
        frictionloss=friction_nm,
        solimpfriction=list(STICTION),
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
