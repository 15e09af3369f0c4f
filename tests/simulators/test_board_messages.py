"""What ground stations ask a board for: each request has an answer, so that none is asked again."""

import copy
from typing import Any

import pytest
from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink.codec import Codec
from hexctl.simulators.board_messages import PARAMETER, answers

#: What QGroundControl and mavsdk ask a new system for, and the answer that ends their waiting.
REQUESTS = {
    "PARAM_REQUEST_LIST": (common.MAVLink_param_request_list_message(1, 1), "PARAM_VALUE"),
    "PARAM_REQUEST_READ": (common.MAVLink_param_request_read_message(1, 1, PARAMETER, -1), "PARAM_VALUE"),
    "by index": (common.MAVLink_param_request_read_message(1, 1, b"", 0), "PARAM_VALUE"),
    "no index": (common.MAVLink_param_request_read_message(1, 1, b"", 7), "PARAM_ERROR"),
    "no name": (common.MAVLink_param_request_read_message(1, 1, b"SYS_AUTOSTART", -1), "PARAM_ERROR"),
    "PARAM_SET": (common.MAVLink_param_set_message(1, 1, PARAMETER, 99.0, 9), "PARAM_VALUE"),
    "set none": (common.MAVLink_param_set_message(1, 1, b"SYS_AUTOSTART", 1.0, 9), "PARAM_ERROR"),
    "MISSION_REQUEST_LIST": (common.MAVLink_mission_request_list_message(1, 1, 1), "MISSION_COUNT"),
    "MISSION_COUNT": (common.MAVLink_mission_count_message(1, 1, 5, 0), "MISSION_ACK"),
    "MISSION_REQUEST_INT": (common.MAVLink_mission_request_int_message(1, 1, 0, 0), "MISSION_ACK"),
    "MISSION_REQUEST": (common.MAVLink_mission_request_message(1, 1, 0, 0), "MISSION_ACK"),
    "MISSION_CLEAR_ALL": (common.MAVLink_mission_clear_all_message(1, 1, 0), "MISSION_ACK"),
    "COMMAND_LONG": (common.MAVLink_command_long_message(1, 1, 400, 0, *[1.0] * 7), "COMMAND_ACK"),
    "COMMAND_INT": (
        common.MAVLink_command_int_message(1, 1, 0, 400, 0, 0, *[1.0] * 4, 1, 1, 1.0),
        "COMMAND_ACK",
    ),
    "FILE_TRANSFER_PROTOCOL": (
        common.MAVLink_file_transfer_protocol_message(
            0, 1, 1, bytes([0xFF, 0xFF, 5, 3, 1, *[0] * 7, ord("/")]).ljust(251, b"\0")
        ),
        "FILE_TRANSFER_PROTOCOL",
    ),
}


#: What answers say: the parameter never changes, and there are no missions and no files.
SAID: dict[str, dict[str, Any]] = {
    "PARAM_VALUE": {"param_id": "CHANNELS", "param_value": 18.0, "param_count": 1},
    "PARAM_ERROR": {"error": common.MAV_PARAM_ERROR_DOES_NOT_EXIST},
    "MISSION_COUNT": {"count": 0, "mission_type": 1},
    "MISSION_ACK": {"type": common.MAV_MISSION_UNSUPPORTED},
    "FILE_TRANSFER_PROTOCOL": {"payload": [0, 0, 5, 129, 1, 3, *[0] * 6, 7, *[0] * 238]},
}


def answered(request: Any) -> list[Any]:
    """Answers to a request of system 255, component 190, each as it arrives there."""
    station, board = Codec(255, 190), Codec(1, 1)
    (asked,) = board.decode(station.encode(request, 0), whole=True)
    sent = answers(asked.kind, asked.message, asked.system, asked.component)
    return [station.decode(board.encode(message, 0), whole=True)[0].message for message in sent]


@pytest.mark.parametrize("name", REQUESTS)
def test_every_request_has_one_answer_for_who_asked_and_none_for_another_system(name: str) -> None:
    request, kind = copy.copy(REQUESTS[name][0]), REQUESTS[name][1]
    (answer,) = answered(request)
    assert answer.get_type() == kind
    assert answer.to_dict().items() >= SAID.get(kind, {}).items()
    if kind != "PARAM_VALUE":
        assert (answer.target_system, answer.target_component) == (255, 190)
    request.target_system = 2
    assert answered(request) == []


@pytest.mark.parametrize("long", [True, False])
def test_the_version_is_told_and_every_other_command_refused(long: bool) -> None:
    def ask(command: int, parameter: float) -> list[Any]:
        if long:
            return answered(common.MAVLink_command_long_message(1, 1, command, 0, parameter, *[0.0] * 6))
        rest = [parameter, 0.0, 0.0, 0.0, 0, 0, 0.0]
        return answered(common.MAVLink_command_int_message(1, 1, 0, command, 0, 0, *rest))

    for command, parameter in ((520, 1.0), (512, 148.0)):
        told, version = ask(command, parameter)
        assert told.result == common.MAV_RESULT_ACCEPTED
        assert version.get_type() == "AUTOPILOT_VERSION"
    for command, parameter in ((512, 30.0), (400, 1.0), (512, float("nan"))):
        assert ask(command, parameter)[0].result == common.MAV_RESULT_UNSUPPORTED


@pytest.mark.parametrize("name", [b"\xff\xfe", b"", b"A" * 16])
def test_a_name_of_any_bytes_is_answered(name: bytes) -> None:
    (error,) = answered(common.MAVLink_param_request_read_message(1, 1, name, -1))
    assert error.get_type() == "PARAM_ERROR"


def test_other_messages_have_no_answer() -> None:
    files = common.MAVLink_file_transfer_protocol_message(0, 1, 1, bytes([1, 0, 5, 129]).ljust(251, b"\0"))
    for message in (
        files,  # itself an answer
        common.MAVLink_heartbeat_message(6, 8, 0, 0, 4, 3),
        common.MAVLink_ping_message(1, 2, 1, 1),
    ):
        assert answered(message) == []
