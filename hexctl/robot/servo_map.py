"""The servo map: channel, direction, offset and pulse limits of each joint's servo.

It is the section `servos` of a robot file, and describes wiring and mounting. It is not part of the `Robot`,
so calibrating leaves priors, sessions and links valid. Angles are those of joints; in degrees, as in the
file, where a name says so.
"""

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import yaml
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.files import replacing
from hexctl.robot.configs import config_root, read_mapping, validate
from hexctl.robot.model import Robot
from hexctl.robot.schema import JointServoSection, RobotSchema, ServosSection
from hexctl.types import (
    JOINT_KINDS,
    JOINT_NAMES,
    JOINTS_PER_LEG,
    N_JOINTS,
    ArrayFields,
    BoolArray,
    FloatArray,
    check_finite,
)

IntArray = NDArray[np.int64]

#: Pulse limits of a servo without any in the file: 180 degrees of travel about the centre pulse.
DEFAULT_MIN_US, DEFAULT_MAX_US = 500, 2500


@dataclass(frozen=True, eq=False, kw_only=True)
class ServoMap(ArrayFields):
    """Conversion between joint angles and pulses.

        pulse_us = centre_us + us_per_deg * (sign * angle_deg + offset_deg)

    Arrays are by joint, leg-major, shape (18,), or by channel, with channel 1 first, where that is said.

    Attributes:
        channels: the channel of each joint, 1..18, each once.
        signs: direction of each servo, 1 or -1.
        offsets_deg: mounting error of each servo's horn.
        min_us: shortest pulse of each servo.
        max_us: longest pulse of each servo.
        us_per_deg: scale of the servos in microseconds per degree.
        centre_us: pulse at the middle of a servo's travel.
        low_battery_v: voltage below which the robot reports a fault, or None.
    """

    channels: IntArray
    signs: FloatArray
    offsets_deg: FloatArray
    min_us: FloatArray
    max_us: FloatArray
    us_per_deg: float = 1000 / 90
    centre_us: float = 1500.0
    low_battery_v: float | None = None

    def __post_init__(self) -> None:
        for name in ("channels", "signs", "offsets_deg", "min_us", "max_us"):
            check_finite(getattr(self, name), (N_JOINTS,), f"servos.{name}")
        if sorted(self.channels.tolist()) != list(range(1, N_JOINTS + 1)):
            raise InputError(f"servos: {_clash(self.channels)}; allowed: each of the channels 1..18 once")
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def pulses_us(self, positions_rad: FloatArray) -> FloatArray:
        """Pulses of angles (18,) in rad, by joint, without limits."""
        degrees = self.signs * np.degrees(positions_rad) + self.offsets_deg
        return np.asarray(self.centre_us + self.us_per_deg * degrees)

    def outside(self, positions_rad: FloatArray) -> BoolArray:
        """Joints whose angles (18,) in rad need a pulse beyond the limits, (18,)."""
        pulses = self.pulses_us(positions_rad)
        # A nanosecond of tolerance: an angle right at the limit may be rounded past it.
        return np.asarray((pulses < self.min_us - 1e-3) | (pulses > self.max_us + 1e-3))

    def limited_rad(self, positions_rad: FloatArray) -> FloatArray:
        """Angles (18,) in rad, clipped to the pulse limits."""
        return self.angles_rad(np.clip(self.pulses_us(positions_rad), self.min_us, self.max_us))

    def to_us(self, positions_rad: FloatArray) -> FloatArray:
        """Pulses of angles (18,) in rad, by channel, (18,), clipped to the limits."""
        return self.by_channel(np.clip(self.pulses_us(positions_rad), self.min_us, self.max_us))

    def to_rad(self, us: FloatArray) -> FloatArray:
        """Angles (18,) in rad of pulses by channel (18,), which are not clipped."""
        return self.angles_rad(us[self.channels - 1])

    def by_channel(self, values: FloatArray) -> FloatArray:
        """Values by joint (18,) in the order of the channels."""
        ordered = np.empty(N_JOINTS)
        ordered[self.channels - 1] = values
        return ordered

    def angles_rad(self, pulses_us: FloatArray) -> FloatArray:
        """Angles (18,) in rad of pulses by joint (18,)."""
        degrees = (pulses_us - self.centre_us) / self.us_per_deg - self.offsets_deg
        return np.asarray(np.radians(self.signs * degrees))


