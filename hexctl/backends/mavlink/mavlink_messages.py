"""MAVLink messages between a controller and a servo board, as values.

Messages with non-finite or impossible numbers are refused.

MAVLink has a north-east-down world and a forward-right-down body; hexctl has z up and y left (REP 103). Both
differ by half a turn about x: y and z of vectors and quaternions change sign in both directions.
"""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common

from hexctl.errors import MessageError
from hexctl.robot.rotations import quaternion_of_euler, roll_pitch_rad, yaw_rad
from hexctl.types import N_JOINTS, N_LEGS, ArrayFields, BoolArray, FloatArray

#: Identifiers of the controller: a ground system, as overrides come from one, and an onboard computer.
CONTROLLER_SYSTEM = 255
CONTROLLER_COMPONENT = common.MAV_COMP_ID_ONBOARD_COMPUTER

#: Identifiers of a servo board.
BOARD_SYSTEM = 1
BOARD_COMPONENT = common.MAV_COMP_ID_AUTOPILOT1

#: Types that a servo board may have; 13 is a drone with six rotors.
BOARD_TYPES = (common.MAV_TYPE_GENERIC, common.MAV_TYPE_ONBOARD_CONTROLLER)

#: States of a system in its heartbeat.
STANDBY, ACTIVE, CRITICAL, EMERGENCY, POWEROFF = (
    common.MAV_STATE_STANDBY,
    common.MAV_STATE_ACTIVE,
    common.MAV_STATE_CRITICAL,
    common.MAV_STATE_EMERGENCY,
    common.MAV_STATE_POWEROFF,
)

#: Override values: ignore the channel, or release it (1..8, and 9..18, for which 0 is "not commanded").
IGNORE_US, RELEASE_LOW_US, RELEASE_HIGH_US = 65535, 0, 65534
FIRST_HIGH = 8

#: Times in milliseconds are counted modulo this plus one.
U32 = 0xFFFFFFFF

#: Pulses that a channel in use may report.
LEAST_US, MOST_US = 100.0, 5000.0

#: How far from 1 the length of an orientation may be.
QUATERNION_SLACK = 0.1

#: Name of the NAMED_VALUE_INT for the source of joint positions: measured (1) or an echo (0).
MEASURED_NAME = "measured"

#: Name of the NAMED_VALUE_INT for switches at the feet: one bit per leg, the lowest for leg 1; 1 is contact.
CONTACTS_NAME = "contacts"

#: Frames in which ODOMETRY is understood: x forward or north, y right or east, z down.
ODOMETRY_FRAMES = (common.MAV_FRAME_LOCAL_NED, common.MAV_FRAME_LOCAL_FRD)

#: Half a turn about x, for (x, y, z).
FLIP_VECTOR = np.array([1.0, -1.0, -1.0])

#: The same for (w, x, y, z).
FLIP_QUATERNION = np.array([1.0, 1.0, -1.0, -1.0])


@dataclass(frozen=True, slots=True, eq=False)
class Outputs(ArrayFields):
    """Channels reported by a board, (18,): pulses, and whether they are driven.

    `board_ms` is the time of the board modulo 2^32; 0 is unknown.
    """

    pulses_us: FloatArray
    active: BoolArray
    board_ms: int = 0


@dataclass(frozen=True, slots=True)
class Battery:
    """Battery reported by a board: voltage and share left, 0 to 1; None if unknown."""

    voltage_v: float | None
    share: float | None


@dataclass(frozen=True, slots=True, eq=False)
class Pose(ArrayFields):
    """Position (3,) in m and orientation (w, x, y, z) of the body, x forward, y left, z up."""

    position_world: FloatArray
    quaternion_world: FloatArray


def milliseconds(time_s: float) -> int:
    """A time as MAVLink counts it: in whole milliseconds, modulo 2^32."""
    return int(time_s * 1000) & U32


def age_s(echoed_ms: int, now_s: float) -> float:
    """Age of an echoed `milliseconds` time; infinite for 0, which is no time."""
    return ((milliseconds(now_s) - echoed_ms) & U32) / 1e3 if echoed_ms else math.inf


def heartbeat(kind: int, autopilot: int, state: int, custom_mode: int = 0) -> Any:
    """A HEARTBEAT."""
    return common.MAVLink_heartbeat_message(kind, autopilot, 0, custom_mode, state, 3)


def controller_heartbeat(state: int = ACTIVE, *, board_ms: int = 0) -> Any:
    """The HEARTBEAT of a controller, which echoes the time of the newest outputs of the board."""
    kind = common.MAV_TYPE_ONBOARD_CONTROLLER
    return heartbeat(kind, common.MAV_AUTOPILOT_INVALID, state, board_ms)


def override(pulses_us: FloatArray, system: int, component: int) -> Any:
    """The message that moves all servos; pulses by channel (18,) become whole microseconds."""
    channels = [round(pulse) for pulse in pulses_us.tolist()]
    return common.MAVLink_rc_channels_override_message(system, component, *channels)


def release(system: int, component: int) -> Any:
    """The message that releases all servos."""
    channels = [RELEASE_LOW_US] * FIRST_HIGH + [RELEASE_HIGH_US] * (N_JOINTS - FIRST_HIGH)
    return common.MAVLink_rc_channels_override_message(system, component, *channels)


