"""Targets of servos: what a controller makes of their answers, and what simulated ones obey."""

import errno
import struct
from collections.abc import Callable, Iterable
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.families.lx16a import ANSWER_BYTES, PACKETS, move_packet
from hexctl.backends.bus.families.register_servo import RegisterServo
from hexctl.backends.bus.family import find_family
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import (
    BROADCAST,
    PING,
    PROTOCOLS,
    READ,
    REBOOT,
    SYNC_READ,
    SYNC_WRITE,
    WRITE,
    PacketFormat,
    PacketStream,
)
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import bus_of
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.i2c_socket import I2cMessage, decode_transaction, encode_transaction
from hexctl.backends.pwm.pulse_board import pwm_map_of
from hexctl.backends.pwm.servo2040 import Servo2040, decoded, encoded, find_reply, get_frame, set_frame
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.board_faults import BusFaults
from hexctl.simulators.bus_servos import BUS_COUNTS, simulated_servos
from hexctl.simulators.pca9685_board import SimulatedI2c, SimulatedPca9685
from hexctl.simulators.servo2040_board import Servo2040Board
from hexctl.time_source import WALL_TIME
from hexctl.types import N_JOINTS
from tests.backends.bus.boards import MODELS, MODELS_BY_NAME, a_map, stance_counts
from tests.fuzz.target import Target, target
from tests.robots import shipped

FIRST = np.arange(N_JOINTS) == 0

PWM = pwm_map_of(ServosSection(), "servo2040")

#: Time on the wire by which every wait ends immediately.
OVER_S = -10.0


