"""Targets of simulated boards: servos on a bus and servo boards, as programs instruct them."""

import errno
import struct
from collections.abc import Callable, Sequence
from copy import copy
from functools import cache
from typing import Any

import numpy as np

from hexctl.backends.bus.lx16a import LX16A, move_packet
from hexctl.backends.bus.packets import PING, PROTOCOLS, READ, REBOOT, SYNC_READ, SYNC_WRITE, WRITE
from hexctl.backends.bus.registers import table_of
from hexctl.backends.mock import MockServos
from hexctl.backends.pwm.i2c_socket import I2cMessage, decode_transaction, encode_transaction
from hexctl.backends.pwm.servo2040 import get_frame, set_frame
from hexctl.robot.servos.pwm_map import pwm_map_of
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.simulators.board_faults import BusFaults
from hexctl.simulators.bus_board import FAMILIES
from hexctl.simulators.bus_servos import BUS_COUNTS, SimulatedServo, SimulatedServos
from hexctl.simulators.pca9685_board import SimulatedI2c, SimulatedPca9685
from hexctl.simulators.servo2040_board import Servo2040Board
from hexctl.types import N_JOINTS, FloatArray
from tests.backends.bus.boards import MODELS, a_map, stance_counts
from tests.fuzz.target import Target
from tests.robots import shipped


def _instructed(models: Sequence[tuple[str, str]]) -> Callable[[bytes], object]:
    """A reader that gives bytes on a line to simulated servos of the model that the first byte says."""

    def read(data: bytes) -> None:
        if not data:
            return
        family, counts = _fresh(*models[data[0] % len(models)])
        _obeyed(family, data[1:])
        family.show(counts, np.zeros(N_JOINTS))
        assert family.holds().shape == family.goals(1.0).shape == (N_JOINTS,)
        assert np.isfinite(family.goals(1.0)).all()

    return read


@cache
def _made(driver: str, model: str) -> tuple[SimulatedServos, FloatArray, list[dict[str, Any]]]:
    """Servos, the counts at which they stand, and their state at first."""
    bus_map = a_map(driver, model)
    counts = stance_counts(bus_map)
    family = FAMILIES[driver](bus_map, counts, BusFaults(), dict.fromkeys(BUS_COUNTS, 0))
    return family, counts, [_state(servo) for servo in family.servos]


def _state(servo: SimulatedServo) -> dict[str, Any]:
    return {name: copy(value) for name, value in vars(servo).items()}


def _fresh(driver: str, model: str) -> tuple[SimulatedServos, FloatArray]:
    """Servos as they are at first, and the counts at which they stand; to make new ones takes longer."""
    family, counts, states = _made(driver, model)
    for servo, state in zip(family.servos, states, strict=True):
        vars(servo).update({name: copy(value) for name, value in state.items()})
    return family, counts


def _obeyed(family: SimulatedServos, data: bytes) -> None:
    now_s = 0.0
    while True:
        packet, done = family.packets.take(data)
        data = data[done:]
        if packet is None:
            return
        now_s += 0.02
        for answer in family.obey(*packet, now_s):
            found, _ = family.packets.take(answer)
            assert found is not None


def _instructions(data: bytes) -> bytes:
    """Packets with good sums of an input: model, then id, instruction, size and parameters of each."""
    model = MODELS[data[0] % len(MODELS)][1]
    packets = PROTOCOLS[table_of(model).protocol]
    return data[:1] + _packed(data[1:], packets.instruction)


def _packed(data: bytes, instruction: Callable[[int, int, bytes], bytes], most: int = 240) -> bytes:
    whole = b""
    while len(data) >= 3:
        size = min(data[2], most)
        whole += instruction(data[0], data[1], data[3 : 3 + size])
        data = data[3 + size :]
    return whole


REGISTERS = _instructed(MODELS)
LX16AS = _instructed((("lx16a", "lx16a"),))


def _register_instructions(data: bytes) -> None:
    if data:
        REGISTERS(_instructions(data))


def _lx16a_instructions(data: bytes) -> None:
    LX16AS(b"\0" + _packed(data, LX16A.instruction, most=4))


