"""Doubts about the units of a robot file: values that no robot has, with their likely units."""

import math
from collections.abc import Iterator, Sequence

from hexctl.robot.plausibility import LEAST_RANGE_DEG
from hexctl.robot.schema import RobotSchema
from hexctl.robot.units import QUANTITIES, RADIANS, SPEEDS_DEG_S, TORQUES, Quantity, doubt
from hexctl.types import JOINT_KINDS, N_LEGS

#: Masses of robots whose servos carry them.
ROBOT_KG = (0.1, 20.0)

#: Servos in links of less than LIGHT_KG have at most this torque and speed, which is 20 rad/s.
LIGHT_KG = 0.1
LIGHT_SERVO = {
    "joints.max_torque_nm": 6.0,
    "joints.max_speed_deg_s": math.degrees(20.0),
    "joints.no_load_speed_deg_s": math.degrees(20.0),
}

#: Shipped and published robots with known masses carry 3 to 20 times their weight. With torques in kg cm,
#: shipped ones carry 33 times or more. A bound of 10 would doubt `ant` and published robots of 12 and 14.
MOST_CARRIED, USUALLY_CARRIED = 25.0, 6.0

#: Angles between ends of ranges and of mounts.
ANGLES = Quantity("deg", LEAST_RANGE_DEG, 360.0, 60.0, RADIANS)


def unit_doubts(content: RobotSchema) -> list[str]:
    """Values of a robot file that no robot has, one line for each key, with the likely units."""
    return [*_quantity_doubts(content), *_servo_doubts(content), *_angle_doubts(content)]


def mass_doubt(content: RobotSchema, capacity: float) -> str:
    """Doubt about the mass of a robot whose servos carry a multiple of it, or an empty text."""
    mass_kg = content.body.mass_kg + N_LEGS * sum(link.mass_kg for link in content.links.each)
    if mass_kg >= ROBOT_KG[0] and (mass_kg <= ROBOT_KG[1] or capacity >= 1):
        return ""
    usual = f"{ROBOT_KG[0]:g} to {ROBOT_KG[1]:g} kg"
    return doubt("body and links", [mass_kg], usual, QUANTITIES["body.mass_kg"])


def carried_doubt(content: RobotSchema, capacity: float) -> str:
    """Doubt about torques that carry a multiple of the weight, or an empty text.

    A robot with unknown masses is not doubted.
    """
    if capacity <= MOST_CARRIED or any("mass_kg" in key for key in content.unknown):
        return ""
    torques_nm = [joint.max_torque_nm for joint in content.joints.each]
    usual_nm = min(torques_nm) * USUALLY_CARRIED / capacity
    quantity = Quantity("N m", 0.0, 0.0, usual_nm, TORQUES)
    usual = f"{USUALLY_CARRIED:g} x the weight, and these carry {capacity:.3g} x"
    return doubt("joints.max_torque_nm", torques_nm, usual, quantity)


def slowness_doubt(content: RobotSchema) -> str:
    """Doubt about joints that are slower than servos are, or an empty text."""
    name = "joints.max_speed_deg_s"
    slow = [(key, value) for key, value in _values(content, name) if value < SPEEDS_DEG_S[0]]
    return _doubt_about(slow, name, f"{SPEEDS_DEG_S[0]:g} deg/s or more") if slow else ""


def _quantity_doubts(content: RobotSchema) -> Iterator[str]:
    for name, quantity in QUANTITIES.items():
        found = [(key, value) for key, value in _values(content, name) if quantity.outside(value)]
        if found:
            yield _doubt_about(found, name, f"{quantity.least:g} to {quantity.most:.4g} {quantity.unit}")


def _servo_doubts(content: RobotSchema) -> Iterator[str]:
    """Torques and speeds above those of servos as light as the links that hold them."""
    link_kg = sum(link.mass_kg for link in content.links.each) / len(JOINT_KINDS)
    for name, most in LIGHT_SERVO.items() if link_kg < LIGHT_KG else ():
        quantity = QUANTITIES[name]
        high = [(key, value) for key, value in _values(content, name) if most < value <= quantity.most]
        if high:
            usual = f"up to {most:.4g} {quantity.unit} in links of {1000 * link_kg:.0f} g"
            yield _doubt_about(high, name, usual)


def _angle_doubts(content: RobotSchema) -> Iterator[str]:
    """Ranges of a few degrees, and legs that all point forward."""
    ranges = {
        f"joints.{kind}": (joint.min_deg, joint.max_deg)
        for kind, joint in zip(JOINT_KINDS, content.joints.each, strict=True)
        if joint.max_deg - joint.min_deg < LEAST_RANGE_DEG
    }
    if ranges:
        key = next(iter(ranges)) if len(ranges) == 1 else "joints"
        yield doubt(key, [end for ends in ranges.values() for end in ends], "tens of degrees", ANGLES)
    yaws_deg = [math.degrees(mount.yaw_rad) for mount in content.mounts]
    if 0 < max(map(abs, yaws_deg)) <= LEAST_RANGE_DEG:
        yield doubt("mounts", yaws_deg, "legs that point all round", ANGLES)


def _doubt_about(found: Sequence[tuple[str, float]], name: str, usual: str) -> str:
    """Doubt about keys and values of a quantity; several keys are named by their quantity."""
    keys = {key for key, _ in found}
    key = keys.pop() if len(keys) == 1 else name
    return doubt(key, [value for _, value in found], usual, QUANTITIES[name])


def _values(content: RobotSchema, name: str) -> Iterator[tuple[str, float]]:
    """Keys and values of a quantity that a file has: of each kind, leg, and direction."""
    section, _, key = name.rpartition(".")
    place = getattr(content, section) if section else content
    if section in ("links", "joints"):
        parts = [(f"{section}.{kind}.{key}", getattr(place, kind)) for kind in JOINT_KINDS]
    elif section == "mounts":
        parts = [(f"mounts[{leg}].{key}", mount) for leg, mount in enumerate(place)]
    else:
        parts = [(name, place)]
    for path, part in parts:
        value = getattr(part, key)
        for number in value if isinstance(value, tuple) else (value,):
            if number is not None:
                yield path, float(number)
