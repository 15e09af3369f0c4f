"""A bus of eighteen servos, as the thread that owns it uses it, whatever they speak."""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import ClassVar

import numpy as np

from hexctl.backends.bus.line_condition import AnswerShares
from hexctl.robot.model import Robot
from hexctl.robot.servos.bus_map import BusMap
from hexctl.robot.servos.servo_models import ServoType
from hexctl.types import N_JOINTS, BoolArray, FloatArray

#: All joints, by index.
ALL = tuple(range(N_JOINTS))

#: Warning in place of one that names them.
MANY_MUTE = "mute: servos of more than two legs"

#: Tries of what must arrive.
TRIES = 4

#: A joint that stands beyond the limits stored in its servo by no more than this holds at the limit; one that
#: is farther away would be driven there at full speed, and gets no torque.
BEYOND_DEG = 2.0


@dataclass(frozen=True, slots=True)
class Report:
    """What one servo reports.

    Attributes:
        joint: index of its joint, 0..17.
        at_s: when its answer came, on time.monotonic.
        position: in counts.
        effort: share of its greatest, or NaN.
        current_a: or NaN.
        voltage_v: at the servo.
        temperature_c: of the servo.
        error: what it complains of; empty for nothing.
    """

    joint: int
    at_s: float
    position: float
    effort: float
    current_a: float
    voltage_v: float
    temperature_c: float
    error: str


@dataclass(slots=True)
class BusCounters:
    """Counts of a bus since it was opened.

    Attributes:
        writes: packets with targets.
        reports: reports of servos.
        missed: reports that were asked for and did not come.
        garbled: bytes that belonged to no packet.
        implausible: positions that were not believed.
        reopened: times that the port came back.
        shares: of damaged answers, by joint.
    """

    writes: int = 0
    reports: int = 0
    missed: int = 0
    garbled: int = 0
    implausible: int = 0
    reopened: int = 0
    shares: AnswerShares = field(default_factory=AnswerShares)


class ServoBus(ABC):
    """Eighteen servos on one line.

    Nothing moves before `set_torque` or `hold`. One thread at a time may use it; every method raises OSError
    when the port has gone.

    Attributes:
        mute_s: a joint whose servo was not heard for this long is mute.
        stale_s: a joint without a believed position for this long was not measured with the others.
        reports_limp: whether its reports complain of servos that have lost their torque.
        speeds: greatest of the joints, (18,), in counts per second, for goals that are sent with a time; no
            limit until they are set.
    """

    mute_s: ClassVar[float] = 0.5
    stale_s: ClassVar[float] = 0.17  # twice the age of a reading where joints are asked in turn
    reports_limp: ClassVar[bool] = False
    speeds: FloatArray = np.full(N_JOINTS, np.inf)

    @abstractmethod
    def find(self) -> BoolArray:
        """Which joints have a servo that answers, (18,); learns whether the adapter echoes."""

    @abstractmethod
    def model_number(self, joint: int) -> int | None:
        """Model number that the servo of a joint reports, or None where it reports none."""

    @abstractmethod
    def answers(self, servo_id: int, model: ServoType) -> bool:
        """Whether a servo of a model, as far as it says, answers to an id that no joint has."""

    @abstractmethod
    def prepare(self, joints: BoolArray) -> None:
        """Set up the servos of some joints, (18,), that have no torque."""

    @abstractmethod
    def check(self, joints: BoolArray, least: FloatArray, most: FloatArray) -> tuple[str, ...]:
        """What is worth knowing of what is stored in the servos of some joints, (18,), after `prepare`.

        Args:
            joints: that were found.
            least: lowest goals that the robot needs, in counts, (18,).
            most: highest goals that it needs.

        Raises RobotFaultError for a servo that would not steer for its goals as they are meant.
        """

    @abstractmethod
    def torque(self, joint: int, *, tries: int = TRIES) -> bool | None:
        """Whether the servo of a joint holds its goal, or None without an answer."""

    @abstractmethod
    def set_torque(self, on: bool, joints: Sequence[int] = ALL) -> None:
        """Switch the torque of some joints; torque off is sent until they say so, up to `TRIES` times."""

    @abstractmethod
    def hold(self, counts: FloatArray, joints: BoolArray) -> BoolArray:
        """Switch the torque of some joints on, (18,), each with its goal where it is, counts (18,).

        One that stands beyond the limits stored in its servo by more than `BEYOND_DEG` gets no goal and no
        torque, and its reports complain of that. Which joints hold then, (18,), as they say.
        """

    @abstractmethod
    def write_goals(self, counts: FloatArray) -> None:
        """Send goals in counts, (18,), as many as a control period carries; none where it is NaN."""

    @abstractmethod
    def poll(self, until: Callable[[], bool] = lambda: False) -> list[Report]:
        """Reports of all servos, or of the next few, asked one by one until something else is to be sent."""

    @abstractmethod
    def poll_all(self) -> list[Report]:
        """Reports of all servos, each asked as often as it takes, up to `TRIES` times."""

    @abstractmethod
    def renew_watchdog(self, joints: Sequence[int] = ALL) -> None:
        """Let silence be a failure from now on, also where it has been one: goals are taken again."""

    @abstractmethod
    def end_watchdog(self, joints: Sequence[int] = ALL) -> None:
        """Let silence be no failure any more."""

    @abstractmethod
    def close(self) -> None:
        """Close the line."""


def far_beyond(servos: BusMap, counts: FloatArray, lowest: FloatArray, highest: FloatArray) -> BoolArray:
    """Which joints stand so far beyond the limits stored in their servos that they may not hold, (18,).

    Args:
        servos: which servo moves which joint.
        counts: where the joints are, (18,).
        lowest: stored limits in counts, (18,).
        highest: the others.
    """
    return np.asarray(np.abs(counts - np.clip(counts, lowest, highest)) > BEYOND_DEG * servos.per_deg)


def complaint_of_limits(lowest: float, highest: float, *, stands: bool, goal: bool) -> str:
    """What is said of a joint that stands, or whose goal is, beyond its stored limits in counts, or ""."""
    limits = f"beyond the limits {lowest:.0f} to {highest:.0f} stored in the servo"
    if stands:
        return f"stands {limits}"
    return f"goal {limits}" if goal else ""


def beyond_stored_limits(
    servos: BusMap, lowest: FloatArray, highest: FloatArray, least: FloatArray, most: FloatArray
) -> list[str]:
    """Notes on the joints whose goals go beyond the limits stored in their servos.

    Args:
        servos: which servo moves which joint.
        lowest: stored limits in counts, (18,).
        highest: the others.
        least: lowest goals that the robot needs in counts, (18,).
        most: highest goals that it needs.
    """
    beyond = (np.rint(least) < lowest) | (np.rint(most) > highest)
    return [
        f"its stored limits {lowest[joint]:.0f} to {highest[joint]:.0f} end within the joint's "
        f"{least[joint]:.0f} to {most[joint]:.0f}: {servos.names(np.arange(N_JOINTS) == joint)}"
        for joint in np.flatnonzero(beyond).tolist()
    ]


def needed_counts(servos: BusMap, robot: Robot) -> tuple[FloatArray, FloatArray]:
    """Lowest and highest goals of a robot's joint limits, within those of its servos, in counts, (18,)."""
    ends = np.array([servos.raw(robot.joint_lower_rad), servos.raw(robot.joint_upper_rad)])
    within = np.clip(ends, servos.least, servos.most)
    return np.asarray(within.min(axis=0)), np.asarray(within.max(axis=0))
