"""Adaptation: how long bayes takes to choose a trial, and how long a whole session takes."""

import time
from collections.abc import Iterator

import numpy as np

from benchmarks.plans import N_CODES, ant
from benchmarks.process import timed_hexctl
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.adapt.optimizer import Observation
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.prior.prior import CHECKPOINTS, Prior, load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import samples_of
from hexctl.adapt.space import GaitSpace

LEG = 5
TRIALS = 20

#: Below what the shipped prior's trials cover: nothing here is without progress.
FLOOR_M = 0.5


def adapt_rows(scale: Scale) -> Iterator[Row]:
    """Time of one choice over a session of 20 trials, and of `hexctl adapt` with its defaults."""
    prior = load_prior(next(shipped_priors().glob("ant-locked-rear-30s.npz")))
    times_ms = np.concatenate([_choices_ms(prior, world) for world in range(min(scale.rounds, prior.worlds))])
    note = f"{times_ms.size} choices in sessions of {TRIALS} trials, their learning included"
    yield Row("adapt.choose.median", float(np.median(times_ms)), "ms", Bar(high=20), note)
    yield Row("adapt.choose.p90", float(np.percentile(times_ms, 90)), "ms", Bar(high=20), note)
    wall_s, trials = _session_s(scale)
    yield Row("adapt.session", wall_s, "s", Bar(high=90), f"{trials} trials recorded, all included")


def _choices_ms(prior: Prior, world: int) -> "np.ndarray[tuple[int], np.dtype[np.float64]]":
    """Return how long each choice took, tell and ask, in a world of the prior; repeats cost the same."""
    search = Bayes(
        GaitSpace((LEG,)),
        0,
        samples=samples_of(prior, ant(), LEG),
        target_m=1e-6,  # never reached, so that the session goes on
        duration_s=prior.key.duration_s,
        floor_m=FLOOR_M,
    )
    row = prior.legs.index(LEG)
    path = np.stack([prior.progress_m[row, world], prior.signed_m[row, world]], axis=-1)
    times_s = []
    (code,) = search.ask(1)
    for _ in range(TRIALS - 1):
        shown = Observation(
            path_m=path[code - 1],
            duration_s=prior.key.duration_s,
            yaw_change_rad=float(prior.yaw_rad[row, world, code - 1]),
            status="ok" if np.isfinite(path[code - 1]).all() else "fell",
        )
        began_s = time.perf_counter()
        search.tell([code], [abs(float(np.nan_to_num(path[code - 1, CHECKPOINTS - 1, 1])))], [shown])
        (code,) = search.ask(1)
        times_s.append(time.perf_counter() - began_s)
    return 1e3 * np.array(times_s)


def _session_s(scale: Scale) -> tuple[float, int]:
    """Run `hexctl adapt` in its own process, in an empty folder; return its wall time and its trials.

    The target is one that is never reached, so that it walks its whole budget.
    """
    size = ["--duration", f"{scale.walk_s:g}", "--budget", "2"] if scale.codes < N_CODES else []
    arguments = ["adapt", "--failed-leg", str(LEG), "--target", "1e-6"]
    wall_s, outcome = timed_hexctl(*arguments, *(size or ["--budget", str(TRIALS)]))
    return wall_s, len(outcome["trials"])
