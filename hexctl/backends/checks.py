"""Checks that every LegServos makes of its targets and of its own state."""

import math

import numpy as np

from hexctl.errors import CommandRefusedError, RobotFaultError
from hexctl.types import N_JOINTS, JointTargets


def check_targets(targets: JointTargets) -> None:
    """Raise CommandRefusedError unless the targets are 18 finite angles."""
    positions = targets.positions_rad
    if positions.shape != (N_JOINTS,):
        raise CommandRefusedError(f"targets: got shape {positions.shape}; allowed: ({N_JOINTS},)")
    # A sum is finite only if every term is, and is cheaper than asking each one.
    if not math.isfinite(np.add.reduce(positions)):
        raise CommandRefusedError(f"targets: got {positions.tolist()}; allowed: finite angles in rad")


def check_connected(connected: bool, who: str) -> None:
    """Raise RobotFaultError unless connected."""
    if not connected:
        raise RobotFaultError(f"{who} is not connected; call connect() first, or use it in a with statement")
