"""A servo that has lost its id, as AX servos do in a brown-out, and answers to the factory's instead."""

import time
from dataclasses import dataclass

import numpy as np

from hexctl.backends.bus.scan import find_servo, give_id, opened_line
from hexctl.backends.bus.servo_bus import ServoBus
from hexctl.backends.bus.single_servo import FoundServo
from hexctl.errors import RobotFaultError
from hexctl.robot.model import Robot
from hexctl.robot.servos.bus_map import BusMap
from hexctl.types import N_JOINTS, BoolArray

#: Id that servos have from the factory.
FACTORY_ID = 1

#: How far a joint may seem to stand beyond its limits, in degrees.
TOLERANCE_DEG = 5.0

#: How long a servo takes to start again.
REBOOTS_S = 1.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Adoption:
    """A servo that was given back the id of its joint.

    Attributes:
        joint: index of the joint, 0..17.
        angle_deg: where the joint stands, or None where the servo did not say.
        servo: as it answers now.
    """

    joint: int
    angle_deg: float | None
    servo: FoundServo


def adoptable(servos: BusMap, found: BoolArray) -> int | None:
    """Joint whose servo may have lost its id: the only one missing, where no joint has the factory's id."""
    missing = np.flatnonzero(~found).tolist()
    alone = len(missing) == 1 and FACTORY_ID not in servos.ids.tolist()
    return int(missing[0]) if alone else None


def lost_id_notes(bus: ServoBus, servos: BusMap, found: BoolArray) -> tuple[str, ...]:
    """What is said at connect where a joint's servo is missing and one answers to the factory's id."""
    joint = adoptable(servos, found)
    if joint is None or not bus.answers(FACTORY_ID, servos.models[joint]):
        return ()
    name = servos.names(np.arange(N_JOINTS) == joint)
    return (
        f"{name} does not answer, and a servo with id {FACTORY_ID} does: it may have lost its id; "
        "`hexctl servos adopt --robot FILE`, with your robot file, gives it back",
    )


def adopt(robot: Robot, servos: BusMap, port: str, baud: int) -> Adoption:
    """Give the servo with the factory's id the id of the only joint whose servo is missing.

    It is limp then, and restarted where it can be. Raises RobotFaultError where not exactly one is missing,
    or what answers to the factory's id is another model, or stands where the joint cannot.
    """
    if FACTORY_ID in servos.ids.tolist():
        joint = servos.names(servos.ids == FACTORY_ID)
        raise RobotFaultError(f"id {FACTORY_ID} belongs to a joint of the robot file ({joint}): none is lost")
    with opened_line(port, baud) as line:
        found = np.array([find_servo(line, servos.driver, each) is not None for each in servos.ids.tolist()])
        joint_index = adoptable(servos, found)
        if joint_index is None:
            names = servos.names(~found) or "none"
            raise RobotFaultError(f"joints without a servo: {names}; exactly one must be missing")
        servo = find_servo(line, servos.driver, FACTORY_ID)
        name = servos.names(np.arange(N_JOINTS) == joint_index)
        if servo is None:
            raise RobotFaultError(
                f"{name} does not answer, and no servo with id {FACTORY_ID} does; is its cable in?"
            )
        seen, wanted = servo.look(), servos.models[joint_index]
        if wanted.number is not None and seen.model_number != wanted.number:
            raise RobotFaultError(
                f"the servo with id {FACTORY_ID} reports model number {seen.model_number}, not "
                f"{wanted.number} ({wanted.name}) of {name}"
            )
        angle_deg = _angle_deg(robot, servos, joint_index, seen)
        if not servo.set_torque(on=False):
            raise RobotFaultError(f"the servo with id {FACTORY_ID} does not let go")
        adopted = give_id(servo, int(servos.ids[joint_index]))
        servo.reboot()
        if servos.driver == "dynamixel" and servos.protocol == 2:
            time.sleep(REBOOTS_S)
            adopted = servo.look()
        return Adoption(joint=joint_index, angle_deg=angle_deg, servo=adopted)


def _angle_deg(robot: Robot, servos: BusMap, joint: int, seen: FoundServo) -> float | None:
    """Where a joint stands by a servo's position; raises RobotFaultError where it cannot stand there."""
    if seen.position is None:
        return None
    angle_deg = float(np.degrees(servos.angles_rad(np.full(N_JOINTS, float(seen.position)))[joint]))
    ends = np.degrees([robot.joint_lower_rad[joint], robot.joint_upper_rad[joint]])
    if not ends[0] - TOLERANCE_DEG <= angle_deg <= ends[1] + TOLERANCE_DEG:
        name = servos.names(np.arange(N_JOINTS) == joint)
        raise RobotFaultError(
            f"the servo with id {FACTORY_ID} stands at {angle_deg:.0f} degrees, where {name} cannot "
            f"({ends[0]:.0f} to {ends[1]:.0f}): it may be another one; `hexctl servos identify` tells"
        )
    return round(angle_deg, 1)
