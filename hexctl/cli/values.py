"""From the texts of options to values."""

import math

from hexctl.errors import InputError
from hexctl.robot.failure import Failure, parse_failure

MAX_TURN_DEG_S = 360.0


def finite(option: str, value: float | None) -> float:
    """Return the value of an option, 0 where it was not given.

    Raises InputError for nan and infinity.
    """
    if value is None:
        return 0.0
    if not math.isfinite(value):
        raise InputError(f"{option}: got {value}; allowed: a finite number")
    return value


def turn_rate_deg_s(value: float | None) -> float:
    """Return the value of --turn, 0 where it was not given.

    Raises InputError beyond a full turn per second.
    """
    rate = finite("--turn", value)
    if abs(rate) > MAX_TURN_DEG_S:
        raise InputError(f"--turn: got {rate:g}; allowed: -{MAX_TURN_DEG_S:g} to {MAX_TURN_DEG_S:g} deg/s")
    return rate


def make_failure(failed_leg: int | None, failure: str | None) -> Failure | None:
    """Return the failure of the options, or None when no leg failed.

    Raises InputError for a failure without a leg.
    """
    if failed_leg is None:
        if failure is not None:
            raise InputError(f"--failure: got {failure} without a leg; give --failed-leg 1..6 too")
        return None
    return parse_failure(failed_leg, failure or "locked")
