"""A bus of servos by their ids, of any protocol, used by the thread that owns it.

Arrays are by servo, in the order of the ids, (n,). A bus does not know which servo moves which joint.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from hexctl.backends.bus.damage import Damage, Listener
from hexctl.backends.bus.packet_line import PacketLine
from hexctl.backends.bus.servo import TRIES, Servo, ServoSettings
from hexctl.backends.bus.servo_type import ServoType
from hexctl.backends.port_thread import PortCounters
from hexctl.types import N_JOINTS, ArrayFields, BoolArray, FloatArray

#: Maximum distance beyond its stored limits at which a servo gets torque.
#:
#: Farther out it would rush back.
BEYOND_DEG = 2.0

#: Questions over which shares of damaged answers are taken.
WINDOW = 200

#: Unanswered requests in a row from which a servo counts as silent, which is no sign of a bad line.
MOST_IN_A_ROW = 10

#: Warning that replaces one which names many mute servos.
MANY_MUTE = "mute: servos of more than two legs"


@dataclass(frozen=True, slots=True)
class Report:
    """Report of one servo.

    Attributes:
        index: of the servo on the bus.
        position: in counts.
        effort: share of its maximum, or NaN.
        error: its complaint; empty for none.
    """

    index: int
    at_s: float
    position: float
    effort: float
    current_a: float
    voltage_v: float
    temperature_c: float
    error: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BusBoardState(ArrayFields):
    """What a board between computer and servos measures by itself; None for unknown values.

    Attributes:
        battery_v: at its supply.
        quaternion: orientation of the body (w, x, y, z), (4,); its yaw begins at zero.
        angular_velocity_rad_s: of the body, about its own axes, (3,).
    """

    battery_v: float | None = None
    quaternion: FloatArray | None = None
    angular_velocity_rad_s: FloatArray | None = None


class AnswerShares:
    """Recent shares of questions without a complete answer, `damaged`, and their numbers, by joint."""

    def __init__(self) -> None:
        self.damaged, self.asked = [0.0] * N_JOINTS, [0] * N_JOINTS
        self._missed = [0] * N_JOINTS  # in a row

    def take(self, asked: Sequence[int], heard: Collection[int]) -> None:
        """Count which joints were asked, and which of them answered.

        Questions without an answer count once an answer comes: a silent servo has no bad answers.
        """
        for joint in asked:
            if joint not in heard:
                self._missed[joint] += 1
                continue
            missed, self._missed[joint] = self._missed[joint], 0
            for _ in range(missed if missed <= MOST_IN_A_ROW else 0):
                self._note(joint, 1.0)
            self._note(joint, 0.0)

    def _note(self, joint: int, damaged: float) -> None:
        self.asked[joint] += 1
        weight = max(1 / self.asked[joint], 1 / WINDOW)
        self.damaged[joint] += weight * (damaged - self.damaged[joint])


@dataclass(slots=True, kw_only=True)
class BusCounters(PortCounters):
    """Counts of a bus since it was opened.

    Attributes:
        garbled: bytes outside packets.
        implausible: number of rejected positions.
        shares: of damaged answers, by servo.
    """

    garbled: int = 0
    implausible: int = 0
    shares: AnswerShares = field(default_factory=AnswerShares)


class ServoBus(ABC):
    """Servos on one line.

    Nothing moves before `set_torque` or `hold`. One thread at a time may use it; every method raises OSError
    when the port is lost.

    Attributes:
        mute_s: silence after which a servo is mute.
        stale_s: age of a accepted position after which a servo was not measured with the others.
        reports_limp: whether its reports complain of lost torque.
        damage: bytes outside answers during the search for servos.
        board_answers: whether a board answered in place of servos then.
        lowest, highest: stored limits of goals, in counts, (n,); none before `settings`.
        speeds: maximum of the servos, (n,), in counts per second, for timed moves; infinite until set.
    """

    mute_s: ClassVar[float] = 0.5
    stale_s: ClassVar[float] = 0.17  # twice the age of a reading if servos are asked in turn
    reports_limp: ClassVar[bool] = False
    servos: Sequence[Servo]
    damage: Damage
    board_answers: bool

    def __init__(self, packets: PacketLine, models: Mapping[int, ServoType], counters: BusCounters) -> None:
        self._packets, self._counters, self._time = packets, counters, packets.line.time
        self.ids, count = tuple(models), len(models)
        self._every = tuple(range(count))
        self._reach = BEYOND_DEG * np.array([model.counts_per_deg for model in models.values()])
        self.lowest, self.highest = np.full(count, -np.inf), np.full(count, np.inf)
        self.speeds: FloatArray = np.full(count, np.inf)
        self._clipped: BoolArray = np.zeros(count, dtype=bool)  # servos whose goals are beyond their limits
        self._beyond: BoolArray = np.zeros(count, dtype=bool)  # servos that may not hold where they are

    def find(self) -> BoolArray:
        """Which servos answer, (n,); detects an echo of the adapter and bytes outside answers (`damage`)."""
        self._packets.learn_echo()
        listener = Listener(self._packets)
        found = [listener.look(servo.servo_id, servo.reads) for servo in self.servos]
        self.damage, self.board_answers = listener.damage(), self._packets.absent > 0
        return np.array(found)

    def servo(self, servo_id: int, model: ServoType) -> Servo:
        """Another servo of the same family on the line."""
        return type(self.servos[0])(self._packets, servo_id, model)

    def settings(self, which: BoolArray) -> dict[int, ServoSettings]:
        """Stored settings of some servos, (n,), by index; goals end at their limits from now on."""
        stored = {index: self.servos[index].settings() for index in np.flatnonzero(which).tolist()}
        for index, settings in stored.items():
            self.lowest[index], self.highest[index] = settings.least, settings.most
        return stored

    def torque(self, index: int, *, tries: int = TRIES) -> bool | None:
        """Whether a servo holds its goal; None without an answer."""
        return self.servos[index].torque(tries=tries)

    @abstractmethod
    def set_torque(self, on: bool, indices: Sequence[int] | None = None) -> None:
        """Switch the torque of some servos, by default all; torque off is sent until confirmed."""

    def hold(self, counts: FloatArray, which: BoolArray) -> BoolArray:
        """Switch the torque of some servos on, (n,), with goals at their positions, counts (n,).

        A servo more than `BEYOND_DEG` outside its stored limits gets no torque, and its reports complain of
        that. The result is which servos confirm that they hold, (n,).
        """
        here = self._within_limits(counts)
        beyond = np.abs(counts - np.clip(counts, self.lowest, self.highest)) > self._reach
        self._beyond, holding = which & beyond, which & ~beyond
        return self._hold(here, holding)

    @abstractmethod
    def _hold(self, here: FloatArray, which: BoolArray) -> BoolArray:
        """Switch the torque of some servos on, (n,), with goals at counts (n,); which hold then."""

    def write_goals(self, counts: FloatArray) -> None:
        """Send goals in counts, (n,), clipped to the stored limits; NaN sends none."""
        goals = self._within_limits(counts)
        self._clipped = np.abs(np.rint(counts) - goals) > 0
        self._counters.writes += 1
        self._send_goals(goals)

    @abstractmethod
    def _send_goals(self, goals: FloatArray) -> None:
        """Send goals in whole counts within the limits, (n,)."""

    @abstractmethod
    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of all servos, or one by one of the next few until `until` is true."""

    def poll_all(self) -> list[Report]:
        """Reports of all servos, each asked up to `TRIES` times."""
        found: dict[int, Report] = {}
        for _ in range(TRIES):
            missing = [index for index in self._every if index not in found]
            found.update({report.index: report for report in self._ask_reports(missing)})
        return [found[index] for index in sorted(found)]

    @abstractmethod
    def _ask_reports(self, indices: Sequence[int]) -> list[Report]:
        """Reports of some servos, each asked once."""

    def board(self) -> BusBoardState:
        """Newest measurements of a board; also for other threads."""
        return BusBoardState()

    def renew_watchdog(self, indices: Sequence[int] | None = None) -> None:  # noqa: B027  most have none
        """Treat silence as a failure from now on; expired watchdogs end."""

    def end_watchdog(self, indices: Sequence[int] | None = None) -> None:  # noqa: B027  most have none
        """Stop the watchdogs."""

    def close(self) -> None:
        """Close the line."""
        self._packets.line.close()

    def _within_limits(self, counts: FloatArray) -> FloatArray:
        return np.asarray(np.clip(np.rint(counts), self.lowest, self.highest))

    def _count(self, asked: Sequence[int], reports: Sequence[Report]) -> None:
        self._counters.reports += len(reports)
        self._counters.missed += len(asked) - len(reports)
        self._counters.shares.take(asked, {report.index for report in reports})
        self._counters.garbled = self._packets.garbled

    def _complaint_of_limits(self, index: int) -> str:
        """Complaint of a servo outside its stored limits, or with such a goal; empty for none."""
        if not (self._beyond[index] or self._clipped[index]):
            return ""
        limits = f"{self.lowest[index]:.0f} to {self.highest[index]:.0f} stored in the servo"
        return f"{'stands' if self._beyond[index] else 'goal'} beyond the limits {limits}"
