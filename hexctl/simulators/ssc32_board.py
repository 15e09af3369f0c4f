"""A Lynxmotion SSC-32 or SSC-32U on a pseudo-terminal, written from its guides.

Its line has a speed: bytes take their time, and a controller at another baud rate is not understood.
"""

import re
from typing import Any

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.pwm.pwm_map import PwmMap
from hexctl.simulators.board_faults import BoardFault
from hexctl.simulators.simulated_board import SimulatedPulseBoard, baud_of
from hexctl.types import BoolArray, FloatArray, RobotState

#: What each word of a fault takes.
SSC32_FAULTS = {"mute": "", "unplug": "", "replug": "", "garble": "SHARE", "torn": "SHARE", "reset": ""}

#: Firmware of each model, as it reports itself, and whether it has binary commands.
FIRMWARES = {"ssc32u": ("SSC32-V2.50USB", True), "ssc32": ("SSC32-1.06XE", False)}

CHANNELS, LEAST_US, MOST_US = 32, 500, 2500

#: Speed of its line, and the time before it answers, by the guide 0.05 to 5 ms, typically 0.1 ms.
BAUD, HESITATES_S = 115_200, 0.0001

MOVE = re.compile(r"#(\d+)P(\d+)(?:S(\d+))?")
MOVES = re.compile(rf"(?:{MOVE.pattern})+(?:T(\d+))?")
QUERIES = re.compile(r"(?:QP(\d+))+")


class SimulatedSsc32:
    """The board's commands and moves, on a clock in s; `is_binary` lets it obey binary commands."""

    def __init__(self, firmware: str, *, is_binary: bool) -> None:
        self._firmware, self._is_binary = firmware, is_binary
        self.garbage = 0
        self.reset()

    def reset(self) -> None:
        """Begin as after a loss of power: no pulses."""
        self._from, self._to = np.zeros(CHANNELS), np.zeros(CHANNELS)
        self._begin_s, self._lasts_s = np.zeros(CHANNELS), np.zeros(CHANNELS)
        self._text, self._binary = b"", b""
        self._staged: dict[int, tuple[int, int]] = {}  # pulse and speed by channel

    def pulses_us(self, now_s: float) -> FloatArray:
        """Pulses of all channels, (32,); 0 for none."""
        with np.errstate(divide="ignore", invalid="ignore"):
            share = np.where(self._lasts_s > 0, (now_s - self._begin_s) / self._lasts_s, 1.0)
        made: FloatArray = self._from + np.clip(share, 0, 1) * (self._to - self._from)
        return made

    def feed(self, data: bytes, now_s: float) -> bytes:
        """Execute bytes; the result is what it answers."""
        answer = b""
        for byte in data:
            if self._binary or (byte >= 0x80 and self._is_binary and not self._text):
                self._binary += bytes([byte])
                if len(self._binary) == 3:
                    command, high, low = self._binary
                    self._obey_binary(command, high << 8 | low, now_s)
                    self._binary = b""
            elif byte == 0x0D:
                line = self._text.decode("latin-1").upper()
                self._text = b""
                answer += self._obey("".join(line.split()), now_s)
            else:
                self._text = (self._text + bytes([byte]))[-400:]
        return answer

    def _obey_binary(self, command: int, value: int, now_s: float) -> None:
        if command < 0xA0:
            self._staged[command - 0x80] = (value, 0)
        elif command == 0xA0 and self._staged:
            last = next(reversed(self._staged))
            self._staged[last] = (self._staged[last][0], value)
        elif command == 0xA1:
            self._move(self._staged, value, now_s)
            self._staged = {}

    def _obey(self, line: str, now_s: float) -> bytes:
        if line == "VER":
            return self._firmware.encode() + b"\r"
        if line == "Q":
            return b"+" if (now_s < self._begin_s + self._lasts_s).any() else b"."
        if QUERIES.fullmatch(line):
            channels = [int(text) for text in line.split("QP")[1:]]
            pulses = self.pulses_us(now_s)
            return bytes(int(pulses[channel]) // 10 for channel in channels if channel < CHANNELS)
        if found := MOVES.fullmatch(line):
            moves = {int(each[1]): (int(each[2]), int(each[3] or 0)) for each in MOVE.finditer(line)}
            self._move(moves, int(found.groups()[-1] or 0), now_s)
        elif line:
            self.garbage += 1
        return b""

    def _move(self, moves: dict[int, tuple[int, int]], time_ms: int, now_s: float) -> None:
        before = self.pulses_us(now_s)
        for channel, (pulse, speed) in moves.items():
            if channel >= CHANNELS:
                continue
            target = min(max(pulse, LEAST_US), MOST_US) if pulse else 0
            known = before[channel] > 0 and target > 0
            far_s = abs(target - before[channel]) / speed if speed else 0.0
            self._from[channel], self._to[channel] = before[channel] if known else target, target
            self._begin_s[channel] = now_s
            self._lasts_s[channel] = max(time_ms / 1000, far_s) if known else 0.0


class Ssc32Board(SimulatedPulseBoard):
    """An SSC-32 on a line, which moves simulated joints."""

    kinds, models, usual_baud = SSC32_FAULTS, tuple(FIRMWARES), BAUD
    counted = ("goals", "answers", "torn", "garbage")

    def __init__(self, servos: LegServos, pwm_map: PwmMap, **options: Any) -> None:
        super().__init__(servos, pwm_map, **options)
        firmware, is_binary = FIRMWARES[self._model or self.models[0]]
        self.board = SimulatedSsc32(firmware, is_binary=is_binary)

    def pulses_us(self) -> FloatArray:
        """Pulses of the joints, (18,); 0 for servos without."""
        made: FloatArray = self.board.pulses_us(self._time.now())[self._map.outputs]
        return made

    def _serve(self, timeout_s: float) -> None:
        data = self._line.receive(timeout_s)
        if not data or self._unplugged:
            return
        self._time.sleep(10 * len(data) / self._baud)
        if baud_of(self._line) not in (None, self._baud):
            data = self._random.randbytes(len(data))
        if self._random.random() < self._tears:
            self.counts["torn"] += 1
            data = data[: self._random.randrange(len(data))]
        self.counts["goals"] += b"\xa1" in data or b"#" in data
        answer = self.board.feed(data, self._time.now())
        self.counts["garbage"] = self.board.garbage
        if answer and not self._mute:
            self.counts["answers"] += 1
            if self._random.random() < self._garbles:
                answer = self._random.randbytes(self._random.randrange(len(answer) + 1))
            self._time.sleep(HESITATES_S + 10 * len(answer) / self._baud)
            self._line.send(answer)

    def _begin(self, fault: BoardFault) -> None:
        super()._begin(fault)
        if fault.kind == "reset":
            self.board.reset()

    def _servo_targets(self) -> tuple[BoolArray, FloatArray]:
        pulses = self.pulses_us()
        return pulses > 0, self._map.angles_rad(pulses)

    def _measure(self, state: RobotState) -> None:
        """Nothing is measured."""
