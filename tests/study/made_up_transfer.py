"""A small benchmark in worlds of a made-up model; some gaits fall on their way."""

from typing import TYPE_CHECKING, Any

import numpy as np

from hexctl.adapt.prior.prior import PriorKey
from hexctl.adapt.prior.samples import FINAL
from hexctl.backends.sim.world import load_randomization
from hexctl.study.experiment import where
from hexctl.study.landscape import NUMBERS, Landscape, LandscapeSpec
from hexctl.study.transfer.transfer_plan import EARLY, TransferPlan
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, key_of, made_up_prior, path_of
from tests.robots import shipped

if TYPE_CHECKING:
    from pandas import DataFrame

DURATION_S = 6.0
LEGS, WORLDS, BUDGET, RUNS = (2, 5), 3, 20, 2
OPTIMIZERS = ("bayes", EARLY, "pso", "random")
MODEL = MadeUpModel(seed=4)

#: Codes of gaits that fall after half of their time.
FALLING = (12, 51, 94)


def question(name: str = "ant", **options: Any) -> PriorKey:
    return key_of(shipped(name), **{"duration_s": DURATION_S, **options})


def plan(**options: Any) -> TransferPlan:
    given: dict[str, Any] = {
        "robot": shipped(),
        "family": load_randomization("transfer"),
        "prior": made_up_prior(question(), legs=LEGS, worlds=16, model=MODEL),
        "worlds": WORLDS,
        "legs": LEGS,
        "optimizers": OPTIMIZERS,
        "runs": RUNS,
        "budget": BUDGET,
        "duration_s": DURATION_S,
    }
    return TransferPlan(**given | options)


def in_the_model(spec: LandscapeSpec, features: FloatArray) -> Landscape:
    """A landscape whose gaits walk as in a world of the made-up model."""
    points = spec.n_points
    at = np.arange(1, points + 1) / points * 10
    paths = np.empty((120, points, 2), dtype=np.float32)
    for row, path in enumerate(path_of(one) for one in features):
        for column in (0, 1):
            paths[row, :, column] = np.interp(at, np.arange(11), [0, *path[:, column]])
    numbers = np.zeros((120, len(NUMBERS)))
    numbers[:, NUMBERS.index("signed_m")] = features[:, FINAL]
    numbers[:, NUMBERS.index("distance_m")] = features[:, -2]
    numbers[:, NUMBERS.index("yaw_change_rad")] = features[:, -1]
    status = np.full(120, "ok", dtype="<U16")
    for code in FALLING:
        status[code - 1] = "fell"
        paths[code - 1, points // 2 :] = np.nan
    return Landscape(spec=spec, status=status, numbers=numbers, paths_m=paths)


def courses_of(found: "DataFrame", optimizer: str, place: int | None = None) -> list[Any]:
    """Runs of an optimizer, in all landscapes or in one."""
    runs = where(found, optimizer=optimizer)
    return list((runs if place is None else runs[runs["place"] == place]).itertuples())
