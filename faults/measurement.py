"""What became of a robot after a fault, by the twin's own truth."""

from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view

from faults.fault import FAULTS, safe_reaction
from faults.phase import PHASES
from faults.programs.truth import Truth
from hexctl.backends.clock import PERIOD_S
from hexctl.control.guard import EXPIRY_S, FALL_COS_TILT, FALL_TICKS
from hexctl.server.idle import STILL_RAD, STILL_S
from hexctl.types import FloatArray

#: Control periods in which a joint has to stay where it is, to be at rest as `hexctl estop` has it.
STILL_ROWS = round(STILL_S / PERIOD_S)

#: In the last part of what was watched, a joint of a robot that goes on moves by more than this, in rad.
LAST_S, GOES_ON_RAD = 0.3, 0.05

#: What the machine may add to the period of a twin: beyond, times are the machine's.
PUNCTUAL_S = 0.02

#: Limit on the lateness of a link's thread: half of the silence after which a guard stops. Times above it do
#: not count.
MOST_WAIT_S = EXPIRY_S / 2

#: A step is too large beyond what a joint may turn and rounding of the servos' counts.
ROUNDING = 1.05

#: Longest time in which a joint goes on with a command, and by how much a message may come early.
SILENCE_S, JITTER_S = 0.2, 0.005

#: How well the moment is known at which it is noted what servos steer for.
NOTED_S = 0.0005

#: Bars: at rest within, for 99.9 %, and at most.
REST_S, MOST_REST_S, SHARE = 0.25, 0.5, 0.999


@dataclass(frozen=True, slots=True, kw_only=True)
class Outcome:
    """One injection.

    Attributes:
        fault: name.
        backend: name.
        phase: name.
        repetition: from 0; with the names it is the seed of the moment at which the fault begins.
        rest_s: from the fault until it is at rest; None for a robot that still moves at the end.
        told_s: from the fault to the last change of what the servos were told.
        step: largest change that a servo was told at once, in slew limits of a control period.
        pace: the same in what a joint may turn in the time since it was told the last time, which is longer
            than a control period where messages were lost.
        fell: whether the body leant too far for so long as a fall takes.
        stops: what the server said of stops, in its words.
        ended: what ended the controller, empty for nothing.
        trials: that were said to be stored, None without trials.
        lost: of these, missing in the store.
        goes_on: whether a joint moved at the end.
        late_s: by how much the twin was late at most, which is the machine's doing.
        waited_s: maximum lateness of a thread without real-time priority, such as those of a link.
        commit: of the code that was measured, empty where it is not known.
    """

    fault: str
    backend: str
    phase: str
    repetition: int
    rest_s: float | None
    told_s: float
    step: float
    fell: bool
    pace: float = 0.0
    stops: tuple[str, ...] = ()
    ended: str = ""
    trials: int | None = None
    lost: int | None = None
    goes_on: bool = False
    late_s: float = 0.0
    waited_s: float = 0.0
    commit: str = ""

    @property
    def key(self) -> tuple[str, str, str, int]:
        """What it is an outcome of."""
        return self.fault, self.backend, self.phase, self.repetition

    @property
    def safe(self) -> str:
        """The reaction that is safe."""
        return safe_reaction(FAULTS[self.fault], self.phase, self.backend)

    @property
    def punctual(self) -> bool:
        """Whether the machine had time for it."""
        return self.late_s <= PUNCTUAL_S and self.waited_s <= MOST_WAIT_S

    @property
    def stopped(self) -> bool:
        """Whether a server or a controller stopped it."""
        return bool(self.stops or self.ended)

    @property
    def unneeded(self) -> bool:
        """Whether it stopped although it is safe to go on, or stood still without a word."""
        if self.safe != "goes on":
            return False
        return self.stopped or (PHASES[self.phase].moves and not self.goes_on)

    @property
    def timed(self) -> bool:
        """Whether its time to rest counts against the bar: nothing has to be noticed first."""
        fault = FAULTS[self.fault]
        return self.safe == "rests" and not fault.detected

    @property
    def jumped(self) -> bool:
        """Whether a servo was told to go further than its joint may turn since it was told last."""
        return self.pace > ROUNDING

    def as_json(self) -> dict[str, Any]:
        """As a line of the results, without what is usual."""
        usual = Outcome(
            fault="",
            backend="",
            phase="",
            repetition=-1,
            rest_s=-1.0,
            told_s=-1.0,
            step=-1.0,
            fell=False,
        )
        values = asdict(self)
        return {name: value for name, value in values.items() if value != getattr(usual, name)}

    @classmethod
    def from_json(cls, values: dict[str, Any]) -> "Outcome":
        """Outcome of `as_json`."""
        return cls(**{"rest_s": None, "fell": False, **values, "stops": tuple(values.get("stops", ()))})


