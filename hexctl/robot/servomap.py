"""The servo map: which channel drives which joint, and which pulse is which angle.

It is the `servos:` section of a robot file. It describes wiring and mounting, not the robot: calibrating
changes no `Robot`, and so no prior, session or link that belongs to it.
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from hexctl.errors import InputError
from hexctl.robot.configs import find_config, read_mapping, validate
from hexctl.robot.model import Robot
from hexctl.robot.schema import JointServoSection, RobotSchema, ServosSection
from hexctl.types import JOINT_KINDS, JOINT_NAMES, JOINTS_PER_LEG, N_JOINTS, BoolArray, FloatArray

IntArray = NDArray[np.int64]

#: What a servo has that the file says nothing about: 180 degrees of travel about the centre pulse.
DEFAULT_MIN_US, DEFAULT_MAX_US = 500, 2500


@dataclass(frozen=True, eq=False, kw_only=True)
class ServoMap:
    """Between joint angles and pulses: pulse = centre_us + us_per_deg * (sign * degrees + offset_deg).

    Arrays are by joint, leg-major, shape (18,), unless they say "by channel": element 0 is channel 1 there.

    Attributes:
        channels: the channel of each joint, 1..18, each once.
        signs: 1 or -1, which way a servo turns.
        offsets_deg: how far a servo's horn is mounted off.
        min_us: shortest pulse that a joint's servo may get.
        max_us: longest pulse that it may get.
        us_per_deg: scale of the servos in microseconds per degree.
        centre_us: pulse of a servo's middle.
        low_battery_v: voltage below which the robot is at fault, or None.
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
        if sorted(self.channels.tolist()) != list(range(1, N_JOINTS + 1)):
            raise InputError(f"servos: {_clash(self.channels)}; allowed: each of the channels 1..18 once")
        for value in vars(self).values():
            if isinstance(value, np.ndarray):
                value.flags.writeable = False

    def pulses_us(self, positions_rad: FloatArray) -> FloatArray:
        """Return the pulses that angles (18,) ask for, by joint, without limits."""
        degrees = self.signs * np.degrees(positions_rad) + self.offsets_deg
        return np.asarray(self.centre_us + self.us_per_deg * degrees)

    def outside(self, positions_rad: FloatArray) -> BoolArray:
        """Return which joints of angles (18,) ask for a pulse beyond their limits."""
        pulses = self.pulses_us(positions_rad)
        # A nanosecond is no pulse: it is what rounding makes of an angle right at the limit.
        return np.asarray((pulses < self.min_us - 1e-3) | (pulses > self.max_us + 1e-3))

    def limited_rad(self, positions_rad: FloatArray) -> FloatArray:
        """Return the angles (18,) nearest to the given ones that the pulse limits allow."""
        return self.angles_rad(np.clip(self.pulses_us(positions_rad), self.min_us, self.max_us))

    def to_us(self, positions_rad: FloatArray) -> FloatArray:
        """Return the pulses for angles (18,) in rad, limited last of all, by channel, (18,)."""
        return self.by_channel(np.clip(self.pulses_us(positions_rad), self.min_us, self.max_us))

    def to_rad(self, us: FloatArray) -> FloatArray:
        """Return the angles (18,) in rad that pulses by channel (18,) mean; pulses are not limited."""
        return self.angles_rad(us[self.channels - 1])

    def by_channel(self, values: FloatArray) -> FloatArray:
        """Return values by joint (18,) in the order of the channels."""
        ordered = np.empty(N_JOINTS)
        ordered[self.channels - 1] = values
        return ordered

    def angles_rad(self, pulses_us: FloatArray) -> FloatArray:
        """Return the angles that pulses mean, both by joint, (18,)."""
        degrees = (pulses_us - self.centre_us) / self.us_per_deg - self.offsets_deg
        return np.asarray(np.radians(self.signs * degrees))


def default_servo_map() -> ServoMap:
    """Return the map of a robot file without a `servos:` section: channel = joint number, no offsets."""
    return servo_map_of(ServosSection())


def load_servo_map(name_or_path: str | Path = "ant") -> ServoMap:
    """Return the servo map of a robot file, by shipped name or path.

    Raises InputError that says file, key, value and what is allowed.
    """
    path = find_config("robots", name_or_path)
    schema = validate(RobotSchema, read_mapping(path), path)
    try:
        return servo_map_of(schema.servos)
    except InputError as error:
        raise InputError(f"{path}: {error}") from error


def servo_map_of(section: ServosSection) -> ServoMap:
    """Return the map that a section describes: a joint's own keys, else its kind's, else the defaults."""
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
    """Return the joints whose range in the robot file is wider than their servo's pulses."""
    outside = servo_map.outside(robot.joint_lower_rad) | servo_map.outside(robot.joint_upper_rad)
    return tuple(name for name, beyond in zip(JOINT_NAMES, outside, strict=True) if beyond)


def _row(section: ServosSection, number: int, name: str) -> tuple[float, float, float, float, float]:
    """Return channel, sign, offset, shortest and longest pulse of one joint."""
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
    """Return which joints share a channel, or that one has a channel that there is not."""
    for channel in range(1, N_JOINTS + 1):
        sharing = [name for name, own in zip(JOINT_NAMES, channels, strict=True) if own == channel]
        if len(sharing) > 1:
            return f"got channel {channel} for {' and '.join(sharing)}"
    return f"got channels {channels.tolist()}"