def channels_of(message: Any) -> list[int]:
    """The 18 raw values of an RC_CHANNELS_OVERRIDE."""
    return [getattr(message, f"chan{channel}_raw") for channel in range(1, N_JOINTS + 1)]


def stamp_s(message: Any) -> float | None:
    """Stamp of a message in s, on any clock of its sender; None without one."""
    microseconds = getattr(message, "time_usec", 0) or 1000 * getattr(message, "time_boot_ms", 0)
    return microseconds / 1e6 if microseconds else None


def outputs_of(message: Any) -> Outputs:
    """The channels of an ACTUATOR_OUTPUT_STATUS; raises MessageError for an impossible active pulse."""
    pulses = np.array(message.actuator[:N_JOINTS], dtype=float)
    active = np.array([message.active >> channel & 1 for channel in range(N_JOINTS)], dtype=bool)
    plausible = (pulses >= LEAST_US) & (pulses <= MOST_US)  # false for nan too
    if not (plausible | ~active).all():
        raise MessageError(f"ACTUATOR_OUTPUT_STATUS: got {pulses.tolist()}; allowed: pulses in microseconds")
    return Outputs(np.where(plausible, pulses, np.nan), active, (message.time_usec // 1000) & U32)


def orientation_of(message: Any) -> FloatArray:
    """Orientation, REP 103, (w, x, y, z), of an ATTITUDE or ATTITUDE_QUATERNION; MessageError if invalid."""
    if message.get_type() == "ATTITUDE":
        return flipped_quaternion(
            quaternion_of_euler(
                *(_finite(angle, "ATTITUDE") for angle in (message.roll, message.pitch, message.yaw))
            )
        )
    return _unit([message.q1, message.q2, message.q3, message.q4], "ATTITUDE_QUATERNION")


def position_of(message: Any) -> FloatArray:
    """Position, z up, (3,) in m, of a LOCAL_POSITION_NED; raises MessageError if not finite."""
    return flipped_vector(
        np.array([_finite(value, "LOCAL_POSITION_NED") for value in (message.x, message.y, message.z)])
    )


def pose_of(message: Any) -> Pose:
    """The pose of an ODOMETRY; MessageError unless it is finite, in a frame x forward, z down."""
    if message.frame_id not in ODOMETRY_FRAMES:
        raise MessageError(f"ODOMETRY: got frame {message.frame_id}; allowed: {ODOMETRY_FRAMES}")
    position = np.array([_finite(value, "ODOMETRY") for value in (message.x, message.y, message.z)])
    return Pose(flipped_vector(position), _unit(list(message.q), "ODOMETRY"))


def battery_of(message: Any) -> Battery:
    """The battery of a BATTERY_STATUS or SYS_STATUS."""
    share = message.battery_remaining / 100 if 0 <= message.battery_remaining <= 100 else None
    if message.get_type() == "SYS_STATUS":
        known = [message.voltage_battery] if message.voltage_battery != 65535 else []
    else:
        known = [cell for cell in message.voltages if cell != 65535]
        known += [cell for cell in message.voltages_ext if cell not in (0, 65535)]
    return Battery(sum(known) / 1000 if known else None, share)


def contacts_of(message: Any) -> BoolArray:
    """Which feet touch the ground, (6,); MessageError for bits of more legs."""
    if not 0 <= message.value < 1 << N_LEGS:
        raise MessageError(f"contacts: got {message.value}; allowed: 0 to {(1 << N_LEGS) - 1}")
    return np.array([message.value >> leg & 1 for leg in range(N_LEGS)], dtype=bool)


def name_of(message: Any) -> str:
    """The name of a NAMED_VALUE_INT, or the text of a STATUSTEXT, printable characters only."""
    raw = message.name if message.get_type() == "NAMED_VALUE_INT" else message.text
    text = raw.decode("ascii", errors="replace") if isinstance(raw, bytes) else str(raw)
    return "".join(letter for letter in text.split("\0")[0] if letter.isprintable()).strip()


def _finite(value: float, what: str) -> float:
    if not math.isfinite(value):
        raise MessageError(f"{what}: got {value}; allowed: finite numbers")
    return value


def _unit(components: list[float], what: str) -> FloatArray:
    quaternion = np.array(components, dtype=float)
    length = float(np.linalg.norm(quaternion))
    if not abs(length - 1) < QUATERNION_SLACK:  # false for nan too
        raise MessageError(f"{what}: got an orientation of length {length:g}; allowed: 1")
    return flipped_quaternion(quaternion / length)


def flipped_vector(vector: FloatArray) -> FloatArray:
    """A vector (3,) of one frame in the other."""
    return np.asarray(vector * FLIP_VECTOR)


def flipped_quaternion(quaternion: FloatArray) -> FloatArray:
    """An orientation (w, x, y, z) of one pair of frames in the other."""
    return np.asarray(quaternion * FLIP_QUATERNION)


def euler_of_quaternion(quaternion: FloatArray) -> tuple[float, float, float]:
    """Roll, pitch and yaw in rad of an orientation (w, x, y, z)."""
    roll, pitch = roll_pitch_rad(quaternion)
    return float(roll), float(pitch), float(yaw_rad(quaternion))
