"""A bus of LX-16A servos and their kin: slow, so that not all is sent and asked in each control period.

At 115200 baud a move is 0.9 ms and a reading 1.2 ms, so that not all fits into 20 ms. Moves go to joints
whose goals changed, at most `MOST_MOVES` in a period and those first that wait longest; positions are asked
one by one in the time that is left.
"""

import time
from collections.abc import Callable, Sequence
from typing import ClassVar

import numpy as np

from hexctl.backends.bus.lx16a import lx16a_packets as lx
from hexctl.backends.bus.packet_line import (
    FIRST_TIMEOUT_S,
    LEAST_TIMEOUT_S,
    TIMEOUT_SHARE,
    TIMEOUT_TIMES,
)
from hexctl.backends.bus.packets import PacketStream
from hexctl.backends.bus.serial_line import UNUSED_ID, SerialLine
from hexctl.backends.bus.servo_bus import (
    ALL,
    TRIES,
    BusCounters,
    Report,
    ServoBus,
    beyond_stored_limits,
    complaint_of_limits,
    far_beyond,
)
from hexctl.robot.servos.bus_map import BusMap
from hexctl.robot.servos.servo_models import ServoType
from hexctl.types import N_JOINTS, BoolArray, FloatArray

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

#: One of this many readings is of something else than a position: one for each round of all joints.
OTHERS_EVERY = N_JOINTS + 1

#: What is read besides positions, in turn.
OTHERS = (lx.READ_VOLTAGE, lx.READ_TEMPERATURE, lx.READ_LOAD)

LOWEST, HIGHEST = 0, 1000

#: Temperature in degrees Celsius at which servos let go, from the factory.
FACTORY_MOST_C = 85


