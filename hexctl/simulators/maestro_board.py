"""A Pololu Maestro on a pseudo-terminal, written from its User's Guide.

Its settings are those that hexctl advises: a serial timeout of 0.40 s, and servos that go off at an error. On
USB its baud rate does not matter; with `baud` it is at a UART, which detects its speed by the first AA.
"""

import math
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.maestro import CHANNELS, crc7, settings_of
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.simulators.board_faults import BoardFault
from hexctl.simulators.simulated_board import SimulatedPulseBoard, baud_of
from hexctl.types import BoolArray, FloatArray, RobotState

#: What each word of a fault takes.
MAESTRO_FAULTS = {
    "mute": "",
    "unplug": "",
    "replug": "",
    "garble": "SHARE",
    "torn": "SHARE",
    "reset": "",
    "no-timeout": "",
    "ignore": "",
    "narrow": "",
    "crc": "",
}

#: Bits of the error register.
SIGNAL, CRC, PROTOCOL, TIMEOUT = 0x01, 0x08, 0x10, 0x20

#: Data bytes of each command; that of several targets has more, by its first one.
DATA_BYTES = {
    0x84: 3,
    0x87: 3,
    0x89: 3,
    0x8A: 4,
    0x90: 1,
    0x93: 0,
    0x9F: 2,
    0xA1: 0,
    0xA2: 0,
    0xA4: 0,
    0xAE: 0,
}

#: Serial timeout in s, and the factory's range of a channel in quarters of a microsecond.
TIMEOUT_S, FACTORY_RANGE = 0.4, (3968, 8000)

#: Range of a channel that is set as wide as the firmware allows.
WIDE = (256, 16_320)

#: Position of an input of a foot on the floor, and of one in the air.
PRESSED, FREE = 1000, 12


class SimulatedMaestro:
    """One board: channels, error register and serial timeout, on a clock in s.

    Attributes:
        targets: of its channels in quarters of a microsecond; 0 without pulses.
        inputs: positions of the channels that are inputs.
        errors: bits of the error register.
        timeout_s: serial timeout; inf without.
        home_off: whether channels go off at an error, or stay as they are.
        range: least and largest target.
    """

    def __init__(self, channels: int, device: int, *, crc: bool) -> None:
        self.channels, self.device, self.crc = channels, device, crc
        self.inputs: dict[int, int] = {}
        self.timeout_s, self.home_off, self.range = TIMEOUT_S, True, WIDE
        self.start(0.0)

    def start(self, now_s: float) -> None:
        """Begin as after a loss of power."""
        self.targets = np.zeros(self.channels, dtype=int)
        self.errors, self._heard_s = 0, now_s
        self._packet = bytearray()

    def fail(self, error: int) -> None:
        """Set an error; all channels go home."""
        self.errors |= error
        if self.home_off:
            self.targets[:] = 0

    def pass_time(self, now_s: float) -> bool:
        """Whether a serial timeout is over now; its silence begins again with it."""
        if now_s - self._heard_s <= self.timeout_s:
            return False
        self._heard_s = now_s
        self.fail(TIMEOUT)
        return True

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Execute bytes; the result is what it answers."""
        self.pass_time(now_s)
        answer = b""
        for byte in data:
            if byte & 0x80:
                if self._packet:
                    self.fail(PROTOCOL)
                self._packet = bytearray([byte])
            elif self._packet:
                self._packet.append(byte)
            if self._packet and (command := self._complete()) is not None:
                self._packet = bytearray()
                answer += self._execute(command, now_s)
        return answer

    def _complete(self) -> bytes | None:
        """Command and data of a complete packet, empty for another board's; None while bytes are missing."""
        packet = bytes(self._packet)
        head = 3 if packet[0] == 0xAA else 1
        if len(packet) < head:
            return None
        command = packet[head - 1] | 0x80
        data = packet[head:]
        count = DATA_BYTES.get(command, 0)
        if command == 0x9F and data:
            count += 2 * data[0]
        if len(data) < count + self.crc:
            return None
        if command not in DATA_BYTES:
            self.fail(PROTOCOL)
            return b""
        if self.crc and crc7(packet[:-1]) != packet[-1]:
            self.fail(CRC)
            return b""
        if head == 3 and packet[1] != self.device:
            return b""
        return bytes([command]) + data[:count]

    def _execute(self, packet: bytes, now_s: float) -> bytes:
        if not packet:
            return b""
        command, data = packet[0], packet[1:]
        first, count = (data[1], data[0]) if command == 0x9F else (data[0] if data else 0, 1)
        several = command == 0x9F and self.channels == CHANNELS["micro6"]
        if several or (command in (0x84, 0x87, 0x89, 0x90, 0x9F) and first + count > self.channels):
            self.fail(PROTOCOL)
            return b""
        self._heard_s = now_s
        if command in (0x84, 0x9F):
            values = data[2:] if command == 0x9F else data[1:]
            for place, (low, high) in enumerate(zip(values[::2], values[1::2], strict=True), first):
                self._set(place, low | high << 7)
        elif command == 0x90:
            return int(self.inputs.get(first, self.targets[first])).to_bytes(2, "little")
        elif command == 0xA1:
            errors, self.errors = self.errors, 0
            return errors.to_bytes(2, "little")
        elif command == 0xA2 and self.home_off:
            self.targets[:] = 0
        return b"\0" if command in (0x93, 0xAE) else b""

    def _set(self, channel: int, target: int) -> None:
        if channel not in self.inputs:
            self.targets[channel] = np.clip(target, *self.range) if target else 0


