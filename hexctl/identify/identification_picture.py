"""Picture of an identification: measured angles against simulated ones, before and after."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import MissingExtraError
from hexctl.identify.bench_run import BenchRun
from hexctl.identify.fit import Replay
from hexctl.identify.identification import Identification
from hexctl.identify.parameters import RobotValues
from hexctl.identify.robot_log import RobotLog
from hexctl.types import JOINT_KINDS, JOINT_NAMES, FloatArray

#: Maximum number of shown logs and joints.
MOST_ROWS = 4

Curve = tuple[str, FloatArray, FloatArray, FloatArray]


def draw_identification(found: Identification, before: RobotValues | None, path: Path) -> None:
    """Draw some joints or runs over time; raises MissingExtraError without Matplotlib."""
    try:
        from matplotlib.figure import Figure
    except ImportError as error:
        raise MissingExtraError("the picture of an identification", "study") from error
    curves = _curves(found.replays, found.fit.values)
    figure = Figure(figsize=(9, 2.4 * len(curves)), layout="constrained")
    axes = figure.subplots(len(curves), 1, squeeze=False)[:, 0]
    earlier = _curves(found.replays, before) if before is not None else [None] * len(curves)
    for one, curve, old in zip(axes, curves, earlier, strict=True):
        _draw(one, curve, old)
    axes[-1].set_xlabel("time in s")
    axes[0].legend(loc="upper right", fontsize="small", ncols=3)
    figure.savefig(path, dpi=120)


def _draw(axes: Any, curve: Curve, old: Curve | None) -> None:
    name, time_s, measured_rad, simulated_rad = curve
    axes.plot(time_s, np.degrees(measured_rad), color="black", linewidth=1.5, label="measured")
    if old is not None:
        axes.plot(time_s, np.degrees(old[3]), color="tab:orange", linewidth=1, label="robot file before")
    axes.plot(time_s, np.degrees(simulated_rad), color="tab:blue", linewidth=1, label="identified")
    error_deg = float(np.degrees(np.abs(simulated_rad - measured_rad)).mean())
    axes.set_title(f"{name}: {error_deg:.2f} deg of mean error", fontsize="small", loc="left")
    axes.set_ylabel("deg")


def _curves(replays: Sequence[Replay[Any]], values: Any) -> list[Curve]:
    """Name, times, measured and simulated angles: the last runs of a bench, or three joints of a robot."""
    curves: list[Curve] = []
    for replay in replays[-MOST_ROWS:]:
        if isinstance(replay, BenchRun):
            simulated = replay.measured_rad + replay.errors_rad(values)
            curves.append((replay.name, replay.time_s, replay.measured_rad, simulated))
        elif isinstance(replay, RobotLog):
            errors = replay.errors_rad(values)
            for joint in range(len(JOINT_KINDS)):
                measured = replay.measured_rad[:, joint]
                since_s = replay.time_s - replay.time_s[0]
                curves.append((JOINT_NAMES[joint], since_s, measured, measured + errors[:, joint]))
            break
    return curves
