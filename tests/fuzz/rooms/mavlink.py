"""Targets on a MAVLink port: bytes, frames with good checksums, and what both ends make of messages."""

from contextlib import suppress
from functools import cache, partial
from pathlib import Path
from typing import Any

import numpy as np
from pymavlink.dialects.v20 import common

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec, Frame, read_signing_key
from hexctl.backends.mavlink.mavlink_client import MavlinkServos, Receiver, Stamped
from hexctl.backends.mavlink.mavlink_transport import LinkCounters, MavlinkLink, Port
from hexctl.backends.mock import MockServos
from hexctl.errors import CommandRefusedError
from hexctl.robot.servos.servo_map import servo_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.board_messages import ANSWERS, answers, for_us
from hexctl.simulators.servo_board import Channels, Peers, ServoBoard
from hexctl.types import N_JOINTS
from tests.fuzz.target import BINARY_NUMBERS, target, written
from tests.robots import shipped

MAP = servo_map_of(ServosSection())
KEY = bytes(range(32))
KINDS = sorted(common.mavlink_map)

#: Messages that either end reads, which most inputs are of.
READ = (
    "HEARTBEAT",
    "ACTUATOR_OUTPUT_STATUS",
    "ATTITUDE",
    "ATTITUDE_QUATERNION",
    "LOCAL_POSITION_NED",
    "ODOMETRY",
    "BATTERY_STATUS",
    "SYS_STATUS",
    "NAMED_VALUE_INT",
    "STATUSTEXT",
    "RC_CHANNELS_OVERRIDE",
    "PING",
    *ANSWERS,
)
NUMBER_OF = {kind.msgname: number for number, kind in common.mavlink_map.items()}


class NoPort(Port):
    """A port that takes everything, and from which nothing comes."""

    datagrams = True

    def receive(self, timeout_s: float) -> list[tuple[bytes, Any]]:
        """Nothing."""
        return []

    def send(self, frame: bytes, to: Any) -> None:
        """Nothing."""

    def close(self) -> None:
        """Nothing."""


def _frames(*sent: Any) -> bytes:
    """Messages as `_framed` reads them."""
    codec, whole = Codec(1, 1), b""
    for message in sent:
        frame = codec.encode(message, 0)
        whole += bytes([READ.index(message.get_type()), frame[1]]) + frame[10 : 10 + frame[1]]
    return whole


BEAT = mavlink_messages.heartbeat(0, 8, 4)
OUTPUTS = common.MAVLink_actuator_output_status_message(0, (1 << 18) - 1, [1500.0] * 32)
OVERRIDE = mavlink_messages.override(np.full(N_JOINTS, 1500.0), 1, 1)
TEXT = common.MAVLink_statustext_message(2, b"hot")
SAID = (
    _frames(BEAT, OUTPUTS, common.MAVLink_attitude_message(0, 0.1, 0.2, 0.3, 0, 0, 0)),
    _frames(BEAT, common.MAVLink_attitude_quaternion_message(0, 1.0, 0, 0, 0, 0, 0, 0), TEXT),
    _frames(BEAT, common.MAVLink_local_position_ned_message(0, 1, 2, 3, 0, 0, 0)),
    _frames(
        BEAT,
        common.MAVLink_named_value_int_message(0, b"measured", 1),
        common.MAVLink_battery_status_message(0, 0, 0, 0, [4000] * 10, 0, 0, 0, 50),
    ),
)
ASKED = (
    _frames(BEAT, OVERRIDE, common.MAVLink_ping_message(0, 1, 0, 0)),
    _frames(BEAT, common.MAVLink_param_request_read_message(1, 1, b"CHANNELS", -1)),
    _frames(BEAT, common.MAVLink_command_long_message(1, 1, 512, 0, 148, 0, 0, 0, 0, 0, 0)),
)


@target(
    Codec(1, 1).encode(BEAT, 5),
    Codec(1, 1).encode(OVERRIDE, 5),
    Codec(1, 1, signing_key=KEY).encode(BEAT, 5),
    words=(b"\xfd", b"\xfd\x09\0\0\5\1\1\0\0\0"),
)
def read_mavlink_bytes(data: bytes) -> None:
    """Decode a datagram, a stream in two parts, and both with a key."""
    for key in (None, KEY):
        codec = Codec(255, 191, signing_key=key)
        frames = codec.decode(data, whole=True)
        middle = len(data) // 2
        streamed = Codec(255, 191, signing_key=key)
        came = streamed.decode(data[:middle], whole=False) + streamed.decode(data[middle:], whole=False)
        assert len(came) <= len(data) // 12
        assert len(frames) <= len(data) // 12


def _framed(data: bytes) -> list[Frame]:
    """Frames with good checksums of an input: number of the message, size of the payload, and payload."""
    codec, frames = Codec(1, 1), []
    for sequence in range(6):
        if len(data) < 2:
            break
        number = NUMBER_OF[READ[data[0] % len(READ)]] if data[0] < 0xF0 else KINDS[data[0] * 7 % len(KINDS)]
        size = data[1]
        payload, data = data[2 : 2 + size], data[2 + size :]
        head = bytes([0xFD, len(payload), 0, 0, sequence, 1, 1]) + number.to_bytes(3, "little")
        crc = common.x25crc(head[1:] + payload)
        crc.accumulate(bytes([common.mavlink_map[number].crc_extra]))
        frames += codec.decode(head + payload + crc.crc.to_bytes(2, "little"), whole=True)
    return frames


@cache
def _servos() -> MavlinkServos:
    return MavlinkServos(shipped(), servo_map=MAP, port="udpout:127.0.0.1:14550")


@target(*SAID, words=BINARY_NUMBERS)
def read_mavlink_client(data: bytes) -> None:
    """Give frames to the controller's end, and put a state together."""
    receiver = Receiver(MavlinkLink(NoPort(), Codec(255, 191)), LinkCounters())
    for frame in _framed(data):
        receiver._take(frame, None, 1.0)
    servos = _servos()
    outputs = receiver.newest("outputs")
    if outputs is None:
        receiver._newest["outputs"] = Stamped(
            mavlink_messages.Outputs(np.full(N_JOINTS, 1500.0), np.ones(N_JOINTS, dtype=bool)), 1.0
        )
    servos._receiver = receiver
    state = servos._newest()
    assert np.isfinite(state.joint_positions_rad).all()


@cache
def _board() -> ServoBoard:
    board = ServoBoard(MockServos(shipped()), MAP, NoPort())
    board._guard.connect()
    board._guard.clock.tick()
    return board


@target(*ASKED, words=BINARY_NUMBERS)
def read_mavlink_board(data: bytes) -> None:
    """Give frames to a servo board."""
    board = _board()
    board._peers = Peers()
    for frame in _framed(data):
        board._handle(frame, None, 1.0)
        with suppress(AttributeError):  # most messages name no target
            for_us(frame.message)
        for answer in answers(frame.kind, frame.message, 7, 8):
            assert Codec(1, 1).encode(answer, 0)
    channels = Channels(MAP)
    with suppress(CommandRefusedError):
        channels.take([int(number) for number in np.frombuffer(data[:36].ljust(36, b"\0"), "<u2")])
        assert ((channels.pulses_us >= 100) & (channels.pulses_us <= 5000)).all()


@target(KEY, KEY.hex().encode(), b"", given=partial(written, "mavlink.key"))
def read_mavlink_key(path: Path) -> None:
    key = read_signing_key(path.parent)
    assert key is not None
    assert len(key) == 32