def default_servo_map() -> ServoMap:
    """Servo map of a robot file without a section `servos`: channels in the order of joints, no offsets."""
    return servo_map_of(ServosSection())


def servo_map_of(section: ServosSection) -> ServoMap:
    """Servo map of a section: keys of a joint come first, then those of its kind, then the defaults."""
    rows = [_row(section, number, name) for number, name in enumerate(JOINT_NAMES, start=1)]
    channels, signs, offsets, lowest, highest = (np.array(column) for column in zip(*rows, strict=True))
    return ServoMap(
        channels=channels.astype(np.int64),
        signs=signs,
        offsets_deg=offsets,
        min_us=lowest,
        max_us=highest,
        us_per_deg=section.us_per_deg,
        centre_us=section.centre_us,
        low_battery_v=section.low_battery_v,
    )


def joints_beyond_pulses(servo_map: ServoMap, robot: Robot) -> tuple[str, ...]:
    """Names of the joints whose range in the robot file is wider than the travel of their servo."""
    outside = servo_map.outside(robot.joint_lower_rad) | servo_map.outside(robot.joint_upper_rad)
    return tuple(name for name, beyond in zip(JOINT_NAMES, outside, strict=True) if beyond)


def _row(section: ServosSection, number: int, name: str) -> tuple[float, float, float, float, float]:
    """Channel, sign, offset, shortest and longest pulse of one joint."""
    joint: JointServoSection = getattr(section, name)
    kind = getattr(section, JOINT_KINDS[(number - 1) % JOINTS_PER_LEG])

    def value(key: str, default: float) -> float:
        own, common = getattr(joint, key), getattr(kind, key)
        return float(own if own is not None else common if common is not None else default)

    channel = float(number if joint.channel is None else joint.channel)
    lowest, highest = value("min_us", DEFAULT_MIN_US), value("max_us", DEFAULT_MAX_US)
    if lowest >= highest:
        raise InputError(
            f"servos.{name}: got min_us {lowest:g} and max_us {highest:g}; allowed: min_us below max_us"
        )
    return channel, value("sign", 1.0), value("offset_deg", 0.0), lowest, highest


def _clash(channels: IntArray) -> str:
    """Text that names joints with the same channel, or else the channels."""
    for channel in range(1, N_JOINTS + 1):
        sharing = [name for name, own in zip(JOINT_NAMES, channels, strict=True) if own == channel]
        if len(sharing) > 1:
            return f"got channel {channel} for {' and '.join(sharing)}"
    return f"got channels {channels.tolist()}"


#: Least distance of a reference angle from both ends of a joint's range: it can be trimmed both ways.
ROOM_DEG = 20.0

#: Least distance between the two pulse limits of a servo.
LEAST_TRAVEL_US = 50.0


def flipped(servo_map: ServoMap, joint: int, at_deg: float) -> ServoMap:
    """Servo map with the opposite sign for a joint, and the same pulse at one angle.

    That is the angle at which the joint is believed to be, so the joint does not move.
    """
    sign = servo_map.signs[joint]
    offset = servo_map.offsets_deg[joint] + 2 * sign * at_deg
    return replace(
        servo_map,
        signs=_with(servo_map.signs, joint, -sign),
        offsets_deg=_with(servo_map.offsets_deg, joint, offset),
    )


def referenced(servo_map: ServoMap, joint: int, believed_deg: float, true_deg: float) -> ServoMap:
    """Servo map in which the pulse of a joint's believed angle means its true angle."""
    shift = servo_map.signs[joint] * (believed_deg - true_deg)
    offset = round(float(servo_map.offsets_deg[joint] + shift), 3)
    return replace(servo_map, offsets_deg=_with(servo_map.offsets_deg, joint, offset))


def limited(servo_map: ServoMap, joint: int, pulses_us: tuple[float, float]) -> ServoMap:
    """Servo map with other pulse limits for a joint, given in any order, in whole microseconds.

    Raises InputError for limits less than 50 us apart.
    """
    least, most = (float(round(pulse)) for pulse in sorted(pulses_us))
    if most - least < LEAST_TRAVEL_US:
        raise InputError(
            f"limits: got {least:g} and {most:g} us; allowed: {LEAST_TRAVEL_US:g} us apart or more"
        )
    return replace(
        servo_map,
        min_us=_with(servo_map.min_us, joint, least),
        max_us=_with(servo_map.max_us, joint, most),
    )


