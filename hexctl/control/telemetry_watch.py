"""Reports of robots: temperatures, voltages and positions with spikes and gaps, and warnings."""

import math
import re
from collections import deque
from collections.abc import Collection, Sequence

import numpy as np

from hexctl.types import TOO_HOT_C, WARM_C, FloatArray

#: Share of the pace that remains with almost too hot servos.
LEAST_PACE = 0.4

#: Plausible change of a temperature at once, and per second; a larger one counts once it has lasted.
JUMP_C, RATE_C_S, LASTS_S = 6.0, 2.0, 2.0

#: A temperature that a servo has not reported for this long is unknown.
FORGOTTEN_S = 30.0

#: A battery is low if most readings of this long are, and at least so many.
BATTERY_S, LEAST_READINGS = 2.0, 5

#: Gap between readings after which earlier ones do not count.
GAP_S = 1.0

#: A figure of a warning, which is the same warning with another one.
_FIGURE = re.compile(r"[\d.]+(?= degrees C| %| V)")

#: Servos in a warning.
ALL_SERVOS = "all servos"
_SERVO = re.compile(ALL_SERVOS + r"|leg \d \w+(?: \(id \d+\))?")

#: Beginning of a guard's stop for a hot servo.
HOT = "hot"

#: Servos that a warning, a guard's reason or a part of one calls hot, without their temperature.
_HOT_SERVOS = re.compile(rf"(?:^|; )[^;:]*\b{HOT}\b[^;:]*: ([^;:]+?)(?: \d+ C)?(?=;|$)")


def pace(temperatures_c: FloatArray) -> float:
    """Share of the pace, 1 to `LEAST_PACE`, at temperatures (n,); NaN if unknown."""
    hottest_c = float(np.nanmax(temperatures_c)) if np.isfinite(temperatures_c).any() else 0.0
    over = (hottest_c - WARM_C) / (TOO_HOT_C - WARM_C)
    return float(np.clip(1 - (1 - LEAST_PACE) * over, LEAST_PACE, 1.0))


class Temperatures:
    """Accepted temperatures of servos.

    A servo warms by less than a degree per second. A jump is accepted once it has lasted, the first reading
    at once; a missing one changes nothing.
    """

    def __init__(self) -> None:
        self._accepted_c: FloatArray | None = None
        self._doubted: FloatArray = np.empty(0)
        self._since_s: FloatArray = np.empty(0)
        self._seen_s: FloatArray = np.empty(0)

    def take(self, temperatures_c: FloatArray, now_s: float) -> FloatArray:
        """Accepted temperatures, (n,), with new readings, (n,); NaN before the first."""
        new = np.asarray(temperatures_c, dtype=float)
        if self._accepted_c is None or self._accepted_c.shape != new.shape:
            self._accepted_c, self._doubted = np.full(new.shape, np.nan), np.full(new.shape, np.nan)
            self._since_s, self._seen_s = np.full(new.shape, now_s), np.full(new.shape, now_s)
        known = np.isfinite(new)
        self._accepted_c[now_s - self._seen_s > FORGOTTEN_S] = np.nan
        reach_c = JUMP_C + RATE_C_S * np.maximum(now_s - self._seen_s, 0.0)
        plausible = known & ~(np.abs(new - self._accepted_c) > reach_c)  # true for the first, too
        doubted = known & ~plausible
        again = np.abs(new - self._doubted) <= JUMP_C
        self._since_s[doubted & ~again] = now_s
        lasts = doubted & again & (now_s - self._since_s >= LASTS_S)
        self._doubted = np.where(doubted, new, np.where(plausible, np.nan, self._doubted))
        self._accepted_c = np.where(plausible | lasts, new, self._accepted_c)
        self._seen_s[known] = now_s
        return self._accepted_c


class BatteryWatch:
    """Whether a battery has been low for a while: dips of a step and single wrong readings are none."""

    def __init__(self) -> None:
        self._readings: deque[tuple[float, float]] = deque()
        self.voltage_v = np.nan

    def low(self, voltage_v: float | None, least_v: float | None, now_s: float) -> bool:
        """Whether the median of the last seconds, `voltage_v` of this watch, is below a threshold."""
        if voltage_v is None or least_v is None or not np.isfinite(voltage_v):
            return False
        readings = self._readings
        if readings and not 0 <= now_s - readings[-1][0] <= GAP_S:
            readings.clear()
        readings.append((now_s, voltage_v))
        while now_s - readings[0][0] > BATTERY_S:
            readings.popleft()
        self.voltage_v = float(np.median([volts for _, volts in readings]))
        enough = len(readings) >= LEAST_READINGS and now_s - readings[0][0] >= 0.9 * BATTERY_S
        return enough and self.voltage_v < least_v


