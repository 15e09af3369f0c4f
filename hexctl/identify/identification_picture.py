"""Picture of an identification: measured and simulated angles, and the errors before and after."""

import io
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import MissingExtraError, argument
from hexctl.files import write_new
from hexctl.identify.identification import Identification
from hexctl.identify.parameters import ServoValues
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray

#: Maximum number of shown logs, a row each.
MOST_ROWS = 3

#: Duration of the shown part of a log, the one with the largest error before.
SHOWN_S = 4.0

MEASURED, BEFORE, NOW = ("measured", "black"), ("robot file before", "tab:orange"), ("identified", "tab:blue")


def draw_identification(identified: Identification, before: ServoValues | None, path: Path) -> None:
    """Draw a joint of each log, or runs on a bench, as a new PNG; raises InputError, MissingExtraError."""
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtraError("the picture of an identification", "study") from error
    replays = identified.replays[-MOST_ROWS:]
    values = {NOW: identified.fit.values} if before is None else {BEFORE: before, NOW: identified.fit.values}
    figure = Figure(figsize=(11, 0.6 + 2.8 * len(replays)), layout="constrained")
    for replay, (angles, left) in zip(replays, figure.subplots(len(replays), 2, squeeze=False), strict=True):
        _draw_part(replay, values, angles, left)
    handles, labels = angles.get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside upper center", ncols=3)
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=120)
    write_new(path, picture.getvalue(), argument("output"))


def _draw_part(replay: Any, values: Mapping[tuple[str, str], ServoValues], angles: Any, left: Any) -> None:
    """Draw the part and the joint of a log with the largest error, of the first values."""
    errors_rad = {label: _columns(replay.errors_rad(one)) for label, one in values.items()}
    part, joint = _worst(np.abs(next(iter(errors_rad.values()))), replay.time_s)
    time_s = (replay.time_s - replay.time_s[0])[part]
    measured_deg = np.degrees(_columns(replay.measured_rad)[part, joint])
    name, color = MEASURED
    angles.plot(time_s, measured_deg, color=color, linewidth=2.5, label=name)
    for (name, color), found_rad in errors_rad.items():
        error_deg = np.degrees(found_rad[part, joint])
        angles.plot(time_s, measured_deg + error_deg, color=color, linewidth=1.3, label=name)
        left.plot(time_s, error_deg, color=color, linewidth=1.3)
    means = " -> ".join(f"{np.degrees(np.abs(one).mean()):.2f}" for one in errors_rad.values())
    of_robot = next(iter(errors_rad.values())).shape[1] == N_JOINTS
    title = f"{replay.name}, {JOINT_NAMES[joint] if of_robot else 'joint'}; mean error of the log {means} deg"
    angles.set_title(title, fontsize="medium", loc="left")
    left.set_title("simulated less measured", fontsize="medium", loc="left")
    for axes, what in ((angles, "angle"), (left, "error")):
        axes.set(xlabel="time in s", ylabel=f"{what} in deg")


def _worst(sizes_rad: FloatArray, time_s: FloatArray) -> tuple[slice, int]:
    """Rows of the shown part, and the joint, with the largest sum of errors, (T, joints)."""
    count = min(len(time_s), round(SHOWN_S / float(np.diff(time_s).mean())))
    sums = np.cumsum(np.vstack([np.zeros(sizes_rad.shape[1]), sizes_rad]), axis=0)
    first, joint = np.unravel_index(np.argmax(sums[count:] - sums[:-count]), sums[count:].shape)
    return slice(int(first), int(first) + count), int(joint)


def _columns(values: FloatArray) -> FloatArray:
    """Values over time in columns, (T, joints)."""
    return values.reshape(len(values), -1)