class OneRead:
    """A line of a board on which an input comes once, in two parts."""

    path = "/dev/fuzz"

    def __init__(self, data: bytes) -> None:
        self._parts = [data[: len(data) // 2], data[len(data) // 2 :]]

    def receive(self, timeout_s: float) -> bytes:
        """The next part."""
        return self._parts.pop(0) if self._parts else b""

    def send(self, data: bytes) -> None:
        """Nobody listens."""


@cache
def _servo2040(firmware: str) -> Servo2040Board:
    board = Servo2040Board(MockServos(shipped()), pwm_map_of(ServosSection(), "servo2040"), firmware=firmware)
    board._line.close()
    return board


def _servo2040_frames(data: bytes) -> None:
    for firmware in ("stock", "fork"):
        board = _servo2040(firmware)
        board._data.clear()
        board._line = OneRead(data)  # type: ignore[assignment]
        board._serve(0.0)
        board._serve(0.0)
        assert len(board.pulses_us) == N_JOINTS
        powered, angles_rad = board._servo_targets()
        assert powered.shape == angles_rad.shape == (N_JOINTS,)


def _i2c(data: bytes) -> None:
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


def _wanted(*each: tuple[int, int, bytes]) -> bytes:
    return b"".join(bytes([servo_id, code, len(data)]) + data for servo_id, code, data in each)


ONE = _wanted(
    (1, PING, b""),
    (1, READ, bytes([36, 2])),
    (1, WRITE, bytes([24, 1])),
    (254, PING, b""),
    (1, REBOOT, b""),
    (254, SYNC_WRITE, bytes([30, 2, 1, 0, 2, 2, 1, 2])),
    (254, WRITE, bytes([3, 9])),
)
TWO = _wanted(
    (1, PING, b""),
    (1, READ, b"\x84\0\4\0"),
    (1, WRITE, b"\x40\0\1"),
    (254, SYNC_READ, b"\x84\0\4\0\1\2\3"),
    (254, SYNC_WRITE, b"\x74\0\4\0\1\0\2\0\0"),
    (2, WRITE, b"\x0b\0\3"),
)

TARGETS = (
    Target(
        name="register-board",
        read=_register_instructions,
        seeds=tuple(
            bytes([number]) + (ONE if table_of(model).protocol == 1 else TWO)
            for number, (_, model) in enumerate(MODELS)
        ),
        words=(b"\2", b"\3", b"\x82", b"\x83", b"\xfe"),
        most_bytes=300,
    ),
    Target(
        name="register-line",
        read=REGISTERS,
        seeds=(_instructions(b"\0" + ONE), _instructions(b"\2" + TWO), _instructions(b"\4" + ONE)),
        words=(b"\xff\xff", b"\xff\xff\xfd\0"),
        most_bytes=400,
    ),
    Target(
        name="lx16a-board",
        read=_lx16a_instructions,
        seeds=(
            _wanted(
                (1, 28, b""), (1, 20, b"\0\0\xe8\3"), (1, 21, b""), (1, 1, b"\xf4\1\0\1"), (1, 31, b"\1")
            ),
            _wanted((254, 14, b""), (1, 13, b"\5"), (5, 27, b""), (254, 31, b"\0"), (2, 26, b"")),
        ),
        words=(b"\x14\4", b"\x15\0", b"\xfe"),
        most_bytes=200,
    ),
    Target(
        name="lx16a-line",
        read=lambda data: LX16AS(b"\0" + data),
        seeds=(move_packet(1, 500, 100), LX16A.instruction(1, 28), LX16A.instruction(1, 20, b"\0\0\xe8\3")),
        words=(b"\x55\x55",),
        most_bytes=200,
    ),
    Target(
        name="servo2040-board",
        read=_servo2040_frames,
        seeds=(set_frame(0, [1500] * 18) + set_frame(26, [1]), get_frame(18, 10), get_frame(0, 255)),
        words=(b"\xd3\0\x12", b"\xc7\x12\x0a", b"\xd3\x1a\1"),
        most_bytes=300,
    ),
    Target(
        name="i2c",
        read=_i2c,
        seeds=(
            encode_transaction([I2cMessage(0x40, data=b"\0\x21"), I2cMessage(0x40, data=b"\6" + bytes(64))]),
            encode_transaction([I2cMessage(0x41, data=b"\xfe"), I2cMessage(0x41, 1)]),
            encode_transaction([I2cMessage(0, data=b"\6")]),
        ),
        words=(b"\x40\0", b"\x41\0", b"\1\0", b"\xfa", b"\xfe"),
        most_bytes=300,
    ),
)
