"""Lynxmotion's SSC-32 and SSC-32U: pulses in whole microseconds, by text or by binary commands; no watchdog.

    #channelPpulse ... CR           servos of a line move together; pulse 0 ends a pulse
    80+channel high low ... A1 0 0  the same in binary, which newer firmware has; A1 and a time in ms commit
    QPchannel CR                    answered by the pulse in tens of a microsecond, one byte; 0 without
    VER CR                          answered by a line that begins with SSC32

Nothing has a checksum, so an answer counts if it is expected, or repeats. Sources: Lynxmotion's SSC-32U
Electronics Guide and SSC-32 Binary Commands.
"""

from collections.abc import Mapping

import numpy as np

from hexctl.backends.bus.serial_line import SerialLine
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.pwm.pulse_board import PulseBoard
from hexctl.backends.pwm.pwm_map import BoardSettings, PwmMap
from hexctl.backends.pwm.serial_board import SerialPwmServos, fits, gather, serial_port_parser, too_slow
from hexctl.backends.pwm.servos import BoardReport
from hexctl.errors import RobotFaultError
from hexctl.types import N_JOINTS, BoolArray, FloatArray

#: First byte of a binary pulse, and the byte before its time in ms.
PULSE, COMMIT = 0x80, 0xA1

#: Outputs, and the shortest and longest pulse.
OUTPUTS, PULSES_US = 32, (500.0, 2500.0)

#: Microseconds in a count of an answer; one count is no difference.
US_PER_COUNT = 10

#: How long an answer may take, beyond the guide's 5 ms, and how often a question is repeated.
REPLY_S, SLOWEST_S, TRIES = 0.02, 0.005, 4

#: Looks in a row at pulses that were not sent, after which the board does not obey.
STRANGE = 10

#: How often the pulses are looked at on a line that has no time for it in every control period.
LOOK_S = 0.1

#: Speed of the usual line; new boards have 9600 baud.
BAUD = 115_200

#: Bytes of eighteen pulses in binary, and the most in text.
BINARY_BYTES, TEXT_BYTES = 3 * N_JOINTS + 3, 8 * N_JOINTS + 1


def text_move(pulses: Mapping[int, int]) -> bytes:
    """Text command of pulses in us by channel; 0 ends a pulse."""
    return "".join(f"#{channel}P{pulse}" for channel, pulse in pulses.items()).encode() + b"\r"


def binary_move(pulses: Mapping[int, int]) -> bytes:
    """Binary command of pulses in us by channel; 0 ends a pulse."""
    moves = b"".join(bytes([PULSE + channel, *divmod(pulse, 256)]) for channel, pulse in pulses.items())
    return moves + bytes([COMMIT, 0, 0])


