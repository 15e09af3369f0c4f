"""Pimoroni's servo2040 with the Chica firmware: 18 pulses, six touch inputs, current, voltage and a relay.

Only command bytes have bit 7 set; values are 14 bits in two bytes, low bits first.

    SET: D3 start count (lo7 hi7)*count, no reply
    GET: C7 start count, answered by the same three bytes and (lo7 hi7)*count

The fork github.com/olli-io/hexapod-servo2040-driver appends a checksum to replies, the XOR with bit 7 set,
gives current and voltage in hundredths, and switches itself off at an overcurrent.
"""

from collections.abc import Sequence

import numpy as np

from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.pwm.pulse_board import PulseBoard
from hexctl.backends.pwm.pwm_map import BoardSettings, PwmMap
from hexctl.backends.pwm.serial_board import SerialPwmServos
from hexctl.backends.pwm.servos import BoardReport
from hexctl.backends.serial_ports import SerialAddress
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.types import N_JOINTS, N_LEGS, BoolArray, FloatArray

SET, GET = 0xD3, 0xC7

#: Indices of the protocol.
TOUCH, CURRENT, VOLTAGE, RELAY, STATUS = 18, 24, 25, 26, 27

MOST_VALUE = (1 << 14) - 1

#: Counts per volt of the original firmware, and its current: amperes per count, from a count of no current.
COUNTS_PER_V, AMPERES_PER_COUNT, NO_CURRENT = 310.3, 0.0814, 512

#: Counts per volt and ampere of the fork.
FORK_COUNTS = 100.0

#: A touch input at half of its 3.3 V; the inputs are pulled down.
TOUCHED, MOST_TOUCH = 512, 1100

#: How long a reply may take, and how long the checksum of the fork may be behind the rest of it.
REPLY_TIMEOUT_S, CHECKSUM_S = 0.05, 0.02

#: How often a board is asked before it is taken for mute.
TRIES = 4

#: Any speed does for a device on USB.
BAUD = 115_200

#: Shortest and longest pulse; the firmware clips others.
PULSES_US = (500.0, 2500.0)

#: Touch inputs of the legs: the firmware's L1, L2, L3, then R3, R2, R1.
USUAL_TOUCHES = (0, 1, 2, 5, 4, 3)

#: Pulse of a servo before its first command.
UNUSED_US = (0, 1500)


def set_frame(start: int, values: Sequence[int]) -> bytes:
    """Frame that sets consecutive values."""
    return bytes([SET, start, len(values)]) + encoded(values)


def get_frame(start: int, count: int) -> bytes:
    """Frame that asks for consecutive values."""
    return bytes([GET, start, count])


def encoded(values: Sequence[int]) -> bytes:
    """Values 0 to 16383, two bytes each."""
    return bytes(byte for value in values for byte in (value & 0x7F, value >> 7 & 0x7F))


def decoded(data: bytes) -> list[int]:
    """Values of bytes without bit 7, two each."""
    return [low | high << 7 for low, high in zip(data[::2], data[1::2], strict=True)]


def checksum(data: bytes) -> int:
    """Checksum of the fork's reply."""
    total = 0
    for byte in data:
        total ^= byte
    return total | 0x80


def find_reply(data: bytes, start: int, count: int, *, checked: bool) -> list[int] | None:
    """Values of a complete reply from index `start`, or None; `checked` expects a checksum."""
    head, size = get_frame(start, count), 3 + 2 * count
    at = data.find(head)
    while at >= 0:
        frame, behind = data[at : at + size], data[at + size : at + size + 1]
        whole = len(frame) == size and max(frame[3:], default=0) < 0x80
        if whole and (not checked or behind == bytes([checksum(frame)])):
            return decoded(frame[3:])
        at = data.find(head, at + 1)
    return None


