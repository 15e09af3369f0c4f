"""MAVLink messages of a servo board: its state, and its answers to ground stations.

Stations repeat unanswered requests for many seconds. The board therefore answers that it has one constant
parameter, no mission and no files. The protocols: https://mavlink.io/en/services/.
"""

from collections.abc import Callable
from typing import Any

from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.mavlink_messages import (
    BOARD_COMPONENT,
    BOARD_SYSTEM,
    euler_of_quaternion,
    flipped_quaternion,
    flipped_vector,
)
from hexctl.types import N_JOINTS, BoolArray, FloatArray, RobotState

#: Outputs that ACTUATOR_OUTPUT_STATUS has room for.
OUTPUTS = 32

#: Values of an unknown voltage and share.
UNKNOWN_MV, UNKNOWN_SHARE = 65535, -1

LONGEST_TEXT = 50

#: Name and value of the one parameter: a list without any has no answer in the protocol.
PARAMETER, VALUE = b"CHANNELS", float(N_JOINTS)

#: Index of a parameter requested by name, or missing from the list.
BY_NAME = -1


def answers(kind: str, message: Any, system: int, component: int) -> list[Any]:
    """Answers to a message of a system and its component; empty for unsupported messages."""
    if kind == "PING":
        if message.target_system or message.target_component:
            return []
        return [common.MAVLink_ping_message(message.time_usec, message.seq, system, component)]
    answer = ANSWERS.get(kind)
    return [] if answer is None or not for_us(message) else answer(message, system, component)


def for_us(message: Any) -> bool:
    """Whether a message is for this board; target 0 is a broadcast."""
    return message.target_system in (0, BOARD_SYSTEM) and message.target_component in (0, BOARD_COMPONENT)


def _command(message: Any, system: int, component: int) -> list[Any]:
    wants_version = message.command == common.MAV_CMD_REQUEST_AUTOPILOT_CAPABILITIES or (
        message.command == common.MAV_CMD_REQUEST_MESSAGE
        and message.param1 == common.MAVLINK_MSG_ID_AUTOPILOT_VERSION
    )
    result = common.MAV_RESULT_ACCEPTED if wants_version else common.MAV_RESULT_UNSUPPORTED
    sent = [common.MAVLink_command_ack_message(message.command, result, 0, 0, system, component)]
    return [*sent, _version()] if wants_version else sent


def _version() -> Any:
    unknown = [0] * 8
    return common.MAVLink_autopilot_version_message(
        common.MAV_PROTOCOL_CAPABILITY_MAVLINK2, 0, 0, 0, 0, unknown, unknown, unknown, 0, 0, 0
    )


def _read_parameter(message: Any, system: int, component: int) -> list[Any]:
    """The parameter of a name or an index, or that it does not exist."""
    index = message.param_index
    known = _name_of(message) == PARAMETER if index == BY_NAME else index == 0
    return [_parameter()] if known else [_no_parameter(message, index, system, component)]


def _set_parameter(message: Any, system: int, component: int) -> list[Any]:
    known = _name_of(message) == PARAMETER
    return [_parameter()] if known else [_no_parameter(message, BY_NAME, system, component)]


def _parameter() -> Any:
    return common.MAVLink_param_value_message(PARAMETER, VALUE, common.MAV_PARAM_TYPE_REAL32, 1, 0)


def _no_parameter(message: Any, index: int, system: int, component: int) -> Any:
    error = common.MAV_PARAM_ERROR_DOES_NOT_EXIST
    return common.MAVLink_param_error_message(system, component, _name_of(message), index, error)


def _name_of(message: Any) -> bytes:
    """Name in a request, as its bytes; pymavlink gives those of ASCII as a text."""
    name = message.param_id
    return name.encode("ascii", "replace") if isinstance(name, str) else bytes(name).split(b"\0")[0]


def _mission_count(message: Any, system: int, component: int) -> list[Any]:
    return [common.MAVLink_mission_count_message(system, component, 0, message.mission_type)]


def _no_mission(message: Any, system: int, component: int) -> list[Any]:
    result = common.MAV_MISSION_UNSUPPORTED
    return [common.MAVLink_mission_ack_message(system, component, result, message.mission_type)]


#: Payload offsets of a file transfer (https://mavlink.io/en/services/ftp.html): 16 bits of sequence, then
#: a byte each for session, opcode, size, and requested opcode.
FTP_OPCODE, FTP_SIZE, FTP_REQUESTED, FTP_DATA = 3, 4, 5, 12