class Ssc32:
    """The board on an open line, used by one thread; raises RobotFaultError without its firmware.

    Attributes:
        firmware: as the board reports it.
        is_binary: whether poses are sent in binary; None before that is known.
    """

    def __init__(self, line: SerialLine, pwm_map: PwmMap) -> None:
        self._line, self._channels = line, pwm_map.outputs.tolist()
        self.firmware = self._identify()
        self.is_binary: bool | None = None
        self._sent = np.array([self._surely(channel) for channel in self._channels])  # in us, 0 for none
        self._heard_s = self._asked_s = line.time.now()
        self._looked_at = 0
        self._fault: str | None = None
        self._strange, self._limp = 0, True
        in_time = line.wire_s(TEXT_BYTES if fits(TEXT_BYTES, line.baud) else BINARY_BYTES) + SLOWEST_S
        self._look_s = 0.0 if in_time < PERIOD_S else LOOK_S

    def commanded_us(self) -> FloatArray:
        """Pulses of each joint, (18,), that the board makes, to 10 us, NaN for none."""
        return np.where(self._sent > 0, self._sent.astype(float), np.nan)

    def begin(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send pulses, at first in binary, to see whether the firmware has it."""
        if self.is_binary is None:
            self._choose(pulses_us, on)
        self.write(pulses_us, on)

    def write(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Send the pulses of all joints, (18,), unless the board has lost the last ones; 0 ends a pulse."""
        if self._line.time.now() - self._asked_s >= self._look_s:
            self._look()
        if self._fault is None:
            self._sent = np.where(on, np.rint(np.nan_to_num(pulses_us)), 0).astype(int)
            pulses = dict(zip(self._channels, self._sent.tolist(), strict=True))
            self._line.write(binary_move(pulses) if self.is_binary else text_move(pulses))

    def end(self) -> None:
        """Let all servos go limp."""
        self._line.write(text_move(dict.fromkeys(self._channels, 0)))
        self._sent, self._fault, self.is_binary = np.zeros(N_JOINTS, dtype=int), None, None
        self._strange, self._limp = 0, True

    def poll(self) -> BoardReport | None:
        """Whether the board still makes its pulses; None without an answer."""
        if self._line.time.now() - self._asked_s >= LOOK_S and not self._look():
            return None
        return BoardReport(at_s=self._heard_s, fault=self._fault, limp=self._limp)

    def close(self) -> None:
        """Close the line; the board repeats the last pulses."""
        self._line.close()

    def _choose(self, pulses_us: FloatArray, on: BoolArray) -> None:
        """Choose binary or text by the first pulse; servos that hold already do not show what was obeyed."""
        in_time = fits(TEXT_BYTES, self._line.baud)
        self.is_binary = not in_time
        if self._sent.any():
            return
        joints = np.flatnonzero(on).tolist()
        pulses = {self._channels[joint]: round(float(pulses_us[joint])) for joint in joints}
        self._line.write(binary_move(pulses) + b"\r")  # it ends the line of a firmware that took it for text
        made = self._surely(self._channels[joints[0]])
        self.is_binary = made > 0
        if not (self.is_binary or in_time):
            self._fault = (
                f"the firmware {self.firmware} has no binary commands, and text is too slow at "
                f"{too_slow(TEXT_BYTES, self._line.baud)}"
            )
        elif self.is_binary:
            self._sent[joints] = [*pulses.values()]

    def _look(self) -> bool:
        """Compare the pulse of one joint after another with what was sent; whether there was an answer."""
        joint = self._looked_at = (self._looked_at + 1) % N_JOINTS
        self._asked_s = self._line.time.now()
        made: list[int] = []
        for _ in range(TRIES - 1):
            pulse = self._pulse(self._channels[joint])
            if pulse is None:
                return False
            self._heard_s = self._line.time.now()
            sent = int(self._sent[joint])
            if (pulse > 0) == (sent > 0) and abs(pulse - sent) <= US_PER_COUNT:
                self._strange = 0
                return True
            made.append(pulse)
        if len(set(made)) == 1 and self._fault is None:
            self._doubt(self._channels[joint], made[0])
        return True

    def _doubt(self, channel: int, pulse: int) -> None:
        """Judge a pulse that was not sent: all are off after a loss of power, a few poses may get lost."""
        self._strange += 1
        powered = np.flatnonzero(self._sent)
        if pulse == 0 and powered.size and self._surely(self._channels[powered[0]]) == 0:
            self._fault = "the SSC-32 has switched its servos off, as after a loss of power"
        elif self._strange >= STRANGE:
            self._fault = f"the SSC-32 makes {pulse} us at channel {channel}: does something else command it?"
            self._limp = False

    def _identify(self) -> str:
        """Firmware of the board."""
        garbled = 0
        for _ in range(TRIES):
            self._line.discard()
            self._line.write(b"VER\r")
            deadline_s, data = self._line.time.now() + 3 * REPLY_S + self._line.wire_s(40), b""
            while b"\r" not in data and (more := self._line.read(deadline_s)):
                data += more
            start = data.find(b"SSC32")
            if start >= 0 and b"\r" in data:
                return data[start:].partition(b"\r")[0].decode("ascii", "replace")
            garbled += len(data)
        damaged = f" ({garbled} bytes came, none of them an answer)" if garbled else ""
        raise RobotFaultError(
            f"no SSC-32 answers on {self._line.path} at {self._line.baud} baud{damaged}; is it the board's "
            "port and speed? New boards have 9600 baud: hold the button, and press it for 115200"
        )

    def _pulse(self, channel: int) -> int | None:
        """Pulse of a channel in us, or None without an answer."""
        self._line.discard()
        self._line.write(f"QP{channel}\r".encode())
        answer = gather(self._line, 1, REPLY_S)
        return US_PER_COUNT * answer[0] if answer else None

    def _surely(self, channel: int) -> int:
        """Pulse of a channel in us by two equal answers in a row, because servos will follow it."""
        before = None
        for _ in range(2 * TRIES):
            now = self._pulse(channel)
            if now is not None and now == before:
                return now
            before = now
        raise TimeoutError(f"the SSC-32 does not report its channel {channel}")


class Ssc32Servos(SerialPwmServos):
    """Eighteen hobby servos on an SSC-32 at a serial device."""

    usual_baud = BAUD

    def _pose_bytes(self) -> int:
        return BINARY_BYTES

    def _board(self, line: SerialLine) -> Ssc32:
        return Ssc32(line, self._map)


SSC32 = PulseBoard(
    name="ssc32",
    servos=Ssc32Servos,
    settings=lambda _: BoardSettings(outputs=OUTPUTS, pulses_us=PULSES_US),
    parse_port=serial_port_parser("the serial device of the SSC-32, such as /dev/ttyUSB0:38400", BAUD),
    has_keeper=True,
    simulated="hexctl.simulators.ssc32_board:Ssc32Board",
)
