"""What robots report of themselves: temperatures and voltages with spikes and gaps, and warnings."""

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

#: Temperature at the end of a guard's reason.
_READING = re.compile(r" \d+ C$")


def pace(temperatures_c: FloatArray) -> float:
    """Share of the pace, 1 to `LEAST_PACE`, at temperatures (n,); NaN if unknown."""
    hottest_c = float(np.nanmax(temperatures_c)) if np.isfinite(temperatures_c).any() else 0.0
    over = (hottest_c - WARM_C) / (TOO_HOT_C - WARM_C)
    return float(np.clip(1 - (1 - LEAST_PACE) * over, LEAST_PACE, 1.0))


class Temperatures:
    """Believed temperatures of servos.

    A servo warms by less than a degree per second. A jump is believed once it has lasted, the first reading
    at once; a missing one changes nothing.
    """

    def __init__(self) -> None:
        self._believed: FloatArray | None = None
        self._doubted: FloatArray = np.empty(0)
        self._since_s: FloatArray = np.empty(0)
        self._seen_s: FloatArray = np.empty(0)

    def take(self, temperatures_c: FloatArray, now_s: float) -> FloatArray:
        """Believed temperatures, (n,), with new readings, (n,); NaN before the first."""
        new = np.asarray(temperatures_c, dtype=float)
        if self._believed is None or self._believed.shape != new.shape:
            self._believed, self._doubted = np.full(new.shape, np.nan), np.full(new.shape, np.nan)
            self._since_s, self._seen_s = np.full(new.shape, now_s), np.full(new.shape, now_s)
        known = np.isfinite(new)
        self._believed[now_s - self._seen_s > FORGOTTEN_S] = np.nan
        reach_c = JUMP_C + RATE_C_S * np.maximum(now_s - self._seen_s, 0.0)
        plausible = known & ~(np.abs(new - self._believed) > reach_c)  # true for the first, too
        doubted = known & ~plausible
        again = np.abs(new - self._doubted) <= JUMP_C
        self._since_s[doubted & ~again] = now_s
        lasts = doubted & again & (now_s - self._since_s >= LASTS_S)
        self._doubted = np.where(doubted, new, np.where(plausible, np.nan, self._doubted))
        self._believed = np.where(plausible | lasts, new, self._believed)
        self._seen_s[known] = now_s
        return self._believed


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
    """Warnings of a robot, each once: another figure, such as a temperature, makes no new one."""

    def __init__(self) -> None:
        self._newest: tuple[str, ...] = ()
        self._texts: dict[str, str] = {}

    @property
    def texts(self) -> tuple[str, ...]:
        """All warnings so far, with their newest figures."""
        return tuple(self._texts.values())

    def take(self, warnings: tuple[str, ...]) -> list[str]:
        """Take the warnings of a state; the new ones."""
        if warnings == self._newest:
            return []
        self._newest = warnings
        by_words = {_FIGURE.sub("", text): text for text in warnings}
        new = [text for words, text in by_words.items() if words not in self._texts]
        self._texts |= by_words
        return new


def with_troubles(reason: str, warnings: Sequence[str], legs: Collection[int]) -> str:
    """A reason to stop for failed legs, 1..6, with the warnings of their servos: they may be the cause.

    Warm servos are none, because they still work.
    """
    names = [f"leg {leg} " for leg in legs]
    troubles = [
        text for text in warnings if not text.startswith("warm") and any(name in text for name in names)
    ]
    return "; ".join([reason, *troubles])


def hot_servos(warnings: Sequence[str], stopped: str | None) -> str:
    """Names of servos that must cool down, by the warnings of a walk and the reason of its stop, or none."""
    for text in (*warnings, stopped or ""):
        if text.startswith("hot"):
            return _READING.sub("", text.partition(": ")[2])
    return ""