def taken_over(servo_map: ServoMap, joint: int, source: ServoMap) -> ServoMap:
    """Servo map with the sign, offset and limits that one joint has in another map."""
    return replace(
        servo_map,
        signs=_with(servo_map.signs, joint, source.signs[joint]),
        offsets_deg=_with(servo_map.offsets_deg, joint, source.offsets_deg[joint]),
        min_us=_with(servo_map.min_us, joint, source.min_us[joint]),
        max_us=_with(servo_map.max_us, joint, source.max_us[joint]),
    )


def reference_deg(lower_deg: float, upper_deg: float) -> float:
    """Angle that is easily judged by eye: 0, a right angle, or the middle of the joint's range."""
    for angle in (0.0, -90.0, 90.0):
        if lower_deg + ROOM_DEG <= angle <= upper_deg - ROOM_DEG:
            return angle
    return round((lower_deg + upper_deg) / 2)


def _with(values: FloatArray, joint: int, value: float) -> FloatArray:
    changed = np.array(values, dtype=float)
    changed[joint] = value
    return changed


SECTION = "servos"


def check_writable(path: Path) -> None:
    """Raise InputError for a shipped robot file, with the command that copies it, and for a read-only one."""
    if path.resolve().is_relative_to(config_root().resolve()):
        copy = f"my-{path.name}"
        raise InputError(
            f"calibrate: got the shipped robot {path.stem}; allowed: a file of your own: "
            f"cp {path} {copy}, then hexctl calibrate {copy}"
        )
    if not os.access(path, os.W_OK) or not os.access(path.resolve().parent, os.W_OK):
        raise InputError(f"{path}: cannot be written; allowed: a file, in a folder, that is yours to change")


def back_up(path: Path) -> Path:
    """Path of a copy of a file, made beside it: `.bak`, or `.bak.2` and so on where earlier ones exist."""
    number, backup = 2, path.with_name(f"{path.name}.bak")
    while backup.exists():
        backup, number = path.with_name(f"{path.name}.bak.{number}"), number + 1
    shutil.copy2(path, backup)
    return backup


def write_servo_map(path: Path, servo_map: ServoMap) -> None:
    """Replace the section `servos` of a robot file, or append one; the rest of the file is not changed.

    The file is replaced atomically. Comments inside the section are lost. Raises InputError for a file that
    is not a valid robot file.
    """
    place = path.resolve()
    text = place.read_text(encoding="utf-8")
    with replacing(place) as draft:
        draft.write_text(replaced(text, section_lines(servo_map)), encoding="utf-8")
        validate(RobotSchema, read_mapping(draft), path)


def section_lines(servo_map: ServoMap) -> list[str]:
    """Lines of the section that describes a servo map, with every joint."""
    lines = [f"{SECTION}: # written by hexctl calibrate"]
    lines.append(f"  us_per_deg: {servo_map.us_per_deg!r}")
    lines.append(f"  centre_us: {servo_map.centre_us:g}")
    if servo_map.low_battery_v is not None:
        lines.append(f"  low_battery_v: {servo_map.low_battery_v!r}")
    for joint, name in enumerate(JOINT_NAMES):
        lines.append(
            f"  {name}: {{channel: {servo_map.channels[joint]}, sign: {servo_map.signs[joint]:g}, "
            f"offset_deg: {float(servo_map.offsets_deg[joint])!r}, "
            f"min_us: {servo_map.min_us[joint]:g}, max_us: {servo_map.max_us[joint]:g}}}"
        )
    return lines


def replaced(text: str, section: list[str]) -> str:
    """Text of a robot file with another section `servos`."""
    lines = text.splitlines()
    begin, end = _section_at(text, len(lines))
    return "\n".join([*lines[:begin], *section, *lines[end:]]) + "\n"


def _section_at(text: str, end_of_file: int) -> tuple[int, int]:
    """First line of the section and the line after it; the end of the file twice where there is none."""
    root = yaml.compose(text, Loader=yaml.SafeLoader)
    pairs = root.value if isinstance(root, yaml.MappingNode) else []
    for key, value in pairs:
        if key.value == SECTION:
            lines = text.splitlines()
            end: int = value.end_mark.line + (1 if value.end_mark.column else 0)
            # Comments and blank lines before the next key belong to that key.
            while end > key.start_mark.line + 1 and _is_aside(lines[end - 1]):
                end -= 1
            return key.start_mark.line, end
    return end_of_file, end_of_file


def _is_aside(line: str) -> bool:
    return not line.strip() or line.lstrip().startswith("#")
