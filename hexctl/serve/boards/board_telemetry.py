"""MAVLink messages of a servo board: its state."""

from typing import Any

from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.mavlink_messages import euler_of_quaternion, flipped_quaternion, flipped_vector
from hexctl.types import N_JOINTS, BoolArray, FloatArray, RobotState

#: Outputs that ACTUATOR_OUTPUT_STATUS has room for.
OUTPUTS = 32

#: Values of an unknown voltage and share.
UNKNOWN_MV, UNKNOWN_SHARE = 65535, -1

LONGEST_TEXT = 50


def outputs(pulses_us: FloatArray, active: BoolArray, time_s: float) -> Any:
    """Pulses of the servos by channel, (18,), and which channels are driven."""
    mask = sum(1 << channel for channel in range(N_JOINTS) if active[channel])
    values = [*pulses_us.tolist(), *[0.0] * (OUTPUTS - N_JOINTS)]
    return common.MAVLink_actuator_output_status_message(int(time_s * 1e6), mask, values)


def pose(state: RobotState, time_s: float, *, with_euler: bool) -> list[Any]:
    """Orientation and position, with Euler angles for displays; each where it is known."""
    at_ms, sent = mavlink_messages.milliseconds(time_s), []
    if state.base_quaternion_world is not None:
        quaternion = flipped_quaternion(state.base_quaternion_world)
        sent.append(common.MAVLink_attitude_quaternion_message(at_ms, *quaternion.tolist(), 0.0, 0.0, 0.0))
    if state.base_position_world is not None:
        x, y, z = flipped_vector(state.base_position_world).tolist()
        sent.append(common.MAVLink_local_position_ned_message(at_ms, x, y, z, 0.0, 0.0, 0.0))
    if state.base_quaternion_world is not None and with_euler:
        angles = euler_of_quaternion(quaternion)
        sent.append(common.MAVLink_attitude_message(at_ms, *angles, 0.0, 0.0, 0.0))
    return sent


def heartbeat(system_state: int) -> Any:
    """Heartbeat of the board with its MAV_STATE: no autopilot, which has modes, parameters and missions."""
    return mavlink_messages.heartbeat(common.MAV_TYPE_GENERIC, common.MAV_AUTOPILOT_INVALID, system_state)


def measured(flag: bool, time_s: float) -> Any:
    """Flag that tells measured joint positions from echoed ones."""
    return common.MAVLink_named_value_int_message(
        mavlink_messages.milliseconds(time_s), mavlink_messages.MEASURED_NAME.encode(), int(flag)
    )


def health(state: RobotState, *, errors: int) -> list[Any]:
    """Battery, where known, and the count of malformed bytes and frames."""
    millivolts = UNKNOWN_MV if state.battery_v is None else round(1000 * state.battery_v)
    share = UNKNOWN_SHARE if state.battery_share is None else round(100 * state.battery_share)
    errors = min(errors, 65535)
    sent = [common.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, share, 0, errors, 0, 0, 0, 0)]
    if state.battery_v is not None:
        cells = [millivolts, *[UNKNOWN_MV] * 9]
        sent.append(
            common.MAVLink_battery_status_message(
                0,
                common.MAV_BATTERY_FUNCTION_ALL,
                common.MAV_BATTERY_TYPE_UNKNOWN,
                32767,
                cells,
                -1,
                -1,
                -1,
                share,
            )
        )
    return sent


def text(severity: int, line: str) -> Any:
    """Status text for a display."""
    return common.MAVLink_statustext_message(severity, line.encode("ascii", "replace")[:LONGEST_TEXT])
