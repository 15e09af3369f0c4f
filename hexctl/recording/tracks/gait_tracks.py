"""Tracks of the gait: phases of the trial, stance and swing of each foot, contacts, and the guard."""

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.clock import PERIOD_S
from hexctl.control.trace import PHASES
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.tracks.block import Block
from hexctl.types import BoolArray, FloatArray

#: Targets that differ by less count as unchanged: they were rounded in transit.
ROUNDING_RAD = 1e-5

#: Ticks for which a foot's contact must differ from the command to be shown, which skips rebounds.
STEADY_TICKS = 5


def clipped_joints(requested_rad: FloatArray, commanded_rad: FloatArray) -> BoolArray:
    """Whether the guard changed each joint's target, any shape."""
    return np.asarray(np.abs(commanded_rad - requested_rad) > ROUNDING_RAD)


def skipped_ticks(time_s: FloatArray) -> FloatArray:
    """Number of periods missed before each tick, (ticks,)."""
    return np.asarray(np.maximum(np.round(np.diff(time_s, prepend=time_s[:1]) / PERIOD_S) - 1, 0))


def send_phases(block: Block) -> None:
    """Send the start of each part of the trial."""
    block.send_states(paths.PHASE, block.led("phase"), PHASES)


def send_gait(block: Block) -> None:
    """Send changes of stance and swing of each foot, as commanded and, where contacts are known, as felt."""
    states = _felt(block)
    for leg in paths.LEGS:
        block.send_states(paths.gait_path(leg), states[:, leg - 1], style.FELT_STATES)


def _felt(block: Block) -> NDArray[np.int64]:
    """States of the feet as indices of `style.FELT_STATES`, preceded by one row, (rows + 1, 6)."""
    swing = block.swing(STEADY_TICKS)
    other = steadily(swing == block.led("foot_contacts", STEADY_TICKS))
    states = 2 * swing.astype(np.int64) + (swing == other)
    return np.asarray(states[max(min(block.start, STEADY_TICKS) - 1, 0) :])


def steadily(is_so: BoolArray) -> BoolArray:
    """Whether a value has been true for the last `STEADY_TICKS` rows, same shape."""
    steady = is_so.copy()
    for back in range(1, STEADY_TICKS):
        steady[back:] &= is_so[:-back]
        steady[:back] = False
    return steady


def send_feet(block: Block) -> None:
    """Send changes of contact as the foot's colour; unknown contact has another one."""
    shown = np.nan_to_num(block.led("foot_contacts"), nan=2).astype(int)
    states = (style.LIFTED_COLOR, style.TOUCHING_COLOR, style.UNFELT_COLOR)
    colors = np.array([style.packed(color) for color in states], dtype=np.uint32)
    for leg in paths.LEGS:
        rows = block.changes(shown[:, leg - 1])
        if rows.size:
            color = colors[block.without_lead(shown)[rows, leg - 1]]
            block.send(paths.foot_path(leg), rows, load_rerun().Points3D.columns(colors=color))


def send_guard(block: Block) -> None:
    """Send changed targets and missed ticks."""
    states = clipped_joints(block.led("requested_rad"), block.led("commanded_rad")).any(axis=-1).astype(int)
    states[skipped_ticks(block.led("time_s")) > 0] = 2
    block.send_states(paths.GUARD, states, style.GUARD_STATES)
