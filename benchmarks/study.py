"""The paper's whole study, from an empty cache to the report, over the bare physics of its landscapes.

The bare physics is that of one landscape (leg 5, with self-rotation, all of its gaits), stepped before and
after the study and counted once for each landscape: all have the same number of gaits and of walked seconds.
"""

from collections.abc import Iterator
from statistics import mean

from benchmarks.batch import THREADS, BatchWork
from benchmarks.plans import N_CODES, ant, recovery_plans
from benchmarks.process import timed_hexctl
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.control.batch import SimTrial
from hexctl.types import N_LEGS

LEG = 5

#: With and without self-rotation.
WAYS = 2


def study_rows(scale: Scale) -> Iterator[Row]:
    """Yield the wall time of `hexctl study` over its bare physics."""
    legs = N_LEGS if scale.codes == N_CODES else 1
    plans = recovery_plans(LEG, N_CODES, scale.walk_s, "rear")
    work = BatchWork([SimTrial(robot=ant(), plan=plan, failures=plan.failures) for plan in plans])
    bare_s = [work.bare().whole_s]
    wall_s = _run_study(legs, scale)
    bare_s.append(work.bare().whole_s)
    landscapes = WAYS * legs
    ratio = wall_s / (landscapes * mean(bare_s))
    note = f"{wall_s:.0f} s for {landscapes} landscapes; bare {bare_s[0]:.1f} and {bare_s[1]:.1f} s each"
    yield Row("study.wall", ratio, "ratio", Bar(high=1.2), f"{note}, {THREADS} threads")


def _run_study(legs: int, scale: Scale) -> float:
    """Run the study in its own process, in an empty folder, and return its wall time in s."""
    arguments = ["study", "--duration", f"{scale.walk_s:g}"]
    if legs < N_LEGS:
        arguments += ["--legs", str(LEG), "--runs", "2", "--budget", "10", "--optimizers", "random"]
    wall_s, _ = timed_hexctl(*arguments)
    return wall_s
