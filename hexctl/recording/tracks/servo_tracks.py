"""Tracks of vectors: joint angles, torques, the commanded velocity, and reports of servos."""

import numpy as np

from hexctl.recording.series import SAMPLED, SERVOS, VECTORS
from hexctl.recording.tracks.columns import Block


def send_vectors(block: Block) -> None:
    """Send the angles of all joints at every tick, in which both are known."""
    both = [block.column(str(series.source)) for series in VECTORS]
    rows = np.flatnonzero(np.isfinite(both).all(axis=(0, 2)))
    if rows.size:
        for series, values in zip(VECTORS, both, strict=True):
            block.send_vectors(series, rows, values[rows])


def send_samples(block: Block) -> None:
    """Send columns of the log at 10 Hz if known: at every tick they would fill the file."""
    for series in SAMPLED:
        values, rows = block.column(str(series.source)), block.sparse()
        rows = rows[np.isfinite(values[rows]).all(axis=-1)]
        block.plot(series, rows, values[rows])


def send_servos(block: Block) -> None:
    """Send the reports of servos, if any; an unknown value leaves a gap."""
    readings = block.log.servo_rows.between(block.start, block.stop)
    for series in SERVOS:
        known = [(row, getattr(servos, str(series.source))) for row, servos in readings]
        known = [(row, values) for row, values in known if np.isfinite(values).any()]
        if known:
            values = np.stack([np.where(np.isfinite(values), values, np.nan) for _, values in known])
            block.plot(series, np.array([row for row, _ in known]) - block.start, values)
