"""Two PCA9685 boards on an I2C bus: sixteen pulses each, without feedback, without a watchdog.

Registers (NXP data sheet, Rev. 4): MODE1 is 00, MODE2 01, channel n has four bytes from 06 + 4 n (ON and OFF,
low bits first, 12 bits each; bit 4 of the last one switches it off), the prescaler FE, writable only in
sleep: a period takes 4096 (prescale + 1) oscillator cycles. Outputs change together at the end of a message.
After a loss of power MODE1 is 11: asleep, all channels off.
"""

import errno
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from hexctl.backends.board_lock import BoardLock
from hexctl.backends.port_thread import reason_of
from hexctl.backends.pwm.i2c_socket import I2cSocket
from hexctl.backends.pwm.pulse_board import PulseBoard
from hexctl.backends.pwm.pwm_map import BoardSettings, PwmMap
from hexctl.backends.pwm.servos import BoardReport, BoardThread, PwmServos
from hexctl.errors import InputError, MissingExtraError, RobotFaultError, argument
from hexctl.time_source import WALL_TIME, TimeSource
from hexctl.types import N_JOINTS, BoolArray, FloatArray

MODE1, MODE2, CHANNELS, PRESCALE = 0x00, 0x01, 0x06, 0xFE

#: Bits of MODE1: channels wait for a restart, external clock, auto-increment, sleep.
#:
#: Of MODE2: push-pull.
RESTART, EXTERNAL, INCREMENT, SLEEP = 0x80, 0x40, 0x20, 0x10
DRIVEN = 0x04

#: Bits of MODE1 and MODE2 that must be as they were set; others are of no concern, as the flag of a restart.
MODE1_MASK, MODE2_MASK = EXTERNAL | INCREMENT | SLEEP, 0x1C

#: Bit of the last byte of a channel that switches it off, and of the second one that switches it on for good.
FULL = 0x10

#: Channels of a board, and bytes of a channel.
PCA9685_CHANNELS, WIDTH = 16, 4

COUNTS = 4096

#: Pulses in a second.
PULSES_HZ = 50.0

#: Time that the oscillator takes to start after sleep.
STARTS_S = 0.0005

#: Number of attempts for a transfer without acknowledgement, and for a register with a wrong value.
TRIES = 3

#: Seconds without an acknowledgement after which a board is lost; until then transfers are repeated. At 10 %
#: loss one in a thousand fails three times, and a robot makes hundreds per second.
SILENCE_S = 0.1

#: Pulses that no servo has were not meant for one.
PLAUSIBLE_US = (100.0, 5000.0)


@dataclass(frozen=True, kw_only=True)
class Pca9685Settings(BoardSettings):
    """I2C addresses of two boards, and their oscillators in MHz; output 16 is the first of the second one."""

    outputs: int = 2 * PCA9685_CHANNELS
    addresses: tuple[int, int]
    oscillators_mhz: tuple[float, float]

    def output_name(self, output: int) -> str:
        """Name of an output, with the printed channel."""
        board, channel = divmod(output, PCA9685_CHANNELS)
        return f"output {output}, channel {channel} at {self.addresses[board]:#x}"


def settings_of(pwm_map: PwmMap) -> Pca9685Settings:
    """The settings in a map of these boards."""
    assert isinstance(pwm_map.settings, Pca9685Settings)  # noqa: S101  for the type
    return pwm_map.settings


class I2cBus(Protocol):
    """The used methods of an I2C bus such as `smbus2.SMBus`. Every method may raise OSError."""

    def i2c_rdwr(self, *i2c_msgs: Any) -> None:
        """Transfer messages of `smbus2.i2c_msg` in one transaction."""

    def close(self) -> None:
        """Close the bus."""


def prescale_of(oscillator_mhz: float) -> int:
    """Prescaler for 50 pulses per second."""
    return round(oscillator_mhz * 1e6 / COUNTS / PULSES_HZ) - 1


def channel_bytes(pulse_us: float, count_us: float) -> bytes:
    """Registers of a channel for a pulse from the start of the period, off for NaN; `count_us` per count."""
    if np.isnan(pulse_us):
        return bytes([0, 0, 0, FULL])
    count = min(max(round(pulse_us / count_us), 1), COUNTS - 1)
    return bytes([0, 0, count & 0xFF, count >> 8])