class MaestroBoard(SimulatedPulseBoard):
    """Maestros on a line, which move simulated joints; the model of the robot file by default."""

    kinds, models, usual_baud = MAESTRO_FAULTS, tuple(CHANNELS), 0
    counted = ("goals", "answers", "torn", "errors", "timeouts")

    def __init__(self, servos: LegServos, pwm_map: PwmMap, **options: Any) -> None:
        super().__init__(servos, pwm_map, **options)
        self._settings = settings_of(pwm_map)
        channels = self._settings.channels if self._model is None else CHANNELS[self._model]
        self.boards = [
            SimulatedMaestro(channels, 12 if device is None else device, crc=self._settings.crc)
            for device in self._settings.devices
        ]
        for touch in pwm_map.touches[pwm_map.touched].tolist():
            self._show(touch, FREE)
        self._detected = not self._baud

    def pulses_us(self) -> FloatArray:
        """Pulses of the joints, (18,); 0 for servos without."""
        self._pass_time()
        outputs = np.concatenate([board.targets for board in self.boards])
        pulses: FloatArray = outputs[np.minimum(self._map.outputs, len(outputs) - 1)] / 4
        return pulses

    def _serve(self, timeout_s: float) -> None:
        data = self._line.receive(timeout_s)
        if not data or self._unplugged:
            return
        if self._random.random() < self._tears:
            self.counts["torn"] += 1
            data = data[: self._random.randrange(len(data))]
        if self._baud and baud_of(self._line) not in (None, self._baud):
            for board in self.boards:
                board.fail(SIGNAL)
            return
        if not self._detected:
            _, found, data = data.partition(b"\xaa")
            self._detected = bool(found)
        self._pass_time()
        before = [board.errors for board in self.boards]
        now_s = self._time.now()
        answer = b"".join(board.feed(bytes([byte]), now_s) for byte in data for board in self.boards)
        pairs = zip(self.boards, before, strict=True)
        self.counts["errors"] += any(board.errors & ~old for board, old in pairs)
        self.counts["goals"] += any(byte in data for byte in (0x84, 0x9F)) or data[2:3] in (b"\x04", b"\x1f")
        if answer and not self._mute:
            self.counts["answers"] += 1
            if self._random.random() < self._garbles:
                place = self._random.randrange(len(answer))
                answer = answer[:place] + self._random.randbytes(self._random.randrange(3))
            self._line.send(answer)

    def _pass_time(self) -> None:
        for board in self.boards:
            self.counts["timeouts"] += board.pass_time(self._time.now())

    def _begin(self, fault: BoardFault) -> None:
        super()._begin(fault)
        for board in self.boards:
            if fault.kind == "reset":
                board.start(self._time.now())
            elif fault.kind == "no-timeout":
                board.timeout_s = math.inf
            elif fault.kind == "ignore":
                board.home_off = False
            elif fault.kind == "narrow":
                board.range = FACTORY_RANGE
            elif fault.kind == "crc":
                board.crc = not board.crc

    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        pulses = self.pulses_us()
        return pulses > 0, self._map.angles_rad(pulses)

    def _measure(self, state: RobotState) -> None:
        if state.foot_contacts is None:
            return
        for touch, pressed in zip(self._map.touches.tolist(), state.foot_contacts.tolist(), strict=True):
            if touch >= 0:
                self._show(touch, PRESSED if pressed else FREE)

    def _show(self, touch: int, position: int) -> None:
        board, channel = divmod(touch, self._settings.channels)
        if channel < self.boards[board].channels:
            self.boards[board].inputs[channel] = position
