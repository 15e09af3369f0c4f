"""A bus of LewanSoul (Hiwonder) servos, which report no model: LX-16A, LX-224, HTS-35H.

Numbers are little-endian. Writes are not answered; an answer repeats its command, which has no parameters
(LewanSoul Bus Servo Communication Protocol).

At 115200 baud a move takes 0.9 ms and a reading 1.2 ms: not all fit into 20 ms. At most `MOST_MOVES` moves
per period go to changed goals, the longest waiting first. The remaining time is used for positions, one by
one.
"""

from collections.abc import Callable, Mapping, Sequence
from typing import Any, ClassVar

import numpy as np

from hexctl.backends.bus.family import Family
from hexctl.backends.bus.packet_line import TIMEOUT_TIMES, PacketLine
from hexctl.backends.bus.packets import PacketFormat, SumPackets
from hexctl.backends.bus.servo import NO_GAIN, OFFSET, TRIES, ScannedServo, Servo, ServoSettings
from hexctl.backends.bus.servo_bus import BusCounters, Report, ServoBus
from hexctl.backends.bus.servo_type import ServoType
from hexctl.types import BoolArray, FloatArray

#: Commands that write.
MOVE, WRITE_ID, WRITE_LIMITS, WRITE_MODE, WRITE_LOAD = 1, 13, 20, 29, 31

#: Parameters of each command that writes.
WRITE_BYTES = {MOVE: 4, WRITE_ID: 1, WRITE_LIMITS: 4, WRITE_MODE: 4, WRITE_LOAD: 1}

#: Commands that ask.
READ_ID, READ_OFFSET, READ_LIMITS, READ_VOLTAGE_LIMITS, READ_MOST_TEMPERATURE = 14, 19, 21, 23, 25
READ_TEMPERATURE, READ_VOLTAGE, READ_POSITION, READ_MODE, READ_LOAD = 26, 27, 28, 30, 32

#: Parameters in the answer to each command that asks.
ANSWER_BYTES = {
    READ_ID: 1,
    READ_OFFSET: 1,
    READ_LIMITS: 4,
    READ_VOLTAGE_LIMITS: 4,
    READ_MOST_TEMPERATURE: 1,
    READ_TEMPERATURE: 1,
    READ_VOLTAGE: 2,
    READ_POSITION: 2,
    READ_MODE: 4,
    READ_LOAD: 1,
}

#: Longest time of a move, in ms.
MOST_MOVE_MS = 30_000

#: The one format of the family: an answer has the command that it answers in place of an error.
PACKETS = SumPackets(
    b"\x55\x55", counted=3, most_parameters=4, most_id=0xFF, answers=ANSWER_BYTES, probe=READ_POSITION
)

#: Time of a move of a single servo, in ms: two steps of a soft motion.
MOVE_MS = 40

#: Temperature in degrees Celsius at which servos let go, from the factory.
FACTORY_MOST_C = 85

#: Moves in a control period: half of the servos, 7.8 ms.
MOST_MOVES = 9

#: Time of a move: the period in which the next one comes.
PERIOD_MS = 20

#: A goal is sent again after this time, as moves are not acknowledged.
REPEAT_S = 0.25

#: For this long after an answer that did not come moves may be lost too, as many of a joint in a row.
LOSSY_S, LOST_MOVES = 0.5, 2

#: Length of a move.
MOVE_BYTES = 10

#: Time since the goals of a control period in which positions are asked.
SPAN_S = 0.0175

#: Readings besides positions, in turn: one for each round of all positions.
OTHERS = (READ_VOLTAGE, READ_TEMPERATURE, READ_LOAD)


def move_packet(packets: PacketFormat, servo_id: int, count: int, time_ms: int) -> bytes:
    """Packet that moves a servo to a count, 0 to 1000, in a time in ms."""
    time_ms = min(max(time_ms, 0), MOST_MOVE_MS)
    return packets.instruction(servo_id, MOVE, count.to_bytes(2, "little") + time_ms.to_bytes(2, "little"))