#: The answer that refuses, and that for a reason: no such command is known.
FTP_NAK, FTP_ACK, FTP_UNKNOWN_COMMAND = 129, 128, 7


def _no_files(message: Any, system: int, component: int) -> list[Any]:
    """That the board has no files; nothing for an answer."""
    asked = bytes(message.payload)
    if asked[FTP_OPCODE] in (FTP_ACK, FTP_NAK):
        return []
    payload = bytearray(len(asked))
    payload[:2] = ((int.from_bytes(asked[:2], "little") + 1) % 65536).to_bytes(2, "little")
    payload[2] = asked[2]
    payload[FTP_OPCODE], payload[FTP_SIZE], payload[FTP_REQUESTED] = FTP_NAK, 1, asked[FTP_OPCODE]
    payload[FTP_DATA] = FTP_UNKNOWN_COMMAND
    return [common.MAVLink_file_transfer_protocol_message(0, system, component, bytes(payload))]


#: Answers by the name of the message.
ANSWERS: dict[str, Callable[[Any, int, int], list[Any]]] = {
    "COMMAND_LONG": _command,
    "COMMAND_INT": _command,
    "PARAM_REQUEST_LIST": lambda _message, _system, _component: [_parameter()],
    "PARAM_REQUEST_READ": _read_parameter,
    "PARAM_SET": _set_parameter,
    "MISSION_REQUEST_LIST": _mission_count,
    "MISSION_COUNT": _no_mission,
    "MISSION_REQUEST": _no_mission,
    "MISSION_REQUEST_INT": _no_mission,
    "MISSION_CLEAR_ALL": _no_mission,
    "FILE_TRANSFER_PROTOCOL": _no_files,
}


def outputs(pulses_us: FloatArray, active: BoolArray, time_s: float) -> Any:
    """Pulses of the servos by channel, (18,), and which channels are driven."""
    mask = sum(1 << channel for channel in range(N_JOINTS) if active[channel])
    values = [*pulses_us.tolist(), *[0.0] * (OUTPUTS - N_JOINTS)]
    return common.MAVLink_actuator_output_status_message(int(time_s * 1e6), mask, values)


def pose(state: RobotState, time_s: float, *, with_euler: bool) -> list[Any]:
    """Orientation and position, with Euler angles for displays; each if known."""
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
    """Heartbeat of the board with its MAV_STATE, and no autopilot."""
    return mavlink_messages.heartbeat(common.MAV_TYPE_GENERIC, common.MAV_AUTOPILOT_INVALID, system_state)


def measured(flag: bool, time_s: float) -> Any:
    """Flag whether joint positions are measured or echoed."""
    return _named(mavlink_messages.MEASURED_NAME, int(flag), time_s)


def contacts(feet: BoolArray, time_s: float) -> Any:
    """Which feet touch the ground, (6,)."""
    mask = sum(1 << leg for leg, touches in enumerate(feet) if touches)
    return _named(mavlink_messages.CONTACTS_NAME, mask, time_s)


def _named(name: str, value: int, time_s: float) -> Any:
    return common.MAVLink_named_value_int_message(mavlink_messages.milliseconds(time_s), name.encode(), value)


def health(state: RobotState, *, errors: int) -> list[Any]:
    """Battery, if known, and the count of malformed bytes and frames."""
    millivolts = UNKNOWN_MV if state.battery_v is None else round(1000 * state.battery_v)
    share = UNKNOWN_SHARE if state.battery_share is None else round(100 * state.battery_share)
    errors = min(errors, 65535)
    sent = [common.MAVLink_sys_status_message(0, 0, 0, 0, millivolts, -1, share, 0, errors, 0, 0, 0, 0)]
    if state.battery_v is not None:
        cells = [millivolts, *[UNKNOWN_MV] * 9]
        kind = common.MAV_BATTERY_FUNCTION_ALL, common.MAV_BATTERY_TYPE_UNKNOWN
        sent.append(common.MAVLink_battery_status_message(0, *kind, 32767, cells, -1, -1, -1, share))
    return sent


def text(severity: int, line: str) -> Any:
    """Status text for a display."""
    return common.MAVLink_statustext_message(severity, line.encode("ascii", "replace")[:LONGEST_TEXT])
