"""Two PCA9685 boards on a simulated I2C bus, which move a simulated robot.

Their chips have the registers, sleep, auto-increment and resets of the data sheet.
"""

import contextlib
import errno
import struct
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.i2c_socket import I2cMessage, decode_transaction
from hexctl.backends.pwm.pca9685 import (
    CHANNELS,
    EXTERNAL,
    FULL,
    INCREMENT,
    MODE1,
    MODE2,
    PCA9685_CHANNELS,
    PRESCALE,
    RESTART,
    SLEEP,
    settings_of,
)
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.simulators.board_faults import BoardFault
from hexctl.simulators.simulated_board import SimulatedPulseBoard, SocketLine
from hexctl.types import BoolArray, FloatArray, RobotState

#: Default speed of the bus in bits per second.
BITS_PER_S = 400_000

#: Bits on the wire of a byte, with its acknowledge.
BITS = 9

#: What each word of a fault takes.
PCA9685_FAULTS = {"nack": "[:SHARE]", "unplug": "", "replug": "", "reset": ""}

#: Registers that the driver does not use, and the bit of MODE1 that lets a chip answer to all-call.
ALL_CALL, ALL_CHANNELS, ANSWERS_ALL = 0x05, 0xFA, 0x01

#: Registers of channels end here; auto-increment continues with the first register.
LAST_CHANNEL = 0x45

#: Registers that differ from 0 after a loss of power, besides the channels, which are all off.
AT_FIRST = {MODE1: 0x11, MODE2: 0x04, 0x02: 0xE2, 0x03: 0xE4, 0x04: 0xE8, ALL_CALL: 0xE0, PRESCALE: 0x1E}

#: Address of a reset by software, and the byte that does it.
GENERAL_CALL, SOFTWARE_RESET = 0x00, b"\x06"


class SimulatedPca9685:
    """One chip; `oscillator_mhz` is the true frequency."""

    def __init__(self, oscillator_mhz: float = 25.0) -> None:
        self._oscillator_mhz, self._pointer = oscillator_mhz, 0
        self.registers = bytearray(256)
        self.reset()

    def reset(self) -> None:
        """Restart after a loss of power: asleep, all channels off."""
        self.registers[:] = bytes(256)
        for register, value in AT_FIRST.items():
            self.registers[register] = value
        for channel in range(PCA9685_CHANNELS):
            self.registers[CHANNELS + 4 * channel + 3] = FULL
        self._pointer = 0

    @property
    def all_call(self) -> int | None:
        """Its all-call address, or None."""
        return self.registers[ALL_CALL] >> 1 if self.registers[MODE1] & ANSWERS_ALL else None

    def write(self, data: bytes) -> None:
        """Execute a message: the first byte is a register."""
        if data:
            self._pointer = data[0]
        for value in data[1:]:
            self._set(self._pointer, value)
            self._advance()

    def read(self, count: int) -> bytes:
        """Bytes from the last written register on."""
        data = bytearray()
        for _ in range(count):
            data.append(self.registers[self._pointer])
            self._advance()
        return bytes(data)

    def pulses_us(self) -> FloatArray:
        """Output pulses, (16,) in us; 0 for channels switched off, NaN for those always on."""
        pulses = np.zeros(PCA9685_CHANNELS)
        if self.registers[MODE1] & (SLEEP | RESTART):
            return pulses
        count_us = (self.registers[PRESCALE] + 1) / self._oscillator_mhz
        for channel in range(PCA9685_CHANNELS):
            first = CHANNELS + 4 * channel
            on_low, on_high, off_low, off_high = self.registers[first : first + 4]
            if not off_high & FULL:
                counts = (off_low + 256 * off_high - on_low - 256 * on_high) % 4096
                pulses[channel] = np.nan if on_high & FULL else counts * count_us
        return pulses

    def _set(self, register: int, value: int) -> None:
        if register == MODE1:
            self._set_mode(value)
        elif register == PRESCALE:
            if self.registers[MODE1] & SLEEP:  # else it is blocked
                self.registers[PRESCALE] = max(3, value)
        elif ALL_CHANNELS <= register < PRESCALE:
            for channel in range(PCA9685_CHANNELS):
                self.registers[CHANNELS + 4 * channel + register - ALL_CHANNELS] = value
        elif register <= LAST_CHANNEL:
            self.registers[register] = value
            if register >= CHANNELS and not self.registers[MODE1] & SLEEP:
                self.registers[MODE1] &= ~RESTART & 0xFF

    def _set_mode(self, value: int) -> None:
        before = self.registers[MODE1]
        external = (before | value) & EXTERNAL  # only a reset ends it
        restart = before & RESTART & ~value  # writing a 1 ends it
        if value & SLEEP and not before & SLEEP and self.pulses_us().any():
            restart = RESTART
        self.registers[MODE1] = restart | external | value & ~(RESTART | EXTERNAL)

    def _advance(self) -> None:
        if self.registers[MODE1] & INCREMENT:
            self._pointer = 0 if self._pointer in (LAST_CHANNEL, PRESCALE) else (self._pointer + 1) & 0xFF