class Lx16aBus(ServoBus):
    """LX-16A, LX-224 and HTS-35H servos on one line.

    Goals are clipped to the limits that are stored in each servo, beyond which it would unload. A servo that
    unloads by itself gets no goals any more, and its reports say that it is limp. A move has the time that
    its joint needs from where the move before has come to; while answers are lost also from where it is if
    the moves before were lost too, as no servo confirms one.

    Args:
        line: open.
        servos: which servo moves which joint.
        counters: what is counted.
    """

    mute_s: ClassVar[float] = 1.5
    stale_s: ClassVar[float] = 0.5
    reports_limp = True

    def __init__(self, line: SerialLine, servos: BusMap, counters: BusCounters) -> None:
        self._line, self._map, self._counters = line, servos, counters
        self._ids: list[int] = servos.ids.tolist()
        self._stream = PacketStream(lx.LX16A)
        self._timeout_s = FIRST_TIMEOUT_S
        self._free_s = self._began_s = 0.0  # when the line has sent all, and when the period began
        self._lowest, self._highest = np.full(N_JOINTS, float(LOWEST)), np.full(N_JOINTS, float(HIGHEST))
        self._on: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self._limp: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self._clipped: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        self._beyond: BoolArray = np.zeros(N_JOINTS, dtype=bool)  # joints that may not hold where they are
        self._goals: FloatArray | None = None
        self._sent, self._sent_at_s = np.full(N_JOINTS, np.nan), np.full(N_JOINTS, -np.inf)
        self._earlier = np.full((LOST_MOVES, N_JOINTS), np.nan)  # goals sent before those, the newest first
        self._from, self._takes_s = np.full(N_JOINTS, np.nan), np.full(N_JOINTS, PERIOD_MS / 1000)
        self._read = np.full(N_JOINTS, np.nan)  # newest positions that were answered
        self._missed_at_s = -np.inf  # when an answer was lost last
        self._silent: set[int] = set()  # ids whose last answer did not come
        self._waited: set[int] = set()  # joints whose goals had changed and were not sent
        self._wrote = False
        self._readings = self._next = self._next_other = 0
        self._others: dict[tuple[int, int], float] = {}  # by joint and command, not reported yet

    def find(self) -> BoolArray:
        """Which joints have a servo that answers, (18,); learns whether the adapter echoes."""
        self._line.learn_echo(lx.LX16A.instruction(UNUSED_ID, lx.READ_POSITION), FIRST_TIMEOUT_S)
        found: BoolArray = np.zeros(N_JOINTS, dtype=bool)
        for joint in ALL:
            if self._ask(joint, lx.READ_POSITION, tries=TRIES) is None:
                continue
            found[joint] = True
            self._lowest[joint], self._highest[joint] = self._stored_limits(joint)
            for command in (lx.READ_VOLTAGE, lx.READ_TEMPERATURE):
                self._read_other(joint, command)
        return found

    def _stored_limits(self, joint: int) -> tuple[float, float]:
        """Lowest and highest goal that the servo of a joint takes; those of the family where it has none."""
        stored = self._sure(joint, lx.READ_LIMITS)
        least, most = (LOWEST, HIGHEST) if stored is None else (lx.number(stored[:2]), lx.number(stored[2:]))
        return (least, most) if LOWEST <= least < most <= HIGHEST else (LOWEST, HIGHEST)

    def model_number(self, joint: int) -> int | None:
        """None: these servos report no model number."""
        return None

    def answers(self, servo_id: int, model: ServoType) -> bool:
        """Whether a servo answers to an id that no joint has."""
        return self._ask_id(servo_id, lx.READ_POSITION, tries=TRIES) is not None

    def prepare(self, joints: BoolArray) -> None:
        """Nothing: these servos answer without delay, and their limits are the owner's."""

    def check(self, joints: BoolArray, least: FloatArray, most: FloatArray) -> tuple[str, ...]:
        """Notes on what is stored in the servos: limits, at which goals end, and when they let go."""
        notes = [
            f"{note}: {self._map.names(np.arange(N_JOINTS) == joint)}"
            for joint in np.flatnonzero(joints).tolist()
            for note in self._protection(joint)
        ]
        return (*notes, *beyond_stored_limits(self._map, self._lowest, self._highest, least, most))

    def _protection(self, joint: int) -> list[str]:
        """What is worth knowing of the temperature and the voltages at which a servo lets go."""
        notes = []
        hottest = self._sure(joint, lx.READ_MOST_TEMPERATURE)
        most_c = FACTORY_MOST_C if hottest is None else lx.number(hottest)
        if most_c > FACTORY_MOST_C:
            notes.append(f"it lets go at {most_c} degrees C, from the factory at {FACTORY_MOST_C}")
        stored, now_mv = self._sure(joint, lx.READ_VOLTAGE_LIMITS), self._others.get((joint, lx.READ_VOLTAGE))
        if stored is not None and now_mv is not None:
            least_mv, most_mv = lx.number(stored[:2]), lx.number(stored[2:])
            if not least_mv <= now_mv <= most_mv:
                notes.append(
                    f"it has {now_mv / 1000:.1f} V, and lets go outside {least_mv / 1000:.1f} to "
                    f"{most_mv / 1000:.1f} V"
                )
        return notes

    def torque(self, joint: int, *, tries: int = TRIES) -> bool | None:
        """Whether the servo of a joint holds its goal, or None without an answer."""
        answer = self._ask(joint, lx.READ_LOAD, tries=tries)
        if answer is None:
            return None
        self._on[joint] = bool(answer[0])
        return bool(answer[0])

    def set_torque(self, on: bool, joints: Sequence[int] = ALL) -> None:
        """Switch the torque of some joints, until each says that it is, up to `TRIES` times."""
        if not on:
            self._goals = None
        self._on[list(joints)] = on
        self._limp[list(joints)] = self._beyond[list(joints)] = False
        left = list(joints)
        for _ in range(TRIES):
            self._tell(b"".join(lx.load(self._ids[joint], on=on) for joint in left))
            left = [joint for joint in left if self._ask(joint, lx.READ_LOAD) != bytes([on])]
            if not left:
                return

    def hold(self, counts: FloatArray, joints: BoolArray) -> BoolArray:
        """Switch the torque of some joints on, (18,), each with its goal where it is; which joints hold.

        The goal is sent in front of the torque and behind it: whether an unloaded servo takes moves differs.
        A servo moves to its limit from beyond it as fast as it can: one that is far beyond is left limp.
        """
        here, beyond = self._within_limits(counts), far_beyond(self._map, counts, self._lowest, self._highest)
        self._beyond, holding = joints & beyond, joints & ~beyond
        self._on[self._beyond] = False
        chosen = np.flatnonzero(holding).tolist()
        for joint in chosen:
            to_here = lx.move(self._ids[joint], int(here[joint]), PERIOD_MS)
            self._tell(to_here + lx.load(self._ids[joint], on=True) + to_here)
        self._sent[:] = self._earlier[:] = np.nan
        self._from[:] = np.where(holding, here, np.nan)
        self.set_torque(True, chosen)
        return np.array([bool(holding[joint] and self.torque(joint)) for joint in ALL])

    def write_goals(self, counts: FloatArray) -> None:
        """Take goals in counts, (18,): those that changed are sent now, or half of them a period later.

        A servo whose goal is NaN gets none.
        """
        self._goals = self._within_limits(counts)
        self._clipped = np.abs(np.rint(counts) - self._goals) > 0
        self._counters.writes += 1
        self._wrote = True
        self._send_moves()

    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of the next few servos, as many as answer in the time that is left; one at the least."""
        if not self._wrote:
            self._send_moves()
        self._wrote = False
        reports: list[Report] = []
        asked, wire_s = 0, self._line.wire_s(6 + 8)
        while True:
            self._readings += 1
            if self._readings % OTHERS_EVERY == 0:
                self._read_next_other()
            else:
                reports += self._report(self._next, tries=1)
                self._next, asked = (self._next + 1) % N_JOINTS, asked + 1
            begin_s = max(self._free_s, time.monotonic())
            late = begin_s + wire_s + self._timeout_s / TIMEOUT_TIMES > self._began_s + SPAN_S
            if asked and (late or asked == N_JOINTS or until()):
                return reports

    def poll_all(self) -> list[Report]:
        """Reports of all servos, each asked up to `TRIES` times."""
        return [report for joint in ALL for report in self._report(joint, tries=TRIES)]

    def renew_watchdog(self, joints: Sequence[int] = ALL) -> None:
        """Nothing: these servos have no watchdog."""

    def end_watchdog(self, joints: Sequence[int] = ALL) -> None:
        """Send goals that still wait; these servos have no watchdog."""
        self._send_moves()

    def close(self) -> None:
        """Close the line."""
        self._line.close()

    def _within_limits(self, counts: FloatArray) -> FloatArray:
        return np.asarray(np.clip(np.rint(counts), self._lowest, self._highest))

    def _send_moves(self) -> None:
        """Move joints whose goals have changed, those first that wait longest, and one of the others."""
        self._began_s = now_s = time.monotonic()
        if self._goals is None:
            return
        order = [
            joint
            for joint in np.argsort(self._sent_at_s, kind="stable").tolist()
            if self._on[joint] and np.isfinite(self._goals[joint])
        ]
        due = [joint for joint in order if self._goals[joint] != self._sent[joint]]
        chosen = due[:MOST_MOVES]
        old = [joint for joint in order[:1] if self._sent_at_s[joint] < now_s - REPEAT_S]
        if len(chosen) < MOST_MOVES and not set(old) & set(chosen):
            chosen += old
        # Goals that waited, or will, are two periods from the one before or to the next.
        slow = set(due) if len(due) > MOST_MOVES else self._waited
        self._waited = set(due) - set(chosen)
        planned_ms = np.array([2 * PERIOD_MS if joint in slow else PERIOD_MS for joint in ALL])
        arrive_s = np.full(N_JOINTS, now_s)  # at its servo, one move behind the other
        arrive_s[chosen] = max(self._free_s, now_s) + self._line.wire_s(MOVE_BYTES) * np.arange(
            1, len(chosen) + 1
        )
        times_ms = np.maximum(planned_ms, self._needed_ms(self._goals, arrive_s))
        self._note_moves(chosen, self._goals, times_ms, arrive_s)
        moves = [lx.move(self._ids[joint], int(self._sent[joint]), int(times_ms[joint])) for joint in chosen]
        self._tell(b"".join(moves))

    def _needed_ms(self, goals: FloatArray, at_s: FloatArray) -> FloatArray:
        """Time that each joint needs to its goal at its greatest speed, wherever it is at a time, (18,)."""
        silent = np.array([servo_id in self._silent for servo_id in self._ids])
        lossy = silent | (at_s - self._missed_at_s <= LOSSY_S)
        if_lost = np.where(lossy, [self._sent, self._from, self._read, *self._earlier], np.nan)
        maybe_at = np.vstack([self._come_to(at_s), if_lost])
        farthest = np.abs(np.nan_to_num(goals - maybe_at)).max(axis=0)
        return np.asarray(np.ceil(np.round(1000 * farthest / self.speeds, 6)))

    def _come_to(self, at_s: FloatArray) -> FloatArray:
        """How far the moves have come at times, (18,), in counts; NaN where none is known."""
        done = np.clip((at_s - self._sent_at_s) / self._takes_s, 0.0, 1.0)
        return np.asarray(
            np.where(np.isnan(self._sent), self._from, self._from + done * (self._sent - self._from))
        )

    def _note_moves(
        self, chosen: list[int], goals: FloatArray, times_ms: FloatArray, at_s: FloatArray
    ) -> None:
        """Note that some joints are told to move to their goals; what is not known of before has ended."""
        here = self._come_to(at_s)
        here = np.where(np.isnan(here), goals, here)
        new = [joint for joint in chosen if goals[joint] != self._sent[joint]]
        self._earlier[:, new] = np.vstack([self._sent[new], self._earlier[:-1, new]])
        self._from[chosen], self._takes_s[chosen] = here[chosen], times_ms[chosen] / 1000
        self._sent[chosen], self._sent_at_s[chosen] = goals[chosen], at_s[chosen]

    def _report(self, joint: int, *, tries: int) -> list[Report]:
        """Report of a joint, or none where its servo does not answer."""
        answer = self._ask(joint, lx.READ_POSITION, tries=tries)
        self._counters.shares.take([joint], () if answer is None else (joint,))
        if answer is None:
            self._counters.missed += 1
            return []
        self._counters.reports += 1
        self._read[joint] = lx.number(answer)
        millivolts = self._others.pop((joint, lx.READ_VOLTAGE), np.nan)
        return [
            Report(
                joint=joint,
                at_s=time.monotonic(),
                position=lx.number(answer),
                effort=np.nan,
                current_a=np.nan,
                voltage_v=millivolts / 1000,
                temperature_c=self._others.pop((joint, lx.READ_TEMPERATURE), np.nan),
                error=self._complaint(joint),
            )
        ]

    def _complaint(self, joint: int) -> str:
        stands, goal = bool(self._beyond[joint]), bool(self._clipped[joint])
        limits = complaint_of_limits(self._lowest[joint], self._highest[joint], stands=stands, goal=goal)
        return ", ".join(filter(None, ("limp" if self._limp[joint] else "", limits)))

    def _read_next_other(self) -> None:
        """Read voltage, temperature or torque of the next servo."""
        kind, joint = divmod(self._next_other, N_JOINTS)
        self._next_other = (self._next_other + 1) % (len(OTHERS) * N_JOINTS)
        self._read_other(joint, OTHERS[kind])

    def _read_other(self, joint: int, command: int) -> None:
        answer = self._ask(joint, command)
        if answer is None:
            return
        if command != lx.READ_LOAD:
            self._others[joint, command] = lx.number(answer)
        elif answer == b"\0" and self._on[joint] and self._ask(joint, command) == answer:
            self._on[joint], self._limp[joint] = False, True

    def _tell(self, packets: bytes) -> None:
        """Send packets that no servo answers; they are on the line for a while."""
        self._line.write(packets)
        self._free_s = max(self._free_s, time.monotonic()) + self._line.wire_s(len(packets))

    def _ask(self, joint: int, command: int, *, tries: int = 1) -> bytes | None:
        """Parameters that the servo of a joint answers to a command, or None where it does not."""
        return self._ask_id(self._ids[joint], command, tries=tries)

    def _sure(self, joint: int, command: int) -> bytes | None:
        """Answer that came twice in a row, for what is decided by it; None where that does not come."""
        before = self._ask(joint, command, tries=TRIES)
        for _ in range(TRIES):
            if before is None:
                return None
            again = self._ask(joint, command, tries=TRIES)
            if again == before:
                return again
            before = again
        return None

    def _ask_id(self, servo_id: int, command: int, *, tries: int = 1) -> bytes | None:
        size = lx.ANSWER_BYTES[command]
        for _ in range(tries):
            if self._line.discard():  # too late for the question before
                self._wait_longer()
            self._stream.finish()
            self._tell(lx.LX16A.instruction(servo_id, command))
            answer = self._await(servo_id, command, size)
            self._counters.garbled = self._stream.garbled
            if answer is not None:
                self._silent.discard(servo_id)
                return answer
            if servo_id not in self._silent:  # one that is dead says nothing of the others' moves
                self._silent.add(servo_id)
                self._missed_at_s = time.monotonic()
        return None

    def _await(self, servo_id: int, command: int, size: int) -> bytes | None:
        """Answer of a servo to what was sent last; its delay is learned."""
        soonest_s = self._free_s + self._line.wire_s(lx.LX16A.status_size(size))
        deadline_s = soonest_s + self._timeout_s
        while True:
            data = self._line.read(deadline_s)
            came = self._stream.feed(data)
            over = not data and time.monotonic() >= deadline_s
            for answer in came + self._stream.finish() if over else came:
                if (answer.servo_id, answer.error, len(answer.parameters)) == (servo_id, command, size):
                    self._learn_delay(time.monotonic() - soonest_s)
                    return answer.parameters
                if len(answer.parameters) == lx.ANSWER_BYTES.get(answer.error):  # too late
                    self._wait_longer()
            if over:
                return None

    def _wait_longer(self) -> None:
        self._timeout_s = min(2 * self._timeout_s, FIRST_TIMEOUT_S)

    def _learn_delay(self, delay_s: float) -> None:
        wanted_s = min(max(TIMEOUT_TIMES * delay_s, LEAST_TIMEOUT_S), FIRST_TIMEOUT_S)
        self._timeout_s += TIMEOUT_SHARE * (wanted_s - self._timeout_s)