class SeenWarnings:
    """Warnings of a robot, one of each kind, with all its servos so far.

    Kinds differ by more than servos and figures, such as a temperature.
    """

    def __init__(self, known: tuple[str, ...] = ()) -> None:
        """Begin; `known` are warnings that were reported before."""
        self._newest: tuple[str, ...] = ()
        self._texts: dict[str, str] = {}
        self._servos: dict[str, dict[str, None]] = {}  # in their order
        self._new: dict[str, None] = {}
        self.take(known)
        self._new.clear()

    @property
    def texts(self) -> tuple[str, ...]:
        """All warnings so far, with their newest figures."""
        return tuple(self._texts.values())

    @property
    def news(self) -> tuple[str, ...]:
        """Those of `texts` with something new: another kind of warning, or another servo."""
        return tuple(self._texts[kind] for kind in self._new)

    def take(self, warnings: tuple[str, ...]) -> list[str]:
        """Take the warnings of a state; the new ones, of a known kind with the new servos only."""
        if warnings == self._newest:
            return []
        self._newest = warnings
        return [new for text in warnings if (new := self._take(text))]

    def _take(self, text: str) -> str:
        """What is new in a warning; empty for nothing."""
        named = _SERVO.findall(text)
        kind = _FIGURE.sub("", _with_servos(text, []))
        known, seen = kind in self._texts, self._servos.setdefault(kind, {})
        added = [] if ALL_SERVOS in seen else [each for each in named if each not in seen]
        seen |= dict.fromkeys(named)
        self._texts[kind] = _with_servos(text, [ALL_SERVOS] if ALL_SERVOS in seen else list(seen))
        if known and not added:
            return ""
        self._new[kind] = None
        return _with_servos(text, added)


def _with_servos(text: str, servos: Sequence[str]) -> str:
    """A warning with other servos in place of its list."""
    found = list(_SERVO.finditer(text))
    if not found:
        return text
    return text[: found[0].start()] + ", ".join(servos) + text[found[-1].end() :]


def with_troubles(reason: str, warnings: Sequence[str], legs: Collection[int]) -> str:
    """A reason to stop for failed legs, 1..6, with the warnings of their servos: they may be the cause.

    Warm servos are none, because they still work.
    """
    names = [f"leg {leg} " for leg in legs]
    troubles = [
        text for text in warnings if not text.startswith("warm") and any(name in text for name in names)
    ]
    return "; ".join([reason, *troubles])


def hot_servos(*texts: str) -> str:
    """Names of servos that must cool down, by the first warning or reason to stop with any; else empty."""
    return next((found[1] for text in texts if (found := _HOT_SERVOS.search(text))), "")


#: Maximum speed in m/s, also if the robot is carried.
MOST_SPEED_M_S = 5.0

#: Maximum sudden correction of an estimate; steering handles smaller jumps.
MOST_CORRECTION_M = 2.0

#: Maximum distance from any origin on Earth.
MOST_M = 1e8

#: How long a jump is reported, in s: a report of a single tick would be missed.
REPEAT_S = 2.0


class PositionCheck:
    """Checks the positions of one robot in sequence; counts doubted ones, accepts plausible later jumps.

    Positions jump if a tracking system confuses objects, a message is damaged, or a frame is reset.
    """

    def __init__(self) -> None:
        self.doubted = 0
        self._last: list[float] | None = None
        self._last_at_s = 0.0
        self._doubted: list[float] | None = None
        self._doubted_at_s = -math.inf
        self._jump_m = 0.0

    def accepts(self, position_world: FloatArray, now_s: float) -> bool:
        """Whether a position (3,) in m is plausible at a time, in s on any clock."""
        position = position_world.tolist()
        if self._last is None:
            step_m, most_m = max(map(abs, position)), MOST_M
        else:
            step_m = math.dist(position, self._last)
            most_m = MOST_CORRECTION_M + MOST_SPEED_M_S * max(0.0, now_s - self._last_at_s)
        if not step_m <= min(most_m, MOST_M):  # true for nan too
            if now_s - self._doubted_at_s > REPEAT_S:
                self._jump_m = step_m
            self.doubted += position != self._doubted  # the same one is read repeatedly
            self._doubted, self._doubted_at_s = position, now_s
            return False
        self._last, self._last_at_s = position, now_s
        return True

    def doubt(self, now_s: float) -> str | None:
        """Message about a recent jump, the first of several, or None."""
        if now_s - self._doubted_at_s > REPEAT_S:
            return None
        return f"the position jumped by {self._jump_m:.3g} m, which is ignored"

    def forget(self) -> None:
        """Accept the next position as it is, for a robot that may have been carried."""
        self._last = None