class SimulatedI2c:
    """A bus with some chips."""

    def __init__(self, chips: Mapping[int, SimulatedPca9685]) -> None:
        self.chips = dict(chips)

    def transfer(self, messages: Sequence[I2cMessage]) -> bytes:
        """Read bytes; raises OSError for an address without a chip."""
        answer = b""
        for message in messages:
            if message.address == GENERAL_CALL and message.data == SOFTWARE_RESET:
                for chip in self.chips.values():
                    chip.reset()
                continue
            called = [chip for own, chip in self.chips.items() if message.address in (own, chip.all_call)]
            if not called:
                raise OSError(errno.EREMOTEIO, "Remote I/O error")
            if message.reads:
                answer += called[0].read(message.reads)
            else:
                for chip in called:
                    chip.write(message.data)
        return answer


class Pca9685Board(SimulatedPulseBoard):
    """Boards on a Unix socket, as there are no pseudo-devices for I2C; `seed` draws failed transfers."""

    what, kinds, counted = "bus", PCA9685_FAULTS, ("transfers", "goals", "refused")
    usual_baud = BITS_PER_S

    def __init__(self, servos: LegServos, pwm_map: PwmMap, **options: Any) -> None:
        super().__init__(servos, pwm_map, **options)
        self._settings = settings_of(pwm_map)
        parts = zip(self._settings.addresses, self._settings.oscillators_mhz, strict=True)
        self.chips = {address: SimulatedPca9685(oscillator_mhz) for address, oscillator_mhz in parts}
        self._bus = SimulatedI2c(self.chips)
        self._nacks = 0.0

    def _opened(self) -> SocketLine:
        return SocketLine("i2c")

    def pulses_us(self) -> FloatArray:
        """Pulses of the joints, (18,); 0 for servos without."""
        outputs = np.concatenate([self.chips[each].pulses_us() for each in self._settings.addresses])
        pulses: FloatArray = np.nan_to_num(outputs)[self._map.outputs]
        return pulses

    def _serve(self, timeout_s: float) -> None:
        for client, data in self._line.receive(timeout_s):
            with contextlib.suppress(OSError):  # a disconnected client misses its answer
                client.send(self._answer(data))

    def _answer(self, data: bytes) -> bytes:
        """Answer to a transaction: 0 and the bytes read, or an error number."""
        try:
            messages = decode_transaction(data)
        except struct.error:
            return bytes([errno.EINVAL])
        count = sum(1 + len(message.data) + message.reads for message in messages)
        self._time.sleep(BITS * count / self._baud)
        self.counts["transfers"] += 1
        if self._unplugged or self._random.random() < self._nacks:
            self.counts["refused"] += 1
            return bytes([errno.EREMOTEIO])
        try:
            answer = self._bus.transfer(messages)
        except OSError as error:
            self.counts["refused"] += 1
            return bytes([error.errno or errno.EIO])
        self.counts["goals"] += any(len(message.data) > 2 for message in messages)
        return b"\0" + answer

    def _begin(self, fault: BoardFault) -> None:
        if fault.kind == "nack":
            self._nacks = 1.0 if fault.value is None else fault.value
        else:  # reset
            for chip in self.chips.values():
                chip.reset()

    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        pulses = self.pulses_us()
        return pulses > 0, self._map.angles_rad(pulses)

    def _measure(self, state: RobotState) -> None:
        """Nothing is measured."""
