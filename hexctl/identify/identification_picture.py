"""Picture of an identification: measured and simulated angles, and the errors before and after."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import MissingExtraError
from hexctl.identify.identification import Identification
from hexctl.identify.parameters import ServoValues
from hexctl.types import JOINT_NAMES, N_JOINTS, ArrayFields, FloatArray

#: Maximum number of shown logs, a row each.
MOST_ROWS = 3

#: Duration of the shown part of a log, the one with the largest error before.
SHOWN_S = 4.0

MEASURED, BEFORE, NOW = ("measured", "black"), ("robot file before", "tab:orange"), ("identified", "tab:blue")


def draw_identification(found: Identification, before: ServoValues | None, path: Path) -> None:
    """Draw a joint of each log, or runs on a bench; raises MissingExtraError without Matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("the picture of an identification", "study") from error
    rows = [_Row.of(replay, found.fit.values, before) for replay in found.replays[-MOST_ROWS:]]
    figure = Figure(figsize=(11, 0.6 + 2.8 * len(rows)), layout="constrained")
    for row, (angles, errors) in zip(rows, figure.subplots(len(rows), 2, squeeze=False), strict=True):
        row.draw(angles, errors)
    handles, labels = angles.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    figure.savefig(path, dpi=120)


@dataclass(frozen=True, eq=False)
class _Row(ArrayFields):
    """The shown part of a log: a joint, its angles, and errors (simulated less measured) by label."""

    title: str
    time_s: FloatArray
    measured_rad: FloatArray
    errors_rad: dict[tuple[str, str], FloatArray]

    @classmethod
    def of(cls, replay: Any, now: ServoValues, before: ServoValues | None) -> "_Row":
        """Part and joint with the largest error, before if that is known."""
        values = {BEFORE: before, NOW: now} if before is not None else {NOW: now}
        errors = {label: _columns(replay.errors_rad(one)) for label, one in values.items()}
        measured, time_s = _columns(replay.measured_rad), replay.time_s - replay.time_s[0]
        largest = np.abs(next(iter(errors.values())))
        count = min(len(time_s), round(SHOWN_S / float(np.diff(time_s).mean())))
        sums = np.cumsum(np.vstack([np.zeros(largest.shape[1]), largest]), axis=0)
        first, joint = np.unravel_index(np.argmax(sums[count:] - sums[:-count]), sums[count:].shape)
        part = slice(int(first), int(first) + count)
        means = [f"{np.degrees(np.abs(one).mean()):.2f}" for one in errors.values()]
        name = JOINT_NAMES[joint] if largest.shape[1] == N_JOINTS else "joint"
        return cls(
            f"{replay.name}, {name}; mean error of the log {' -> '.join(means)} deg",
            time_s[part],
            measured[part, joint],
            {label: one[part, joint] for label, one in errors.items()},
        )

    def draw(self, angles: Any, left: Any) -> None:
        """Draw the angles and the errors."""
        name, color = MEASURED
        angles.plot(self.time_s, np.degrees(self.measured_rad), color=color, linewidth=2.5, label=name)
        for (name, color), errors_rad in self.errors_rad.items():
            simulated = np.degrees(self.measured_rad + errors_rad)
            angles.plot(self.time_s, simulated, color=color, linewidth=1.3, label=name)
            left.plot(self.time_s, np.degrees(errors_rad), color=color, linewidth=1.3)
        angles.set_title(self.title, fontsize="medium", loc="left")
        left.set_title("simulated less measured", fontsize="medium", loc="left")
        for axes, what in ((angles, "angle"), (left, "error")):
            axes.set(xlabel="time in s", ylabel=f"{what} in deg")


def _columns(values: FloatArray) -> FloatArray:
    """Values over time in columns, (T, joints)."""
    return values.reshape(len(values), -1)
