"""Targets on a serial line to servos: packets, and what a controller makes of their answers."""

from collections.abc import Callable
from contextlib import suppress
from functools import cache
from typing import Any

import numpy as np

from hexctl.backends.bus.lx16a import ANSWER_BYTES, LX16A
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.packets import BROADCAST, PROTOCOLS, PacketFormat, PacketStream
from hexctl.backends.bus.registers import table_of
from hexctl.backends.bus.servo_bus import BusCounters
from hexctl.backends.bus.tools import bus_of, servo_with
from hexctl.backends.pwm.servo2040 import NEVER_US, Servo2040, decoded, encoded, find_reply
from hexctl.errors import RobotFaultError
from hexctl.robot.servos.bus_map import BusMap
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.time_source import WALL_TIME
from hexctl.types import N_JOINTS
from tests.backends.bus.boards import MODELS, a_map
from tests.fuzz.target import Target

FIRST = np.arange(N_JOINTS) == 0

#: Time on the wire by which every wait is over at once.
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
        """Answer of the length that was asked for, where that is known."""
        if packets is LX16A:
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


def _stream(packets: PacketFormat) -> Callable[[bytes], object]:
    """A reader that feeds a stream in two parts, and round trips a packet of the input's first bytes."""

    def read(data: bytes) -> None:
        stream = PacketStream(packets)
        middle = len(data) // 2
        whole = [*stream.feed(data[:middle]), *stream.feed(data[middle:]), *stream.finish()]
        assert 0 <= stream.garbled <= len(data)
        for packet in whole:
            assert 0 <= packet.servo_id <= 255
        if len(data) < 3:
            return
        most = 4 if packets is LX16A else 200
        servo_id, error, parameters = data[0] % 0xFD, data[1], data[2 : 2 + most]
        again = PacketStream(packets)
        found = again.feed(b"\0" + packets.status(servo_id, error, parameters))
        assert [(one.servo_id, one.error, one.parameters) for one in found] == [(servo_id, error, parameters)]

    return read


@cache
def _map(driver: str, model: str) -> BusMap:
    return a_map(driver, model)


def _registers(data: bytes) -> None:
    """Let a servo of some model answer, and look at it as a bus and a person do."""
    if not data:
        return
    driver, model = MODELS[data[0] % len(MODELS)]
    table = table_of(model)
    packets = PROTOCOLS[table.protocol]
    line: Any = FuzzedLine(data[1:], packets)
    with suppress(RobotFaultError):
        if data[0] & 0x80:
            servo = servo_with(
                PacketLine(line, packets, timeout_s=0.0, adapts=False), driver, table.protocol, 1
            )
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
            bus.servos[0].model_number()
            for report in bus.poll():
                assert np.isfinite(report.position)


def _lx16a(data: bytes) -> None:
    """Let an LX-16A answer, and look at it as a bus and a person do."""
    line: Any = FuzzedLine(data[1:], LX16A)
    with suppress(RobotFaultError):
        if sum(data[:1]) & 0x80:
            servo = servo_with(PacketLine(line, LX16A, timeout_s=0.0, adapts=False), "lx16a", 1, 1)
            str(servo.look().to_json())
            servo.limits()
        else:
            bus = bus_of(_map("lx16a", "lx16a"), line, BusCounters())
            bus.settings(FIRST)
            bus.torque(0)
            bus.poll()


def _table(data: bytes) -> None:
    """Read the report of every model from the same bytes, and write its numbers back."""
    for _, model in MODELS:
        table = table_of(model)
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


PWM = pwm_map_of(ServosSection(), "servo2040")


def _servo2040(data: bytes) -> None:
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
    assert NEVER_US


def _said(*answers: bytes) -> bytes:
    """Answers as `FuzzedLine` reads them: good ones."""
    return b"".join(bytes([2, len(one)]) + one for one in answers)


#: A servo2040 that tells its voltage, and all that is asked for.
REPLIES = b"\0\x05\xc7\x1e\1\x10\x10" + b"\0\x13\xc7\x18\x08" + bytes(16)

TARGETS = (
    Target(
        name="packets-1",
        read=_stream(PROTOCOLS[1]),
        seeds=(PROTOCOLS[1].status(1, 0, b"\1\2"), PROTOCOLS[1].instruction(254, 0x83, bytes(20))),
        words=(b"\xff\xff", b"\xff\xff\1\2"),
        most_bytes=400,
    ),
    Target(
        name="packets-2",
        read=_stream(PROTOCOLS[2]),
        seeds=(PROTOCOLS[2].status(1, 0, b"\1\2"), PROTOCOLS[2].status(2, 128, b"\xff\xff\xfd" * 3)),
        words=(b"\xff\xff\xfd\0", b"\xff\xff\xfd\xfd"),
        most_bytes=700,
    ),
    Target(
        name="packets-lx16a",
        read=_stream(LX16A),
        seeds=(LX16A.status(1, 28, b"\1\2"), LX16A.instruction(3, 1, bytes(4))),
        words=(b"\x55\x55", b"\x55\x55\1\3"),
        most_bytes=200,
    ),
    Target(
        name="register-servo",
        read=_registers,
        seeds=tuple(
            bytes([which | side]) + _said(*(bytes([number]) * size for number in range(1, 20)))
            for which in range(len(MODELS))
            for side in (0, 0x80)
            for size in (1, 2)
        ),
        words=(b"\2\1", b"\2\2", b"\5\1"),
        most_bytes=500,
    ),
    Target(
        name="lx16a-servo",
        read=_lx16a,
        seeds=tuple(
            side + _said(*(bytes([number]) * size for number in range(1, 20)))
            for side in (b"\0", b"\x80")
            for size in (1, 2, 4)
        ),
        words=(b"\2\1", b"\2\2", b"\2\4"),
        most_bytes=300,
    ),
    Target(name="register-table", read=_table, seeds=(bytes(range(30)), b"\xff" * 30), most_bytes=40),
    Target(
        name="servo2040",
        read=_servo2040,
        seeds=(REPLIES, b"\1\2\3"),
        words=(b"\xc7\x1e\1", b"\xc7\x18"),
        most_bytes=200,
    ),
)