def torque_packet(packets: PacketFormat, servo_id: int, *, on: bool) -> bytes:
    """Packet that switches the torque of a servo."""
    return packets.instruction(servo_id, WRITE_LOAD, bytes([on]))


def signed_number(parameters: bytes) -> int:
    """Number in the parameters of an answer; two bytes are signed."""
    return int.from_bytes(parameters, "little", signed=len(parameters) == 2)


class Lx16aServo(Servo):
    """One servo without a torque limit; each move has a duration."""

    def look(self) -> ScannedServo:
        """Identity and readings of the servo."""
        position, millivolts = self.position(), self.number(READ_VOLTAGE)
        limits_mv = self._pair(READ_VOLTAGE_LIMITS)
        return ScannedServo(
            servo_id=self.servo_id,
            baud=self._packets.line.baud,
            model=None,
            model_number=None,
            protocol=1,
            position=None if position is None else int(position),
            voltage_v=None if millivolts is None else round(millivolts / 1000, 1),
            temperature_c=self.number(READ_TEMPERATURE),
            variant="" if limits_mv is None else f"{limits_mv[0] / 1000:g} to {limits_mv[1] / 1000:g} V",
        )

    def number(self, command: int) -> float | None:
        """Number that answers a reading command; None without an answer."""
        answer = self._ask(command)
        return None if answer is None else float(signed_number(answer))

    def position(self) -> float | None:
        """Position in counts."""
        return self.number(READ_POSITION)

    def torque(self, *, tries: int = TRIES) -> bool | None:
        """Whether its torque is on; None without an answer."""
        answer = self._ask(READ_LOAD, tries=tries)
        return None if answer is None else bool(answer[0])

    def set_torque(self, *, on: bool) -> bool:
        """Switch the torque until the servo confirms it."""
        for _ in range(TRIES):
            self._packets.line.write(torque_packet(self._packets.packets, self.servo_id, on=on))
            if self.torque() is on:
                return True
        return False

    def go(self, count: float) -> str:
        """Set the goal; these servos do not acknowledge it."""
        self._packets.line.write(move_packet(self._packets.packets, self.servo_id, round(count), MOVE_MS))
        return ""

    def settings(self) -> ServoSettings:
        """Stored limits, or those of its model without any, and differences to the factory settings."""
        least, most = self._pair(READ_LIMITS) or (0, 0)
        if not self.type.least <= least < most <= self.type.most:
            least, most = self.type.least, self.type.most
        refusal = "it is in motor mode and follows no positions; switch its power off and on"
        return ServoSettings(
            refusal=refusal if self._is_motor() else "", notes=tuple(self._notes()), least=least, most=most
        )

    def set_up(self) -> list[str]:
        """Set up a servo without torque: position mode."""
        if not self._is_motor():
            return []
        self._packets.tell(self.servo_id, WRITE_MODE, bytes(4))  # position mode
        return ["could not end its motor mode" if self._is_motor() else "ended its motor mode"]

    def _is_motor(self) -> bool:
        stored = self._twice(lambda: self._ask(READ_MODE))
        return stored is not None and stored[0] == 1

    def _notes(self) -> list[str]:
        notes = []
        most_c = self._twice(lambda: self.number(READ_MOST_TEMPERATURE)) or FACTORY_MOST_C
        if most_c > FACTORY_MOST_C:
            notes.append(f"it lets go at {most_c:.0f} degrees C, from the factory at {FACTORY_MOST_C}")
        if self.p_gain is not None:
            notes.append(NO_GAIN)
        if self._twice(lambda: self.number(READ_OFFSET)):
            notes.append(OFFSET)
        limits_mv, now_mv = self._pair(READ_VOLTAGE_LIMITS), self.number(READ_VOLTAGE)
        if limits_mv is not None and now_mv is not None and not limits_mv[0] <= now_mv <= limits_mv[1]:
            least_v, most_v = (each / 1000 for each in limits_mv)
            notes.append(f"it has {now_mv / 1000:.1f} V, and lets go outside {least_v:.1f} to {most_v:.1f} V")
        return notes

    def _pair(self, command: int) -> tuple[int, int] | None:
        stored = self._twice(lambda: self._ask(command))
        return None if stored is None else (signed_number(stored[:2]), signed_number(stored[2:]))

    def _write_id(self, servo_id: int) -> str:
        self._packets.tell(self.servo_id, WRITE_ID, bytes([servo_id]))
        return ""

    def _ask(self, command: int, *, tries: int = TRIES) -> bytes | None:
        answer = self._packets.ask(self.servo_id, command, tries=tries)
        return None if answer is None else answer.parameters