class Servo2040:
    """The board on an open line, used by one thread; raises RobotFaultError without its firmware."""

    def __init__(self, line: SerialLine, pwm_map: PwmMap) -> None:
        self._line, self._map = line, pwm_map
        self._voltages: list[float] = []
        self.fork = self._is_fork()
        self._asked = N_LEGS + 2  # touch, current, voltage
        if self.fork and self._ask(TOUCH, N_LEGS + 4, tries=TRIES) is not None:
            self._asked = N_LEGS + 4  # relay and status besides
        if self._asked > N_LEGS + 2 and self._tripped() is not None:
            self.end()

    def commanded_us(self) -> FloatArray:
        """Last commanded pulses of each joint, (18,); NaN for a board just switched on.

        Raises TimeoutError for a board without an answer.
        """
        values = self._ask(0, N_JOINTS, tries=TRIES)
        if values is None:
            raise TimeoutError("the board does not report its pulses")
        if any(len(set(values)) == 1 and never in values for never in UNUSED_US):
            return np.full(N_JOINTS, np.nan)
        pulses = np.array(values, dtype=float)[self._map.outputs]
        return np.where(pulses > 0, pulses, np.nan)

    def begin(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Stage a complete pose, then switch the relay on: servos without a pulse would turn to 1500 us.

        The relay switches all servos on; waiting ones are off again within a pulse or two.
        """
        self.write(pulses_us, np.ones(N_JOINTS, dtype=bool))
        self._line.write(set_frame(RELAY, [1]))
        if not on.all():
            self.write(pulses_us, on)

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send the pulses of all joints, (18,), in one frame; 0 switches a servo off."""
        ordered = np.empty(N_JOINTS)
        ordered[self._map.outputs] = np.where(on, np.clip(np.rint(pulses_us), *PULSES_US), 0)
        self._line.write(set_frame(0, ordered.astype(int).tolist()))

    def end(self) -> None:
        """Switch the relay and all pulses off."""
        self._line.write(set_frame(RELAY, [0]))

    def poll(self) -> BoardReport | None:
        """Contacts, current, voltage and fault; None without a complete answer."""
        values = self._ask(TOUCH, self._asked)
        if values is None or max(values[:N_LEGS]) > MOST_TOUCH:
            return None
        current, voltage = values[CURRENT - TOUCH], values[VOLTAGE - TOUCH]
        volts = voltage / (FORK_COUNTS if self.fork else COUNTS_PER_V)
        self._voltages = [*self._voltages[-2:], volts]  # the original has no checksum: one may be wrong
        status = values[STATUS - TOUCH] if self._asked > N_LEGS + 2 else 0
        return BoardReport(
            at_s=self._line.time.now(),
            contacts=np.array(values[:N_LEGS])[self._map.touches] > TOUCHED,
            voltage_v=float(np.median(self._voltages)),
            current_a=current / FORK_COUNTS if self.fork else (current - NO_CURRENT) * AMPERES_PER_COUNT,
            fault=_trip(status),
        )

    def close(self) -> None:
        """Close the line; the board repeats the last pulses."""
        self._line.close()

    def _tripped(self) -> str | None:
        values = self._ask(STATUS, 1, tries=TRIES)
        return None if values is None else _trip(values[0])

    def _is_fork(self) -> bool:
        """Whether a checksum ends the reply to a request for the voltage."""
        request, garbled = get_frame(VOLTAGE, 1), 0
        for _ in range(TRIES):
            self._line.discard()
            self._line.write(request)
            data = self._gather(VOLTAGE, 1, checked=False)
            if find_reply(data, VOLTAGE, 1, checked=False) is None:
                garbled += len(data)
                continue
            data += self._line.read(self._line.time.now() + CHECKSUM_S)
            return find_reply(data, VOLTAGE, 1, checked=True) is not None
        damaged = f" ({garbled} bytes came, none of them an answer)" if garbled else ""
        raise RobotFaultError(
            f"no servo2040 answers on {self._line.path}{damaged}; is it the board's port, and does the board "
            "have the Chica firmware?"
        )

    def _ask(self, start: int, count: int, *, tries: int = 1) -> list[int] | None:
        for _ in range(tries):
            self._line.discard()
            self._line.write(get_frame(start, count))
            data = self._gather(start, count, checked=self.fork)
            values = find_reply(data, start, count, checked=self.fork)
            if values is not None:
                return values
        return None

    def _gather(self, start: int, count: int, *, checked: bool) -> bytes:
        deadline_s, data = self._line.time.now() + REPLY_TIMEOUT_S, b""
        while find_reply(data, start, count, checked=checked) is None:
            more = self._line.read(deadline_s)
            if not more:
                break
            data += more
        return data


class Servo2040Servos(SerialPwmServos):
    """Eighteen hobby servos on a servo2040 at a serial device, with foot contacts."""

    usual_baud = BAUD

    def _board(self, line: SerialLine) -> Servo2040:
        return Servo2040(line, self._map)


def parse_servo2040_port(text: str | None, _baud: int | None = None) -> str:
    """Serial device of a text such as `/dev/ttyACM0`; raises InputError without one, and with a baud rate."""
    allowed = (
        "the serial device of the servo2040 without a baud rate, such as /dev/ttyACM0, here or as `port` in "
        "the section `servos` of the robot file"
    )
    address = SerialAddress.parse(text, allowed=allowed)
    if address.baud:
        raise InputError(f"{argument('port')}: got {text!r}; allowed: {allowed}")
    return address.path


def _trip(status: int) -> str | None:
    """Fault of the fork's status word: bit 0, and the current in tenths of an ampere in bits 1 to 10."""
    if not status & 1:
        return None
    return f"the board has switched its servos off at {(status >> 1 & 0x3FF) * 0.1:.1f} A"


SERVO2040 = PulseBoard(
    name="servo2040",
    servos=Servo2040Servos,
    settings=lambda _: BoardSettings(
        outputs=N_JOINTS, pulses_us=PULSES_US, touch_inputs=N_LEGS, usual_touches=USUAL_TOUCHES
    ),
    parse_port=parse_servo2040_port,
    has_keeper=False,
    simulated="hexctl.simulators.servo2040_board:Servo2040Board",
)
