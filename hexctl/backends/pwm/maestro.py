"""Pololu's Maestro: pulses in quarters of a microsecond, inputs, and a serial timeout that ends the pulses.

Only command bytes have bit 7 set (User's Guide, section 5); values of 14 bits are sent low bits first.

    84 channel lo7 hi7               target; 0 ends the pulses
    9F count first (lo7 hi7)*count   targets of consecutive channels; not on the Micro
    87, 89 channel lo7 hi7           limits of speed and acceleration; 0 for none
    90 channel                       answered by the position, or the voltage of an input, low byte first
    A1                               answered by the errors, low byte first, which clears them
    AA device command-80 ...         a command for one of several boards on a wire

With CRC a CRC-7 follows each command. Each new error sends all channels home, as set in Maestro Control
Center: off, to a position, or unchanged. Silence for the serial timeout is such an error.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Literal

import numpy as np
from pydantic import Field

from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.pwm.pulse_board import PulseBoard
from hexctl.backends.pwm.pwm_map import BoardSettings, PwmMap
from hexctl.backends.pwm.serial_board import SerialPwmServos, gather, serial_port_parser
from hexctl.backends.pwm.servos import BoardReport
from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.configs import Whole, file_part
from hexctl.robot.servos.raw_map import IntPerJoint
from hexctl.robot.servos.servo_schema import ServosSection
from hexctl.types import N_JOINTS, BoolArray, FloatArray

TARGET, TARGETS, SPEED, ACCELERATION, POSITION, ERRORS = 0x84, 0x9F, 0x87, 0x89, 0x90, 0xA1

#: First byte of a command for one board, and the factory's number of a board.
POLOLU, USUAL_DEVICE = 0xAA, 12

#: Names of the errors, by bit.
SERIAL_ERRORS = ("signal error", "overrun", "buffer full", "CRC error", "protocol error", "timeout")
ERROR_NAMES = (*(f"serial {name}" for name in SERIAL_ERRORS), *3 * ("script error",))
TIMEOUT = 1 << ERROR_NAMES.index("serial timeout")

#: Channels by model; a Micro has no command for several.
CHANNELS = {"mini24": 24, "mini18": 18, "mini12": 12, "micro6": 6}

#: Units of a target in a microsecond.
PER_US = 4

#: An input above half of its 5 V is that of a foot on the floor.
TOUCHED, MOST_INPUT = 512, 1023

#: How long an answer may take, how often a board is asked, the usual speed, and looks that show a limit.
REPLY_S, TRIES, BAUD, SEEN = 0.02, 4, 115_200, 3

#: Serial timeout that is tested at the start, and by how much longer hexctl is silent for it.
TESTED_S, MARGIN_S = 0.5, 0.05


@file_part("servos.board")
class MaestroKeys:
    """Keys in `servos: board:`; `devices` are the numbers of boards on one wire, in order of outputs."""

    model: Literal["mini24", "mini18", "mini12", "micro6"] = "mini24"
    devices: tuple[Annotated[Whole, Field(ge=0, le=127)], ...] = ()
    crc: bool = False


@dataclass(frozen=True, kw_only=True)
class MaestroSettings(BoardSettings):
    """Boards on a wire: their device numbers, None for a single one; channels of each; whether with CRC."""

    devices: tuple[int | None, ...]
    channels: int
    crc: bool

    @classmethod
    def of(cls, section: ServosSection) -> "MaestroSettings":
        """Settings of a section; raises InputError."""
        keys = MaestroKeys(**section.board)
        devices, channels = keys.devices or (None,), CHANNELS[keys.model]
        if len(set(devices)) < len(devices):
            raise InputError(f"servos.board.devices: got {list(devices)}; allowed: each number once")
        count = channels * len(devices)
        if count < N_JOINTS:
            raise InputError(
                f"servos.board: got {len(devices)} {keys.model}, with {count} outputs; allowed: at least "
                f"{N_JOINTS}, as of boards with the device numbers devices: [12, 13]"
            )
        return cls(
            outputs=count,
            pulses_us=(64.0, 4080.0),
            touch_inputs=count,
            devices=devices,
            channels=channels,
            crc=keys.crc,
        )

    def output_name(self, output: int) -> str:
        """Name of an output, with its board if there are several."""
        board, channel = divmod(output, self.channels)
        return f"channel {channel}" + (f" of device {self.devices[board]}" if len(self.devices) > 1 else "")

    def command(self, board: int, command: int, *data: int) -> bytes:
        """Bytes of a command for a board, by its place in `devices`."""
        device = self.devices[board]
        head = (command,) if device is None else (POLOLU, device, command & 0x7F)
        packet = bytes([*head, *data])
        return packet + bytes([crc7(packet)]) if self.crc else packet

    def pose(self, outputs: Sequence[int], quarters: Sequence[int]) -> bytes:
        """Commands that set targets of ascending outputs."""
        packets, at = b"", 0
        while at < len(outputs):
            board, first = divmod(outputs[at], self.channels)
            end = at + 1
            while self.channels != CHANNELS["micro6"] and end < len(outputs):
                if outputs[end] != outputs[end - 1] + 1 or outputs[end] // self.channels != board:
                    break
                end += 1
            values = [byte for each in quarters[at:end] for byte in (each & 0x7F, each >> 7 & 0x7F)]
            head = (TARGET, first) if end == at + 1 else (TARGETS, end - at, first)
            packets += self.command(board, *head, *values)
            at = end
        return packets


def crc7(data: bytes) -> int:
    """CRC-7 of a command (section 5.d): polynomial 0x91, lowest bit first."""
    crc = 0
    for byte in data:
        crc ^= byte
        for _ in range(8):
            crc = (crc ^ 0x91 if crc & 1 else crc) >> 1
    return crc


def settings_of(pwm_map: PwmMap) -> MaestroSettings:
    """The settings in a map of these boards."""
    assert isinstance(pwm_map.settings, MaestroSettings)  # noqa: S101  for the type
    return pwm_map.settings


class Maestro:
    """The boards on an open line, used by one thread; raises RobotFaultError unless all answer.

    Attributes:
        notes: what a person should know of its settings.
    """

    def __init__(self, line: SerialLine, pwm_map: PwmMap) -> None:
        self._line, self._map, self._settings = line, pwm_map, settings_of(pwm_map)
        self._order = np.argsort(pwm_map.outputs)
        boards = range(len(self._settings.devices))
        self._error_questions = [self._settings.command(board, ERRORS) for board in boards]
        self._sent = np.zeros(N_JOINTS, dtype=np.int64)  # in quarters of a microsecond
        self._looked_at = 0
        self._fault: str | None = None
        self._limited = [0] * N_JOINTS  # looks in a row at pulses that were not as sent
        self.notes: list[str] = []
        self._errors_at_first = self._identify()
        self._lift_limits()
        self._sent = self._positions()

    def test_timeout(self) -> str | None:
        """Be silent for longer than the serial timeout may last; what to tell a person of it, or None.

        Servos that hold are not let go, unless the board has been in its timeout already.
        """
        if self._sent.any() and not self._errors_at_first & TIMEOUT:
            return "the serial timeout of the Maestro was not tested, because its servos have pulses"
        self._line.time.sleep(TESTED_S + MARGIN_S)
        errors = self._ask(self._error_questions, tries=TRIES)
        self._sent = self._positions()
        if errors is not None and all(each & TIMEOUT for each in errors):
            return None
        return (
            f"the Maestro has no serial timeout of {TESTED_S:g} s or less: servos keep their pulses if this "
            'computer dies; set "Timeout" to 0.40 s, "On startup or error" to Off in Maestro Control Center'
        )

    def commanded_us(self) -> FloatArray:
        """Pulses of each joint, (18,), that the boards make, NaN for none."""
        return np.where(self._sent > 0, self._sent / PER_US, np.nan)

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send the pulses of all joints, (18,), unless the boards have lost the last ones; 0 ends a pulse.

        Eighteen servos that start together would break down their supply again.
        """
        joint = self._looked_at = (self._looked_at + 1) % N_JOINTS
        made = self._ask([self._position(int(self._map.outputs[joint]))])
        if made is not None and made[0] != self._sent[joint]:
            self._inspect()
        if self._fault is None:
            self._send(np.where(on, np.rint(PER_US * np.nan_to_num(pulses_us)), 0))

    begin = write  # no power switch is needed

    def end(self) -> None:
        """Let all servos go limp; restores what a loss of power has changed."""
        self._lift_limits()
        self._send(np.zeros(N_JOINTS))
        self._ask(self._error_questions)
        self._fault = None

    def poll(self) -> BoardReport | None:
        """Errors, contacts, and whether a joint still has its pulse; None without an answer."""
        questions, joint = self._error_questions, self._looked_at
        touches = self._map.touches[self._map.touched].tolist()
        places = [*touches, int(self._map.outputs[joint])]
        answers = self._ask([*questions, *map(self._position, places)])
        if answers is None or max(answers[:-1]) > MOST_INPUT:  # no error has a higher bit either
            return None
        errors = int(np.bitwise_or.reduce(answers[: len(questions)]))
        warnings: tuple[str, ...] | None = ()
        if self._fault is None and (errors or answers[-1] != self._sent[joint]):
            warnings = self._inspect(errors)
        if warnings is None:
            return None
        return BoardReport(
            at_s=self._line.time.now(),
            contacts=np.array(answers[len(questions) : -1]) > TOUCHED if touches else None,
            fault=self._fault,
            warnings=(*self.notes, *warnings),
        )

    def close(self) -> None:
        """Close the line; the boards repeat the last pulses until their serial timeout."""
        self._line.close()

    def _channel(self, output: int, command: int, *data: int) -> bytes:
        """Command for the channel of an output or input."""
        board, channel = divmod(output, self._settings.channels)
        return self._settings.command(board, command, channel, *data)

    def _position(self, place: int) -> bytes:
        return self._channel(place, POSITION)

    def _identify(self) -> int:
        """Errors of all boards.

        A board that waits for the speed of its line takes it from the first AA; to others the bytes are a
        question for device 12.
        """
        errors, rouse = 0, replace(self._settings, devices=(USUAL_DEVICE,)).command(0, ERRORS)
        for board, device in enumerate(self._settings.devices):
            question, garbled = self._settings.command(board, ERRORS), 0
            for packet in (question, rouse if device is None else question, question, question):
                self._line.discard()
                self._line.write(packet)
                data = gather(self._line, 2, REPLY_S)
                if len(data) == 2 and data[1] < 2:
                    errors |= data[0] | data[1] << 8
                    break
                garbled += len(data)
            else:
                who = "no Maestro" if device is None else f"no Maestro with device number {device}"
                damaged = f" ({garbled} bytes came, none of them an answer)" if garbled else ""
                raise RobotFaultError(
                    f"{who} answers on {self._line.path}{damaged}; is it the command port, at the board's "
                    "baud rate, and is `crc` under `servos: board:` as set in the board?"
                )
        return errors

    def _lift_limits(self) -> None:
        """Let pulses follow immediately: limits of speed and acceleration would delay a pose."""
        for command in (SPEED, ACCELERATION):
            for output in self._map.outputs.tolist():
                self._line.write(self._channel(output, command, 0, 0))

    def _positions(self) -> IntPerJoint:
        """Positions of all joints; raises RobotFaultError for a channel that the board does not have."""
        places = [*self._map.outputs.tolist(), *self._map.touches[self._map.touched].tolist()]
        values = self._ask([self._position(place) for place in places], tries=TRIES)
        if values is not None:
            return np.array(values[:N_JOINTS], dtype=np.int64)
        silent = next((place for place in places if not self._ask([self._position(place)])), places[0])
        raise RobotFaultError(
            f"the Maestro does not report its {self._settings.output_name(silent)}; has it that one, and is "
            "`model` under `servos: board:` right?"
        )

    def _inspect(self, errors: int = 0) -> tuple[str, ...] | None:
        """Look at all pulses, for a fault if channels went home; warnings, or None without an answer."""
        boards = len(self._error_questions)
        answers = self._ask([*self._error_questions, *map(self._position, self._map.outputs.tolist())])
        if answers is None:
            return None
        errors |= int(np.bitwise_or.reduce(answers[:boards]))
        names = [name for bit, name in enumerate(ERROR_NAMES) if errors >> bit & 1]
        differ = (found := np.array(answers[boards:])) != self._sent
        if differ.any() and (errors or not found[self._sent > 0].any()):
            why = f"after a {' and a '.join(names)}" if names else "as after a loss of power or a bad line"
            self._fault = f"the Maestro has switched its servos off, {why}"
            return ()
        if not differ.any():
            return tuple(f"the Maestro reports a {name}" for name in names)
        joint = self._looked_at
        self._send(self._sent)  # a pose may get lost; a limit stays
        made = self._ask([self._position(int(self._map.outputs[joint]))])
        self._limited[joint] = 0 if made in (None, [self._sent[joint]]) else self._limited[joint] + 1
        name = self._map.servo_name(joint)
        note = f"the Maestro limits pulses of {name}; set its Min and Max in Control Center"
        if self._limited[joint] == SEEN and note not in self.notes:  # that of an earlier connection
            self.notes.append(note)
        return ()

    def _send(self, quarters: FloatArray | IntPerJoint) -> None:
        self._sent = quarters.astype(np.int64)
        outputs, values = self._map.outputs[self._order], self._sent[self._order]
        self._line.write(self._settings.pose(outputs.tolist(), values.tolist()))

    def _ask(self, questions: Sequence[bytes], *, tries: int = 1) -> list[int] | None:
        for _ in range(tries):
            self._line.discard()
            self._line.write(b"".join(questions))
            data = gather(self._line, 2 * len(questions), REPLY_S)
            if len(data) == 2 * len(questions):
                return [low | high << 8 for low, high in zip(data[::2], data[1::2], strict=True)]
        return None


class MaestroServos(SerialPwmServos):
    """Eighteen hobby servos on Maestros at a serial device, with foot contacts by their inputs."""

    usual_baud = BAUD
    _notes: list[str] | None = None

    def _pose_bytes(self) -> int:
        return len(settings_of(self._map).pose(sorted(self._map.outputs.tolist()), [0] * N_JOINTS))

    def _board(self, line: SerialLine) -> Maestro:
        board = Maestro(line, self._map)
        if self._notes is None:
            doubt = board.test_timeout()
            self._notes = [] if doubt is None else [doubt]
        board.notes = self._notes
        return board


MAESTRO = PulseBoard(
    name="maestro",
    servos=MaestroServos,
    settings=MaestroSettings.of,
    has_keys=True,
    parse_port=serial_port_parser("the serial device of the Maestro, such as /dev/ttyACM0", BAUD),
    has_keeper=True,
    has_watchdog=True,
    simulated="hexctl.simulators.maestro_board:MaestroBoard",
)