class FuzzedLine:
    """A line on which each request is answered by bytes of the input: nothing, noise, or a good packet.

    Args:
        data: the input.
        packets: of the servos; None for a line without packets.
    """

    path, baud, echoes, free_s, time = "/dev/fuzz", 1_000_000, False, 0.0, WALL_TIME

    def __init__(self, data: bytes, packets: PacketFormat | None) -> None:
        self._data, self._packets = data, packets
        self._answer = b""

    def write(self, packet: bytes, *, timeout_s: float = 0.0) -> None:
        """Take a request."""
        head, self._data = self._data[:2], self._data[2:]
        how, size = (*head, 0, 0)[:2]
        came, self._data = self._data[:size], self._data[size:]
        asked = None if self._packets is None else self._packets.take(packet)[0]
        if self._packets is None or asked is None or how & 1:
            self._answer += came
        elif how & 6:
            self._answer += self._good(self._packets, *asked, came, error=how & 4 and how)

    def _good(
        self, packets: PacketFormat, servo_id: int, asked: int, about: bytes, came: bytes, *, error: int
    ) -> bytes:
        """Answer of the length that was asked for, if known."""
        if packets is PACKETS:
            size, error = ANSWER_BYTES.get(asked, len(came)), asked
        else:
            known = packets.answer_size(asked, about)
            size = len(came) if known is None else min(known, 200)
        return packets.status(1 if servo_id == BROADCAST else servo_id, error, came.ljust(size, b"\0")[:size])

    def read(self, deadline_s: float) -> bytes:
        """The answer, in two parts."""
        half = -(-len(self._answer) // 2)
        taken, self._answer = self._answer[:half], self._answer[half:]
        return taken

    def discard(self) -> None:
        """Drop what came."""
        self._answer = b""

    def wire_s(self, count: int) -> float:
        """So little that nothing is waited for."""
        return OVER_S

    def close(self) -> None:
        """Nothing."""


def _stream(name: str, packets: PacketFormat, *seeds: bytes, words: tuple[bytes, ...]) -> Target:
    """Feed a stream in two parts, and round trip a packet of the input's first bytes."""

    def read(data: bytes) -> None:
        stream = PacketStream(packets)
        middle = len(data) // 2
        whole = [*stream.feed(data[:middle]), *stream.feed(data[middle:]), *stream.finish()]
        assert 0 <= stream.garbled <= len(data)
        for packet in whole:
            assert 0 <= packet.servo_id <= 255
        if len(data) < 3:
            return
        most = 4 if packets is PACKETS else 200
        servo_id, error, parameters = data[0] % 0xFD, data[1], data[2 : 2 + most]
        again = PacketStream(packets)
        found = again.feed(b"\0" + packets.status(servo_id, error, parameters))
        assert [(one.servo_id, one.error, one.parameters) for one in found] == [(servo_id, error, parameters)]

    return Target(name=name, read=read, seeds=seeds, words=words)


ONE, TWO = PROTOCOLS[1], PROTOCOLS[2]
PACKETS_1 = _stream(
    "packets-1",
    ONE,
    ONE.status(1, 0, b"\1\2"),
    ONE.instruction(254, 0x83, bytes(20)),
    words=(b"\xff\xff", b"\xff\xff\1\2"),
)
PACKETS_2 = _stream(
    "packets-2",
    TWO,
    TWO.status(1, 0, b"\1\2"),
    TWO.status(2, 128, b"\xff\xff\xfd" * 3),
    words=(b"\xff\xff\xfd\0", b"\xff\xff\xfd\xfd"),
)
PACKETS_LX16A = _stream(
    "packets-lx16a",
    PACKETS,
    PACKETS.status(1, 28, b"\1\2"),
    PACKETS.instruction(3, 1, bytes(4)),
    words=(b"\x55\x55", b"\x55\x55\1\3"),
)


@cache
def _map(driver: str, model: str) -> BusMap:
    return a_map(driver, model)


def _look_at(driver: str, model: str, data: bytes, *, by_hand: bool) -> None:
    """Let a servo of a model answer, and look at it as a person does, or as a bus."""
    family, protocol = find_family(driver), MODELS_BY_NAME[model].protocol
    packets = family.formats[protocol]
    line: Any = FuzzedLine(data, packets)
    with suppress(RobotFaultError):
        if by_hand:
            servo = family.servo_with(PacketLine(line, packets, timeout_s=0.0, adapts=False), protocol, 1)
            str(servo.look().to_json())
            servo.limits()
            servo.settings()
            servo.position()
        else:
            bus = bus_of(_map(driver, model), line, BusCounters())
            bus._packets._most_timeout_s = 0.0
            bus.servos[0].set_up()
            bus.settings(FIRST)
            bus.torque(0)
            if isinstance(bus.servos[0], RegisterServo):
                bus.servos[0].model_number()
            for report in bus.poll():
                assert np.isfinite(report.position)


def _answers(sides: Iterable[int], *sizes: int) -> tuple[bytes, ...]:
    """Answers as `FuzzedLine` reads them, good ones, with a first byte that says who answers whom."""
    return tuple(
        bytes([side]) + b"".join(bytes([2, size, *[number] * size]) for number in range(1, 20))
        for side in sides
        for size in sizes
    )


@target(
    *_answers([which | side for which in range(len(MODELS)) for side in (0, 0x80)], 1, 2),
    words=(b"\2\1", b"\2\2", b"\5\1"),
)
def read_register_servo(data: bytes) -> None:
    if data:
        _look_at(*MODELS[data[0] % len(MODELS)], data[1:], by_hand=bool(data[0] & 0x80))


@target(*_answers((0, 0x80), 1, 2, 4), words=(b"\2\1", b"\2\2", b"\2\4"))
def read_lx16a_servo(data: bytes) -> None:
    _look_at("lx16a", "lx16a", data[1:], by_hand=bool(sum(data[:1]) & 0x80))


@target(bytes(range(30)), b"\xff" * 30)
def read_register_table(data: bytes) -> None:
    """Read the report of every model from the same bytes, and write its numbers back."""
    for _, model in MODELS:
        table = MODELS_BY_NAME[model].table
        first, size = table.block
        report = data[:size].ljust(size, b"\0")
        for register, value in zip(table.reported, table.numbers(report), strict=True):
            if register is None:
                assert np.isnan(value)
                continue
            start = register.address - first
            raw = int.from_bytes(report[start : start + register.size], table.byte_order)
            if register.sign in ("none", "twos"):
                assert register.raw(value) == raw


#: A servo2040 that tells its voltage, and all that is asked for.
REPLIES = b"\0\x05\xc7\x1e\1\x10\x10" + b"\0\x13\xc7\x18\x08" + bytes(16)


@target(REPLIES, b"\1\2\3", words=(b"\xc7\x1e\1", b"\xc7\x18"))
def read_servo2040(data: bytes) -> None:
    """Let a servo2040 answer; a reply is found among noise."""
    values = [number % 16384 for number in data[:6]]
    assert decoded(encoded(values)) == values
    find_reply(data, *(*data, 0, 0)[:2], checked=bool(sum(data[:1]) & 1))
    line: Any = FuzzedLine(data, None)
    try:
        board = Servo2040(line, PWM)
    except RobotFaultError:
        return
    board.poll()
    with suppress(TimeoutError):
        board.commanded_us()


def _obeyed(driver: str, model: str, data: bytes) -> None:
    """Give bytes on a line to simulated servos of a model."""
    bus_map = _map(driver, model)
    counts = stance_counts(bus_map)
    family = simulated_servos(bus_map)(bus_map, counts, BusFaults(), dict.fromkeys(BUS_COUNTS, 0))
    now_s = 0.0
    while True:
        packet, done = family.packets.take(data)
        data = data[done:]
        if packet is None:
            break
        now_s += 0.02
        for answer in family.obey(*packet, now_s):
            found, _ = family.packets.take(answer)
            assert found is not None
    family.show(counts, np.zeros(N_JOINTS))
    assert family.holds().shape == family.goals(1.0).shape == (N_JOINTS,)
    assert np.isfinite(family.goals(1.0)).all()


def _packed(data: bytes, instruction: Callable[[int, int, bytes], bytes], most: int = 240) -> bytes:
    """Packets with good sums of an input: id, instruction, size and parameters of each."""
    whole = b""
    while len(data) >= 3:
        size = min(data[2], most)
        whole += instruction(data[0], data[1], data[3 : 3 + size])
        data = data[3 + size :]
    return whole


def _wanted(*each: tuple[int, int, bytes]) -> bytes:
    """Instructions as `_packed` reads them."""
    return b"".join(bytes([servo_id, code, len(data)]) + data for servo_id, code, data in each)


WANTED = {
    1: _wanted(
        (1, PING, b""),
        (1, READ, bytes([36, 2])),
        (1, WRITE, bytes([24, 1])),
        (254, PING, b""),
        (1, REBOOT, b""),
        (254, SYNC_WRITE, bytes([30, 2, 1, 0, 2, 2, 1, 2])),
        (254, WRITE, bytes([3, 9])),
    ),
    2: _wanted(
        (1, PING, b""),
        (1, READ, b"\x84\0\4\0"),
        (1, WRITE, b"\x40\0\1"),
        (254, SYNC_READ, b"\x84\0\4\0\1\2\3"),
        (254, SYNC_WRITE, b"\x74\0\4\0\1\0\2\0\0"),
        (2, WRITE, b"\x0b\0\3"),
    ),
}


def _model(data: bytes) -> tuple[str, str]:
    """Driver and model that the first byte says."""
    return MODELS[data[0] % len(MODELS)]


def _protocol(data: bytes) -> int:
    return MODELS_BY_NAME[_model(data)[1]].table.protocol


@target(
    *(bytes([which]) + WANTED[_protocol(bytes([which]))] for which in range(len(MODELS))),
    words=(b"\2", b"\3", b"\x82", b"\x83", b"\xfe"),
)
def read_register_board(data: bytes) -> None:
    if data:
        _obeyed(*_model(data), _packed(data[1:], PROTOCOLS[_protocol(data)].instruction))


@target(
    *(
        bytes([which]) + _packed(WANTED[kind], PROTOCOLS[kind].instruction)
        for which, kind in ((0, 1), (2, 2), (4, 1))
    ),
    words=(b"\xff\xff", b"\xff\xff\xfd\0"),
)
def read_register_line(data: bytes) -> None:
    if data:
        _obeyed(*_model(data), data[1:])


@target(
    _wanted((1, 28, b""), (1, 20, b"\0\0\xe8\3"), (1, 21, b""), (1, 1, b"\xf4\1\0\1"), (1, 31, b"\1")),
    _wanted((254, 14, b""), (1, 13, b"\5"), (5, 27, b""), (254, 31, b"\0"), (2, 26, b"")),
    words=(b"\x14\4", b"\x15\0", b"\xfe"),
)
def read_lx16a_board(data: bytes) -> None:
    _obeyed("lx16a", "lx16a", _packed(data, PACKETS.instruction, most=4))


@target(
    move_packet(PACKETS, 1, 500, 100),
    PACKETS.instruction(1, 28),
    PACKETS.instruction(1, 20, b"\0\0\xe8\3"),
    words=(b"\x55\x55",),
)
def read_lx16a_line(data: bytes) -> None:
    _obeyed("lx16a", "lx16a", data)


class OneRead:
    """A line of a board on which an input comes once, in two parts."""

    path = "/dev/fuzz"

    def __init__(self, data: bytes) -> None:
        self._parts = [data[: len(data) // 2], data[len(data) // 2 :]]

    def receive(self, timeout_s: float) -> bytes:
        """The next part."""
        return self._parts.pop(0) if self._parts else b""

    def send(self, data: bytes) -> None:
        """Discard it."""


@cache
def _servo2040(firmware: str) -> Servo2040Board:
    board = Servo2040Board(MockServos(shipped()), PWM, model=firmware)
    board._line.close()
    return board


@target(
    set_frame(0, [1500] * 18) + set_frame(26, [1]),
    get_frame(18, 10),
    get_frame(0, 255),
    words=(b"\xd3\0\x12", b"\xc7\x12\x0a", b"\xd3\x1a\1"),
)
def read_servo2040_board(data: bytes) -> None:
    for firmware in ("stock", "fork"):
        board = _servo2040(firmware)
        board._data.clear()
        board._line = OneRead(data)
        board._serve(0.0)
        board._serve(0.0)
        assert len(board.pulses_us) == N_JOINTS
        powered, angles_rad = board._servo_targets()
        assert powered.shape == angles_rad.shape == (N_JOINTS,)


@target(
    encode_transaction([I2cMessage(0x40, data=b"\0\x21"), I2cMessage(0x40, data=b"\6" + bytes(64))]),
    encode_transaction([I2cMessage(0x41, data=b"\xfe"), I2cMessage(0x41, 1)]),
    encode_transaction([I2cMessage(0, data=b"\6")]),
    words=(b"\x40\0", b"\x41\0", b"\1\0", b"\xfa", b"\xfe"),
)
def read_i2c(data: bytes) -> None:
    """Give transactions to two chips."""
    bus = SimulatedI2c({0x40: SimulatedPca9685(), 0x41: SimulatedPca9685()})
    try:
        messages = decode_transaction(data)
    except struct.error:
        return
    again = [each for each in messages if each.reads or each.data]
    assert decode_transaction(encode_transaction(again)) == again
    try:
        answer = bus.transfer(messages)
    except OSError as error:
        assert error.errno == errno.EREMOTEIO  # noqa: PT017  what is looked for
    else:
        assert len(answer) <= sum(message.reads for message in messages)
    for chip in bus.chips.values():
        assert chip.pulses_us().shape == (16,)