def pulse_of(channel: Sequence[int], count_us: float) -> float:
    """Pulse in us of a channel's registers; NaN if it is no servo pulse."""
    on, off = channel[0] | channel[1] << 8, channel[2] | channel[3] << 8
    if (on | off) & FULL << 8:
        return float("nan")
    pulse_us = ((off - on) % COUNTS) * count_us
    return pulse_us if PLAUSIBLE_US[0] <= pulse_us <= PLAUSIBLE_US[1] else float("nan")


class Pca9685Chip:
    """One board with some used `channels`; those between them keep their pulses."""

    def __init__(
        self, bus: I2cBus, address: int, oscillator_mhz: float, channels: Sequence[int], time: TimeSource
    ) -> None:
        self._bus, self.address, self._oscillator_mhz, self._time = bus, address, oscillator_mhz, time
        self._first, self._last = min(channels), max(channels)
        self._prescale = prescale_of(oscillator_mhz)
        self._count_us = (self._prescale + 1) / oscillator_mhz
        self._image = bytearray(channel_bytes(float("nan"), 1.0) * PCA9685_CHANNELS)

    def learn(self) -> FloatArray:
        """Read the pulses of all channels, (16,) in us, NaN for none; the next `write` keeps them."""
        pulses = np.full(PCA9685_CHANNELS, np.nan)
        if self._read_surely(MODE1) & (SLEEP | RESTART):
            return pulses
        count_us = (self._read_surely(PRESCALE) + 1) / self._oscillator_mhz
        for channel in range(self._first, self._last + 1):
            first = WIDTH * channel
            found = bytes(self._read_surely(CHANNELS + first + byte) for byte in range(WIDTH))
            pulses[channel] = pulse_of(found, count_us)
            self._image[first : first + WIDTH] = found
            if not np.isnan(pulses[channel]) and count_us != self._count_us:
                self.set_pulse(channel, pulses[channel])
        return pulses

    def set_up(self) -> None:
        """Let the board run at 50 Hz; its pulses stop for a millisecond at most.

        Raises RobotFaultError for a board that does not keep its settings.
        """
        self.learn()
        if self.lost() is None and self._read(MODE2) & MODE2_MASK == DRIVEN:
            return
        self._write(MODE1, INCREMENT | SLEEP)
        self._write(PRESCALE, self._prescale)
        self._write(MODE2, DRIVEN)
        self.send()
        self._write(MODE1, INCREMENT)
        self._time.sleep(STARTS_S)
        if self._read(MODE1) & RESTART:  # channels that had pulses when it fell asleep
            self._write(MODE1, INCREMENT | RESTART)
        self.send()
        if (lost := self.lost()) is not None:
            raise RobotFaultError(f"{lost}; is it a PCA9685, and does nothing else use it?")

    def lost(self) -> str | None:
        """Evidence of lost settings, or None; one wrong reading is none."""
        for _ in range(TRIES):
            mode, prescale = self._read(MODE1), self._read(PRESCALE)
            if mode & MODE1_MASK == INCREMENT and prescale == self._prescale:
                return None
        return (
            f"the PCA9685 at {self.address:#x} has lost its settings, as after a loss of power (MODE1 "
            f"{mode:02x}, prescaler {prescale:02x})"
        )

    def set_pulse(self, channel: int, pulse_us: float) -> None:
        """Change the pulse of a channel, NaN for none, at the next `send`."""
        self._image[WIDTH * channel : WIDTH * (channel + 1)] = channel_bytes(pulse_us, self._count_us)

    def send(self) -> None:
        """Send the pulses of all channels in use, in one message."""
        first = WIDTH * self._first
        self._write(CHANNELS + first, *self._image[first : WIDTH * (self._last + 1)])

    def _read(self, register: int) -> int:
        from smbus2 import i2c_msg

        answer = i2c_msg.read(self.address, 1)
        self._transfer(i2c_msg.write(self.address, [register]), answer)
        return bytes(answer)[0]

    def _read_surely(self, register: int) -> int:
        """Byte of two equal reads, because servos will follow it."""
        before = self._read(register)
        for _ in range(TRIES):
            now = self._read(register)
            if now == before:
                return now
            before = now
        raise OSError(errno.EIO, f"readings that differ, board at {self.address:#x}")

    def _write(self, register: int, *values: int) -> None:
        from smbus2 import i2c_msg

        self._transfer(i2c_msg.write(self.address, [register, *values]))

    def _transfer(self, *messages: Any) -> None:
        """Transfer, and retry without an acknowledgement; raises OSError that names the board."""
        for tries in range(TRIES):
            try:
                self._bus.i2c_rdwr(*messages)
                return
            except OSError as error:
                if tries == TRIES - 1:
                    code = error.errno or errno.EIO
                    raise OSError(code, f"{reason_of(error)}, board at {self.address:#x}") from error