class Lx16aBus(ServoBus):
    """LX-16A, LX-224 and HTS-35H servos on one line, or behind a board that repeats their commands.

    Goals are clipped to the limits stored in each servo, beyond which it would unload. A servo that unloads
    by itself gets no more goals. No servo confirms a move: its duration starts from the expected end of the
    one before, and while answers are lost also from the position if those moves were lost.

    Attributes:
        servo_class: of single servos.
    """

    servo_class: ClassVar[type[Lx16aServo]] = Lx16aServo
    mute_s: ClassVar[float] = 1.5
    stale_s: ClassVar[float] = 0.5
    reports_limp = True
    servos: Sequence[Lx16aServo]

    def __init__(self, packets: PacketLine, models: Mapping[int, ServoType], counters: BusCounters) -> None:
        super().__init__(packets, models, counters)
        self.servos = [self.servo_class(packets, servo_id, model) for servo_id, model in models.items()]
        self.lowest = np.array([float(model.least) for model in models.values()])
        self.highest = np.array([float(model.most) for model in models.values()])
        count = len(models)
        self._format = packets.packets
        self._line, self._began_s = packets.line, 0.0  # when the period began
        self._on: BoolArray = np.zeros(count, dtype=bool)
        self._limp: BoolArray = np.zeros(count, dtype=bool)
        self._goals: FloatArray | None = None
        self._sent, self._sent_at_s = np.full(count, np.nan), np.full(count, -np.inf)
        self._earlier = np.full((LOST_MOVES, count), np.nan)  # goals sent before those, the newest first
        self._from, self._takes_s = np.full(count, np.nan), np.full(count, PERIOD_MS / 1000)
        self._read = np.full(count, np.nan)  # newest positions received
        self._missed_at_s = -np.inf  # when an answer was lost last
        self._silent: BoolArray = np.zeros(count, dtype=bool)  # servos whose last answer did not come
        self._waited: set[int] = set()  # servos whose goals had changed and were not sent
        self._wrote = False
        self._readings = self._next = self._next_other = 0
        self._others: dict[tuple[int, int], float] = {}  # by servo and command, not reported yet

    def find(self) -> BoolArray:
        """Which servos answer, (n,); keeps their voltages and temperatures for the first reports."""
        found = super().find()
        self._silent = ~found
        for index in np.flatnonzero(found).tolist():
            for command in (READ_VOLTAGE, READ_TEMPERATURE):
                self._read_other(index, command)
        return found

    def torque(self, index: int, *, tries: int = TRIES) -> bool | None:
        """Whether a servo holds its goal; None without an answer."""
        answer = self._ask(index, READ_LOAD, tries=tries)
        if answer is None:
            return None
        self._on[index] = bool(answer[0])
        return bool(answer[0])

    def set_torque(self, on: bool, indices: Sequence[int] | None = None) -> None:
        """Switch the torque of some servos until each confirms, up to `TRIES` times."""
        left = list(self._every if indices is None else indices)
        if not on:
            self._goals = None
        self._on[left] = on
        self._limp[left] = self._beyond[left] = False
        for _ in range(TRIES):
            self._write([torque_packet(self._format, self.ids[index], on=on) for index in left])
            left = [index for index in left if self._ask(index, READ_LOAD) != bytes([on])]
            if not left:
                return

    def _hold(self, here: FloatArray, which: BoolArray) -> BoolArray:
        """Send goals before and after the torque, as unloaded servos may ignore moves; skip `_beyond`."""
        self._on[self._beyond] = False
        chosen = np.flatnonzero(which).tolist()
        for index in chosen:
            to_here = move_packet(self._format, self.ids[index], int(here[index]), PERIOD_MS)
            self._write([to_here, torque_packet(self._format, self.ids[index], on=True), to_here])
        self._sent[:] = self._earlier[:] = np.nan
        self._from[:] = np.where(which, here, np.nan)
        self.set_torque(True, chosen)
        return np.array([bool(which[index] and self.torque(index)) for index in self._every])

    def _send_goals(self, goals: FloatArray) -> None:
        """Send changed goals now, or half of them a period later."""
        self._goals, self._wrote = goals, True
        self._send_moves()

    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of the next servos that fit into the remaining time, at least one."""
        if not self._wrote:
            self._send_moves()
        self._wrote = False
        reports: list[Report] = []
        asked, wire_s = 0, self._line.wire_s(6 + 8)
        while True:
            self._readings += 1
            if self._readings % (len(self.ids) + 1) == 0:
                self._read_next_other()
            else:
                reports += self._ask_reports([self._next])
                self._next, asked = (self._next + 1) % len(self.ids), asked + 1
            begin_s = max(self._line.free_s, self._time.now())
            late = begin_s + wire_s + self._packets.timeout_s / TIMEOUT_TIMES > self._began_s + SPAN_S
            if asked and (late or asked == len(self.ids) or until()):
                return reports

    def end_watchdog(self, indices: Sequence[int] | None = None) -> None:
        """Send waiting goals; these servos have no watchdog."""
        self._send_moves()

    def _send_moves(self) -> None:
        """Move the servos with changed goals, the longest waiting first, and one of the others."""
        self._began_s = now_s = self._time.now()
        if self._goals is None:
            return
        order = [
            index
            for index in np.argsort(self._sent_at_s, kind="stable").tolist()
            if self._on[index] and np.isfinite(self._goals[index])
        ]
        due = [index for index in order if self._goals[index] != self._sent[index]]
        chosen = due[:MOST_MOVES]
        old = [index for index in order[:1] if self._sent_at_s[index] < now_s - REPEAT_S]
        if len(chosen) < MOST_MOVES and not set(old) & set(chosen):
            chosen += old
        # Goals that waited, or will, are two periods from the one before or to the next.
        slow = set(due) if len(due) > MOST_MOVES else self._waited
        self._waited = set(due) - set(chosen)
        planned_ms = np.array([2 * PERIOD_MS if index in slow else PERIOD_MS for index in self._every])
        arrive_s = np.full(len(self.ids), now_s)  # at its servo, one move behind the other
        arrive_s[chosen] = max(self._line.free_s, now_s) + self._move_s() * np.arange(1, len(chosen) + 1)
        times_ms = np.maximum(planned_ms, self._needed_ms(self._goals, arrive_s))
        self._note_moves(chosen, self._goals, times_ms, arrive_s)
        if chosen:
            self._write_moves(chosen, times_ms)

    def _write_moves(self, chosen: Sequence[int], times_ms: FloatArray) -> None:
        """Move some servos to the goals noted as sent, in times (n,)."""
        self._write(
            [
                move_packet(self._format, self.ids[index], int(self._sent[index]), int(times_ms[index]))
                for index in chosen
            ]
        )

    def _write(self, packets: Sequence[bytes]) -> None:
        """Send packets, each with a command for one servo."""
        self._line.write(b"".join(packets))

    def _move_s(self) -> float:
        """Time of a move on the servos' line."""
        return self._line.wire_s(MOVE_BYTES)

    def _needed_ms(self, goals: FloatArray, at_s: FloatArray) -> FloatArray:
        """Time of each servo to its goal at maximum speed, from any of its possible positions, (n,)."""
        lossy = self._silent | (at_s - self._missed_at_s <= LOSSY_S)
        if_lost = np.where(lossy, [self._sent, self._from, self._read, *self._earlier], np.nan)
        maybe_at = np.vstack([self._come_to(at_s), if_lost])
        farthest = np.abs(np.nan_to_num(goals - maybe_at)).max(axis=0)
        return np.asarray(np.ceil(np.round(1000 * farthest / self.speeds, 6)))

    def _come_to(self, at_s: FloatArray) -> FloatArray:
        """Expected counts of the moves at times, (n,); NaN if unknown."""
        done = np.clip((at_s - self._sent_at_s) / self._takes_s, 0.0, 1.0)
        return np.asarray(
            np.where(np.isnan(self._sent), self._from, self._from + done * (self._sent - self._from))
        )

    def _note_moves(
        self, chosen: list[int], goals: FloatArray, times_ms: FloatArray, at_s: FloatArray
    ) -> None:
        here = self._come_to(at_s)
        here = np.where(np.isnan(here), goals, here)
        new = [index for index in chosen if goals[index] != self._sent[index]]
        self._earlier[:, new] = np.vstack([self._sent[new], self._earlier[:-1, new]])
        self._from[chosen], self._takes_s[chosen] = here[chosen], times_ms[chosen] / 1000
        self._sent[chosen], self._sent_at_s[chosen] = goals[chosen], at_s[chosen]

    def _ask_reports(self, indices: Sequence[int]) -> list[Report]:
        answers = [(index, self._ask(index, READ_POSITION)) for index in indices]
        reports = [self._report(index, answer) for index, answer in answers if answer is not None]
        self._count(indices, reports)
        return reports

    def _report(self, index: int, answer: bytes) -> Report:
        self._read[index] = signed_number(answer)
        limp = "limp" if self._limp[index] else ""
        return Report(
            index=index,
            at_s=self._time.now(),
            position=signed_number(answer),
            effort=np.nan,
            current_a=np.nan,
            voltage_v=self._others.pop((index, READ_VOLTAGE), np.nan) / 1000,
            temperature_c=self._others.pop((index, READ_TEMPERATURE), np.nan),
            error=", ".join(filter(None, (limp, self._complaint_of_limits(index)))),
        )

    def _read_next_other(self) -> None:
        kind, index = divmod(self._next_other, len(self.ids))
        self._next_other = (self._next_other + 1) % (len(OTHERS) * len(self.ids))
        self._read_other(index, OTHERS[kind])

    def _read_other(self, index: int, command: int) -> None:
        answer = self._ask(index, command)
        if answer is None:
            return
        if command != READ_LOAD:
            self._others[index, command] = signed_number(answer)
        elif answer == b"\0" and self._on[index] and self._ask(index, command) == answer:
            self._on[index], self._limp[index] = False, True

    def _ask(self, index: int, command: int, *, tries: int = 1) -> bytes | None:
        for _ in range(tries):
            answer = self._packets.ask(self.ids[index], command)
            if answer is not None:
                self._silent[index] = False
                return answer.parameters
            if not self._silent[index]:  # a dead servo is no evidence about the others' moves
                self._silent[index], self._missed_at_s = True, self._time.now()
        return None


#: Counts of these servos: 1000 over 240 degrees.
_COUNTS: dict[str, Any] = {"counts": 1000 * 360 / 240, "most": 1000, "centre": 500}

LX16A = Family(
    name="lx16a",
    models=tuple(
        ServoType(name, None, least_v, **_COUNTS)
        for name, least_v in (("lx16a", 6.0), ("lx224", 6.0), ("hts35h", 9.0))
    ),
    bauds=(115_200,),
    formats={1: PACKETS},
    servo=Lx16aServo,
    bus=Lx16aBus,
    id_question=READ_ID,
    simulated="hexctl.simulators.lx16a_servos:Lx16aServos",
)