def rest_after_s(truth: Truth, at_s: float) -> float | None:
    """How long after a moment a robot was at rest; None for one that moves to the end.

    It is from when on no joint turns by more than `STILL_RAD` in any `STILL_S`: feet under load that creep
    over the floor of a simulation for seconds, at less than 0.1 rad/s in the joints, are at rest.
    """
    rows = truth.at_s >= at_s
    times_s, joints_rad = truth.at_s[rows] - at_s, truth.joints_rad[rows]
    if times_s.size <= STILL_ROWS:
        return None
    moves = np.ptp(sliding_window_view(joints_rad, STILL_ROWS + 1, axis=0), axis=-1).max(axis=1) > STILL_RAD
    if moves[-1]:
        return None
    last = np.flatnonzero(moves)
    return float(times_s[last[-1] + 1]) if last.size else 0.0


def told_after_s(truth: Truth, at_s: float) -> float:
    """How long after a moment servos were told something new last."""
    changed = np.flatnonzero((np.diff(np.nan_to_num(truth.told_rad), axis=0) != 0).any(axis=1)) + 1
    last_s = truth.told_at_s[changed[-1]] if changed.size else at_s
    return max(0.0, float(last_s - at_s))


def largest_steps(
    truth: Truth, at_s: float, max_speed_rad_s: FloatArray, *, continuous: bool = False
) -> tuple[float, float]:
    """Largest step that a servo was told since a moment, and pace of it.

    The step is in slew limits of a control period, the pace in those of the time since the servos were told
    something else, up to `SILENCE_S`, plus `JITTER_S`; of a control period at the least. Targets that are
    `continuous`, as they change while moves go on, come at no time of their own: `NOTED_S` is added. A servo
    that had no torque is told a step from where its joint is.
    """
    rows = np.flatnonzero(truth.told_at_s >= at_s)
    if not rows.size:
        return 0.0, 0.0
    first = max(0, rows[0] - 1)
    told, times_s = truth.told_rad[first:], truth.told_at_s[first:]
    if len(told) < 2:
        return 0.0, 0.0
    earlier = np.arange(len(told) - 1)
    if continuous:  # what is noted oftener than once in a control period says little of the speed
        earlier = np.minimum(earlier, np.searchsorted(times_s, times_s[1:] - PERIOD_S, side="right") - 1)
        earlier = np.maximum(earlier, 0)
    before = np.where(np.isnan(told[earlier]), _joints_rad(truth, times_s[1:]), told[earlier])
    steps = np.abs(told[1:] - before) / (max_speed_rad_s * PERIOD_S)
    passed_s = np.minimum(times_s[1:] - times_s[earlier] + (NOTED_S if continuous else JITTER_S), SILENCE_S)
    periods = np.maximum(1.0, passed_s / PERIOD_S)[:, np.newaxis]
    return float(np.nanmax(steps, initial=0.0)), float(np.nanmax(steps / periods, initial=0.0))


def _joints_rad(truth: Truth, times_s: FloatArray) -> FloatArray:
    """Where the joints were at times, (n, 18); NaN before the first control period."""
    rows = np.searchsorted(truth.at_s, times_s, side="right") - 1
    if not truth.at_s.size:
        return np.full((times_s.size, truth.joints_rad.shape[1]), np.nan)
    return np.where((rows >= 0)[:, np.newaxis], truth.joints_rad[np.maximum(rows, 0)], np.nan)


def fell_after(truth: Truth, at_s: float) -> bool:
    """Whether the body leant too far for as long as a fall takes, since a moment."""
    leans = truth.cos_tilt[truth.at_s >= at_s] < FALL_COS_TILT
    return bool(np.convolve(leans, np.ones(FALL_TICKS), "valid").max(initial=0) >= FALL_TICKS)


def late_s(truth: Truth, at_s: float) -> float:
    """By how much a control period of the twin was longer than it should be, at most, since a moment."""
    times_s = truth.at_s[truth.at_s >= at_s]
    return max(0.0, float(np.diff(times_s).max(initial=0.0)) - PERIOD_S)


def goes_on(truth: Truth) -> bool:
    """Whether a joint moves at the end."""
    if not truth.at_s.size:
        return False
    last_rad = truth.joints_rad[truth.at_s > truth.at_s[-1] - LAST_S]
    return float(np.ptp(last_rad, axis=0).max()) > GOES_ON_RAD