class Pca9685:
    """Boards on an open bus, used by one thread.

    Args:
        known: whether the boards should still have their settings; `poll` reports a loss until `end` restores
            them.
        lock: of the boards, released with `close`.

    Raises RobotFaultError for boards that do not keep their settings, OSError if none answers.
    """

    def __init__(
        self,
        bus: I2cBus,
        pwm_map: PwmMap,
        time: TimeSource = WALL_TIME,
        *,
        known: bool = False,
        lock: BoardLock | None = None,
    ) -> None:
        self._bus, self._time, self._lock = bus, time, lock
        boards, channels = np.divmod(pwm_map.outputs, PCA9685_CHANNELS)
        settings = settings_of(pwm_map)
        parts = zip(settings.addresses, settings.oscillators_mhz, strict=True)
        self._chips = {
            board: Pca9685Chip(bus, address, oscillator_mhz, channels[boards == board], time)
            for board, (address, oscillator_mhz) in enumerate(parts)
            if board in boards
        }
        self._places = list(zip(boards.tolist(), channels.tolist(), strict=True))
        self._silent_since_s: dict[int, float] = {}  # by address
        self._unsent: set[int] = set()
        for chip in self._chips.values():
            if not known:
                chip.set_up()
            else:
                chip.lost()  # an answer is enough

    def commanded_us(self) -> FloatArray:
        """Pulses of each joint, (18,), that the boards make, NaN for none."""
        pulses = {board: chip.learn() for board, chip in self._chips.items()}
        return np.array([pulses[board][channel] for board, channel in self._places])

    def begin(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send pulses; no power switch is needed."""
        self.write(pulses_us, on)

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send pulses of each joint, (18,), to the powered servos.

        `poll` repeats messages without an acknowledgement; OSError after `SILENCE_S` of that.
        """
        self._set(pulses_us, on)
        self._each(self._send)

    def end(self) -> None:
        """Let all servos go limp; restores lost settings."""

        def set_up(chip: Pca9685Chip) -> None:
            if chip.lost() is not None:
                chip.set_up()

        self._set(np.full(N_JOINTS, np.nan), np.zeros(N_JOINTS, dtype=bool))
        self._unsent.clear()
        for do in (Pca9685Chip.send, set_up, Pca9685Chip.send):
            self._each(do)

    def poll(self) -> BoardReport | None:
        """Whether the boards keep their settings; None if one did not acknowledge."""
        lost: list[str | None] = []

        def look(chip: Pca9685Chip) -> None:
            lost.append(chip.lost())

        for chip in self._chips.values():
            if not self._answers(chip, look):
                return None
        texts = [text for text in lost if text is not None]
        if not texts:
            self._each(lambda chip: self._send(chip) if chip.address in self._unsent else None)
        fault = f"servos limp: {'; '.join(texts)}" if texts else None
        return BoardReport(at_s=self._time.now(), fault=fault, limp=len(texts) == len(self._chips))

    def _set(self, pulses_us: FloatArray, on: BoolArray) -> None:
        for joint, (board, channel) in enumerate(self._places):
            self._chips[board].set_pulse(channel, pulses_us[joint] if on[joint] else np.nan)

    def _send(self, chip: Pca9685Chip) -> None:
        if self._answers(chip, Pca9685Chip.send):
            self._unsent.discard(chip.address)
        else:
            self._unsent.add(chip.address)

    def _answers(self, chip: Pca9685Chip, do: Callable[[Pca9685Chip], None]) -> bool:
        """Whether the board answered a transfer; raises OSError after `SILENCE_S` of silence."""
        try:
            do(chip)
        except OSError:
            now_s = self._time.now()
            if now_s - self._silent_since_s.setdefault(chip.address, now_s) >= SILENCE_S:
                raise
            return False
        self._silent_since_s.pop(chip.address, None)
        return True

    def close(self) -> None:
        """Close the bus; the boards repeat the last pulses."""
        self._bus.close()
        if self._lock is not None:
            self._lock.release()

    def _each(self, do: Callable[[Pca9685Chip], None]) -> None:
        """Call a function for each board, even after errors."""
        errors = []
        for chip in self._chips.values():
            try:
                do(chip)
            except OSError as error:
                errors.append(error)
        if errors:
            raise errors[0]


class Pca9685Servos(PwmServos):
    """Eighteen hobby servos on two PCA9685 boards.

    `port` is the I2C bus's number, its device, or the socket of simulated boards.
    """

    _known = False

    def _prepared(self) -> BoardThread:
        self._known = False
        thread = super()._prepared()
        self._known = True
        return thread

    def _open(self) -> Pca9685:
        with ExitStack() as opening:
            bus = open_i2c(self._port)
            opening.callback(bus.close)
            lock = lock_boards(self._port, self._map)
            opening.callback(lock.release)
            board = Pca9685(bus, self._map, self._clock.time, known=self._known, lock=lock)
            opening.pop_all()
        return board

    def _gone(self, reason: str) -> str:
        return (
            f"the servo boards on I2C bus {self._port} do not answer ({reason}); are the cables in, have "
            "they power, and are the addresses those of the robot file?"
        )


def open_i2c(port: str) -> I2cBus:
    """Open the I2C bus of a number, a device or the socket of simulated boards.

    Raises MissingExtraError without smbus2, RobotFaultError for a bus that cannot be opened.
    """
    try:
        import smbus2
    except ModuleNotFoundError as error:
        raise MissingExtraError("the backend pca9685", "i2c") from error
    try:
        if Path(port).is_socket():
            return I2cSocket(port)
        bus: I2cBus = smbus2.SMBus(int(port) if port.isdecimal() else port)
    except OSError as error:
        raise RobotFaultError(
            f"the I2C bus {port} cannot be opened ({reason_of(error)}); is I2C enabled, and may you use "
            "it (group i2c)?"
        ) from error
    return bus


def lock_boards(port: str, pwm_map: PwmMap) -> BoardLock:
    """Lock of the used boards of a bus, whatever its name; raises RobotFaultError if a program has one."""
    addresses = settings_of(pwm_map).addresses
    used = [addresses[board] for board in np.unique(pwm_map.outputs // PCA9685_CHANNELS).tolist()]
    device = Path(f"/dev/i2c-{int(port)}" if port.isdecimal() else port).resolve()
    at = " and ".join(f"{address:#x}" for address in used)
    return BoardLock(f"the PCA9685 at {at} on I2C bus {port}", [f"{device} {each}" for each in used])


def parse_i2c_port(text: str | None, _baud: int | None = None) -> str:
    """I2C bus of a text such as `1` or `/dev/i2c-1`; raises InputError without one."""
    if not text or not (text.isdecimal() or "/" in text):
        got = "none" if not text else repr(text)
        raise InputError(
            f"{argument('port')}: got {got}; allowed: the I2C bus of the boards, such as 1 or /dev/i2c-1, "
            "here or as `port` in the section `servos` of the robot file"
        )
    return text


PCA9685 = PulseBoard(
    name="pca9685",
    servos=Pca9685Servos,
    settings=lambda section: Pca9685Settings(
        addresses=section.addresses, oscillators_mhz=section.oscillator_mhz
    ),
    parse_port=parse_i2c_port,
    has_keeper=True,
    simulated="hexctl.simulators.pca9685_board:Pca9685Board",
)
