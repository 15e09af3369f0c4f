"""Tracks of joints and their servos: torques; temperatures, voltages, currents and ages of the angles."""

import numpy as np

from hexctl.recording import paths
from hexctl.recording.rrd import load_rerun
from hexctl.recording.tracks.columns import TORQUE_BITS, Block, rounded
from hexctl.types import N_JOINTS

#: Entity of each reading, by attribute of `ServoReadings`.
READINGS = {
    "temperatures_c": paths.TEMPERATURES,
    "voltages_v": paths.VOLTAGES,
    "currents_a": paths.CURRENTS,
    "ages_s": paths.AGES,
}


def send_servos(block: Block) -> None:
    """Send what the servos report, as far as it is known of any; what is unknown of one leaves a gap."""
    readings = block.log.servo_rows.between(block.start, block.stop)
    for name, path in READINGS.items():
        known = [(row, getattr(servos, name)) for row, servos in readings]
        known = [(row, values) for row, values in known if np.isfinite(values).any()]
        if known:
            values = np.stack([np.where(np.isfinite(values), values, np.nan) for _, values in known])
            scalars = load_rerun().Scalars.columns(scalars=rounded(values, TORQUE_BITS).ravel())
            block.send_at(path, [row for row, _ in known], scalars.partition(np.full(len(known), N_JOINTS)))


def send_torques(block: Block) -> None:
    """Send the torques of all joints now and then, where they are known: at every tick they fill the file."""
    torques_nm, rows = block.column("joint_torques_nm"), block.sparse()
    rows = rows[np.isfinite(torques_nm[rows]).all(axis=-1)]
    if rows.size:
        scalars = load_rerun().Scalars.columns(scalars=rounded(torques_nm[rows], TORQUE_BITS).ravel())
        block.send(paths.TORQUES, rows, scalars.partition(np.full(rows.size, N_JOINTS)))
