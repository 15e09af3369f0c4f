"""What the paper observed of 120 gaits with a locked leg, on the flat world (paper, section 4).

Walking straight on, a failed leg on the left pulls the robot to one side with all gaits and one on the right
to the other, while the front and the rear leg pull either way. After the self-rotation every failed leg has
gaits that end near the line of travel.
"""

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from benchmarks.plans import ant, recovery_plans
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.trial_plan import SelfRotation
from hexctl.control.trial_result import TrialResult
from hexctl.types import N_LEGS

#: Percent of the gaits that end to the left of the line, by failed leg.
LEFT_BARS = {
    1: Bar(30, 70),
    2: Bar(low=95),
    3: Bar(low=95),
    4: Bar(30, 70),
    5: Bar(high=5),
    6: Bar(high=5),
}

NEAR_M, VERY_NEAR_M = 0.10, 0.025


def landscape_benchmarks() -> dict[str, Callable[[Scale], Iterator[Row]]]:
    """Return one benchmark for each way of walking and each failed leg, by name."""
    return {
        f"landscape.{name}.leg{leg}": partial(rows, f"landscape.{name}.leg{leg}", leg)
        for name, rows in (("straight", straight_rows), ("rotated", rotated_rows))
        for leg in range(1, N_LEGS + 1)
    }


def straight_rows(name: str, leg: int, scale: Scale) -> Iterator[Row]:
    """Yield the share of the gaits that end to the left, without self-rotation."""
    results = _results(leg, scale, "none")
    signed_m = [result.deviation.signed for result in results if result.deviation is not None]
    left = 100 * float(np.mean(np.array(signed_m) > 0))
    yield Row(f"{name}.left", left, "%", LEFT_BARS[leg], _counted(results, scale))
    yield from _near_rows(name, results, scale, None)


def rotated_rows(name: str, leg: int, scale: Scale) -> Iterator[Row]:
    """Yield how many gaits end near the line of travel after the self-rotation."""
    yield from _near_rows(name, _results(leg, scale, "rear"), scale, Bar(low=1))


def _near_rows(name: str, results: list[TrialResult], scale: Scale, bar: Bar | None) -> Iterator[Row]:
    """Yield how many valid gaits end within two distances of the line, and how near the best does."""
    final_m = np.array([result.deviation.final for result in results if result.valid and result.deviation])
    note = _counted(results, scale)
    yield Row(f"{name}.within_0.10_m", int((final_m < NEAR_M).sum()), "gaits", bar, note)
    yield Row(f"{name}.within_0.025_m", int((final_m < VERY_NEAR_M).sum()), "gaits", None, note)
    yield Row(f"{name}.best", float(final_m.min()) if final_m.size else None, "m", None, note)


def _results(leg: int, scale: Scale, self_rotation: SelfRotation) -> list[TrialResult]:
    plans = recovery_plans(leg, scale.codes, scale.walk_s, self_rotation)
    return run_sim_trials([SimTrial(robot=ant(), plan=plan, failure=plan.belief) for plan in plans])


def _counted(results: list[TrialResult], scale: Scale) -> str:
    valid = sum(result.valid for result in results)
    return f"{valid} of {len(results)} gaits valid after {scale.walk_s:g} s"
