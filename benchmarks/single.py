"""One simulated trial, not recorded, over bare stepping of the same physics."""

import time
from collections.abc import Iterator
from statistics import median

from benchmarks.physics import Start, bare_steps, controls_of, require_same_end
from benchmarks.plans import ant, default_gait
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from benchmarks.timing import alternate, median_ratio, spread
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.types import FloatArray


def single_rows(scale: Scale) -> Iterator[Row]:
    """Wall time of one trial, from the settled connection to its result, over bare mj_step."""
    run = _SingleRun(TrialPlan(gait=default_gait(), duration_s=scale.walk_s))
    pairs = alternate(run.ours, run.bare, scale.trial_rounds)
    times = (
        f"{1e3 * median(ours for ours, _ in pairs):.0f} ms over {1e3 * median(b for _, b in pairs):.0f} ms"
    )
    note = f"settle, walk {scale.walk_s:g} s, stop; {times}; {spread(pairs)}"
    yield Row("single.wall", median_ratio(pairs), "ratio", Bar(high=1.25), note)
    held = _SingleRun(TrialPlan(gait=default_gait(), duration_s=scale.walk_s, hold="line"))
    pairs = alternate(held.ours, held.bare, scale.trial_rounds)
    note = f"the same with the line held; {spread(pairs)}"
    yield Row("single.held", median_ratio(pairs), "ratio", Bar(high=1.35), note)


class _SingleRun:
    """The trial and its controls, recorded once and checked against the reference."""

    def __init__(self, plan: TrialPlan) -> None:
        self._plan = plan
        with SimServos(ant()) as servos:
            self._start = Start.of(servos)
            log = TickLog()
            run_trial(Guard(servos), plan, recorders=(log,))
            self._controls = controls_of(log, servos)
            require_same_end(servos.compiled.physics.data.qpos.copy(), self._replay(), "single")

    def ours(self) -> float:
        """Return the wall time of the trial in s, the connection excluded."""
        with SimServos(ant()) as servos:
            began_s = time.perf_counter()
            run_trial(Guard(servos), self._plan)
            return time.perf_counter() - began_s

    def bare(self) -> float:
        """Return the wall time of the same physics steps with the same controls in s."""
        data = self._start.data()
        began_s = time.perf_counter()
        bare_steps(self._start.model, data, self._controls)
        return time.perf_counter() - began_s

    def _replay(self) -> FloatArray:
        data = self._start.data()
        bare_steps(self._start.model, data, self._controls)
        positions: FloatArray = data.qpos.copy()
        return positions
