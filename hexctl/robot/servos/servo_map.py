"""The servo map: channel of each joint's servo on a board with MAVLink firmware, and its pulses.

It is not part of the `Robot`: calibrating leaves priors, sessions and links valid.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from hexctl.robot.servos.raw_map import IntPerJoint, RawMap, calibration_of, check_once, joint_value
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray

#: Default pulse limits: 180 degrees of travel about the centre pulse.
DEFAULT_MIN_US, DEFAULT_MAX_US = 500, 2500


@dataclass(frozen=True, eq=False, kw_only=True)
class ServoMap(RawMap):
    """Conversion between joint angles and pulses in us of channels 1..18, each once.

    Attributes:
        low_battery_v: voltage below which the robot sits down, or None.
    """

    unit: ClassVar[str] = "us"
    channels: IntPerJoint
    low_battery_v: float | None = None

    def __post_init__(self) -> None:
        super().__post_init__()
        check_once("channel", JOINT_NAMES, self.channels)

    def servo_name(self, joint: int) -> str:
        """The servo of a joint, 0..17, by its channel."""
        return f"channel {self.channels[joint]}"

    def to_us(self, joint_positions_rad: FloatArray) -> FloatArray:
        """Pulses of angles (18,) in rad, by channel, (18,), clipped to the limits."""
        return self.by_channel(self.limited_raw(joint_positions_rad))

    def to_rad(self, us: FloatArray) -> FloatArray:
        """Angles (18,) in rad of pulses by channel (18,), which are not clipped."""
        return self.angles_rad(us[self.channels - 1])

    def by_channel(self, values: FloatArray) -> FloatArray:
        """Values by joint (18,) in the order of the channels."""
        ordered = np.empty(N_JOINTS)
        ordered[self.channels - 1] = values
        return ordered


def default_servo_map() -> ServoMap:
    """Default servo map: channels in the order of joints, no offsets."""
    return servo_map_of(ServosSection())


def servo_map_of(section: ServosSection) -> ServoMap:
    """Servo map of a section; raises InputError for channels or limits that no board can have."""
    channels = [joint_value(section, joint, "channel", joint + 1) for joint in range(N_JOINTS)]
    return ServoMap(
        channels=np.array(channels, dtype=np.int64),
        low_battery_v=section.low_battery_v,
        **pulses_of(section),
    )


def pulses_of(section: ServosSection) -> dict[str, FloatArray]:
    """Pulses of hobby servos, by field of `RawMap`; raises InputError for limits that leave no travel."""
    least, most = [float(DEFAULT_MIN_US)] * N_JOINTS, [float(DEFAULT_MAX_US)] * N_JOINTS
    return calibration_of(section, "us", least, most) | {
        "per_deg": np.full(N_JOINTS, float(section.us_per_deg)),
        "centre": np.full(N_JOINTS, float(section.centre_us)),
    }
