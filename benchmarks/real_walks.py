"""Failures of `ant` in held-out worlds of `real`: the line held, recovery in mid-walk, and false alarms.

`python -m benchmarks.real_walks [line] [recovery] [healthy]` prints the rows; without a name all of them.
"""

import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.healthy_walks import KINDS, healthy_walks
from benchmarks.rows import Bar, Count, Row
from hexctl.backends.sim.world import load_randomization
from hexctl.robot.loader import load_robot
from hexctl.study.held_out import FAILURES, INTACT
from hexctl.study.held_out_experiment import HeldOutExperiment, frame_of, mean_with_error
from hexctl.study.hold_plan import HoldPlan
from hexctl.study.recovery.episodes import RecoveryCase, RecoveryPlace
from hexctl.study.recovery.methods import NOTHING
from hexctl.study.recovery.recovery_plan import LINE, RecoveryPlan
from hexctl.study.walk_cache import FOLDER, WalkCache, Walked
from hexctl.study.walking import Work
from hexctl.types import N_LEGS

if TYPE_CHECKING:
    from pandas import DataFrame

#: The method that robots recover by.
JUDGED = "recover"

#: First world and number of worlds of each figure. Nothing was tuned with them.
LINE_WORLDS, RECOVERY_WORLDS = (9300, 30), (9412, 6)
HEALTHY_WORLDS = {"real": (9500, 60), "transfer": (9600, 60)}


def line_rows(cache: WalkCache) -> Iterator[Row]:
    """Yield how far from its line a robot ends that knows its failure and its pose, the leg by turns."""
    plan = _plan(HoldPlan, LINE_WORLDS, holds=("line",))
    rows = _rows(plan, cache, lambda place, case: case.leg == 1 + place.number % N_LEGS)
    final_cm = 100 * rows["final_m"].to_numpy(float)
    each = ", ".join(f"{count} {status}" for status, count in rows["status"].value_counts().items())
    mean_m, error_m = mean_with_error(rows, "final_m")
    note = f"{len(rows)} walks: {each}"
    yield Row("line.mean", 100 * mean_m, "cm", Bar(high=0.5), f"± {100 * error_m:.2f} over worlds, {note}")
    yield Row("line.p90", float(np.nanpercentile(final_cm, 90)), "cm", Bar(high=1.0), note)
    yield Row("line.max", float(np.nanmax(final_cm)), "cm", Bar(high=5.0), note)


def recovery_rows(cache: WalkCache) -> Iterator[Row]:
    """Yield how the walk reacts to a failure: of each leg in three ways, of each joint on one leg a world."""
    rows = _rows(
        _plan(RecoveryPlan, RECOVERY_WORLDS, protocols=(LINE,), methods=(NOTHING, JUDGED)), cache, _fails
    )
    judged = rows[rows["judged"] & (rows["method"] == JUDGED)]
    legs, joints = judged[judged["whole_leg"]], judged[~judged["whole_leg"] & judged["matters"].astype(bool)]
    for name, some in (("legs", legs), ("joints", joints)):
        count = Count(int(some["right_leg"].sum()), len(some))
        yield replace(count.row(f"recovery.right_leg.{name}", "right"), bar=Bar(low=0.98))
    fallen = ~judged["ended"].astype(bool)
    yield Row("recovery.falls", float(fallen.sum()), "walks", Bar(high=0), f"of {len(judged)}")
    mean, error = mean_with_error(legs, "speed_kept")
    note = f"± {error:.3f} over worlds, {len(legs)} walks of legs, least {legs['speed_kept'].min():.2f}"
    yield Row("recovery.speed_kept", mean, "share", Bar(low=0.95), note)


def healthy_rows(_cache: WalkCache) -> Iterator[Row]:
    """Yield how many walks of intact robots have an alarm, by family of worlds and kind of walk."""
    for family, (first, worlds) in HEALTHY_WORLDS.items():
        walks = healthy_walks(load_robot("ant"), family, first, worlds)
        for kind in KINDS:
            results = [result for one, result in walks if one == kind]
            alarms = sum(bool(result.noticed) for result in results)
            hours = sum(result.duration_s for result in results) / 3600
            note = f"of {len(results)} walks, {hours:.1f} h"
            yield Row(f"healthy.{family}.{kind}", float(alarms), "walks", Bar(high=0), note)


def _plan(
    kind: Callable[..., HeldOutExperiment], worlds: tuple[int, int], **more: object
) -> HeldOutExperiment:
    first, count = worlds
    families = {"real": load_randomization("real")}
    return kind(robots=(load_robot("ant"),), families=families, first_world=first, worlds=count, **more)


def _rows(plan: HeldOutExperiment, cache: WalkCache, wanted: Callable[[Any, Any], bool]) -> "DataFrame":
    """Rows of the wanted cases of a plan; those that the cache lacks are walked."""
    walked: Walked = [(place, [one for one in cases if wanted(place, one)]) for place, cases in plan.walked()]
    return plan.columns(frame_of(walked, Work(cache=cache).walk(walked)))


def _fails(place: RecoveryPlace, case: RecoveryCase) -> bool:
    """Whether a case is walked: joints fail on one leg of each world, by turns."""
    if case.failure == INTACT:
        return True
    if ":" not in case.failure:
        return case.method == JUDGED
    return case.legs == (1 + (place.number + FAILURES.index(case.failure)) % N_LEGS,)


#: Figures by name.
FIGURES = {"line": line_rows, "recovery": recovery_rows, "healthy": healthy_rows}


def main(names: list[str], folder: Path = FOLDER) -> None:
    """Print the rows of some figures, or of all."""
    for name in names or FIGURES:
        for row in FIGURES[name](WalkCache(folder)):
            print(row, flush=True)


if __name__ == "__main__":
    main(sys.argv[1:])
