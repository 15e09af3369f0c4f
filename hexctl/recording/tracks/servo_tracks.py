"""Tracks of what is only sampled: torques and the commanded velocity, and what servos report."""

import numpy as np

from hexctl.recording.series import SAMPLED, SERVOS
from hexctl.recording.tracks.columns import Block


def send_samples(block: Block) -> None:
    """Send columns of the log ten times a second where they are known: at every tick they fill the file."""
    for series in SAMPLED:
        values, rows = block.column(str(series.source)), block.sparse()
        rows = rows[np.isfinite(values[rows]).all(axis=-1)]
        block.plot(series, rows, values[rows])


def send_servos(block: Block) -> None:
    """Send what the servos report, if it is known of any; what is unknown of one leaves a gap."""
    readings = block.log.servo_rows.between(block.start, block.stop)
    for series in SERVOS:
        known = [(row, getattr(servos, str(series.source))) for row, servos in readings]
        known = [(row, values) for row, values in known if np.isfinite(values).any()]
        if known:
            values = np.stack([np.where(np.isfinite(values), values, np.nan) for _, values in known])
            block.plot(series, np.array([row for row, _ in known]) - block.start, values)
