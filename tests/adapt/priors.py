"""Made-up priors: worlds in which a few hidden numbers move the ends of all gaits, and walks in them."""

from dataclasses import replace
from typing import Any

import numpy as np

from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.prior.prior import CHECKPOINTS, SCORES, Prior, PriorKey, ScorePrior
from hexctl.adapt.prior.samples import DISTANCE, FINAL, N_FEATURES, YAW, Samples
from hexctl.adapt.runner import TrialRequest, WalkedTrial
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.control.trial import LOOK_TICKS
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure, each_failure
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, FloatArray
from tests.adapt.walking import result_of
from tests.robots import shipped

GAITS = 120

#: Numbers that a made-up world hides: as friction, payload, slope and bent joints would be.
HIDDEN = 4

DURATION_S = 30.0


class MadeUpModel:
    """One low-rank model of worlds: the same seed gives the same gaits, however many worlds are drawn."""

    def __init__(self, seed: int = 0, *, spread_m: float = 0.3) -> None:
        random = np.random.default_rng(seed)
        self._middle_m = random.uniform(-1.5, 1.5, GAITS)
        self._pull_m = random.normal(0, spread_m / np.sqrt(HIDDEN), (HIDDEN, GAITS))
        self._bow_m = random.normal(0, spread_m / 4, (HIDDEN, GAITS))
        self._haste_m = random.normal(0, 0.05, (HIDDEN, GAITS))
        self._bend = random.normal(0, 1 / np.sqrt(HIDDEN), (HIDDEN, N_JOINTS))

    def worlds(self, count: int, seed: int) -> FloatArray:
        """Features of every gait in some worlds, (count, gaits, N_FEATURES)."""
        random = np.random.default_rng([seed, 1])
        hidden = random.normal(size=(count, HIDDEN))
        final = self._middle_m + hidden @ self._pull_m
        bow, distance = hidden @ self._bow_m, 3.2 + hidden @ self._haste_m
        share = np.arange(1, CHECKPOINTS + 1) / CHECKPOINTS
        features = np.empty((count, GAITS, N_FEATURES))
        features[..., :CHECKPOINTS] = (
            final[..., np.newaxis] * share**1.5 + bow[..., np.newaxis] * share * (1 - share) * 4
        )
        features[..., DISTANCE - 1], features[..., DISTANCE] = 0.49 * distance, distance
        features[..., YAW] = 0.4 * final + 0.5 * bow
        return features

    def sags(self, count: int, seed: int) -> FloatArray:
        """Static deflections in the same worlds, (count, 18): what they hide, and noise."""
        hidden = np.random.default_rng([seed, 1]).normal(size=(count, HIDDEN))
        other = np.random.default_rng([seed, 2]).normal(size=(count, N_JOINTS))
        return np.asarray(0.02 + 0.01 * hidden @ self._bend + 0.003 * other)

    def samples(self, count: int = 32, seed: int = 0, leg: int = 5) -> Samples:
        """Worlds as a belief takes them; every gait walks to its end."""
        return Samples(leg=leg, features=self.worlds(count, seed), finished=np.ones(GAITS))


def standing_samples(model: MadeUpModel, count: int = 32, seed: int = 0) -> Samples:
    """Worlds of a model with known stances."""
    return replace(model.samples(count, seed), sag_rad=model.sags(count, seed))


def made_up_bayes(samples: Samples, seed: int = 0, **options: Any) -> Bayes:
    """A search that believes samples."""
    defaults = {"target_m": 0.025, "duration_s": DURATION_S, "floor_m": 1.0}
    return Bayes(GaitSpace((samples.leg,)), seed, samples=samples, **{**defaults, **options})


def path_of(features: FloatArray) -> FloatArray:
    """The path through a walk's features, one row for each checkpoint."""
    half = CHECKPOINTS // 2
    at = np.interp(np.arange(1, CHECKPOINTS + 1), [0, half, CHECKPOINTS], [0, *features[-3:-1]])
    return np.column_stack([at, features[: FINAL + 1]])


def whole_path_of(features: FloatArray) -> FloatArray:
    """The same path tick by tick."""
    ticks = round(DURATION_S / PERIOD_S)
    knots = np.linspace(0, ticks, CHECKPOINTS + 1)
    columns = path_of(features).T
    return np.column_stack([np.interp(np.arange(1, ticks + 1), knots, [0, *column]) for column in columns])


def shown_of(features: FloatArray, status: str = "ok", duration_s: float = DURATION_S) -> Observation:
    """A walk that shows just these features."""
    return Observation(
        path_m=path_of(features), duration_s=duration_s, yaw_change_rad=float(features[YAW]), status=status
    )


def tell(search: Bayes, code: int, features: FloatArray, status: str = "ok") -> None:
    """Tell a search the trial that it has just asked for."""
    score = abs(float(features[FINAL])) if status == "ok" else 1e6
    search.tell([code], [score], [shown_of(features, status)])


class MadeUpWorld:
    """Walks the gaits of one made-up world as the loop wants it, and keeps their codes."""

    def __init__(self, features: FloatArray) -> None:
        self.walked: list[int] = []
        self._features = features

    def __call__(self, request: TrialRequest) -> WalkedTrial:
        code, should_stop = request.code, request.should_stop
        self.walked.append(code)
        whole = whole_path_of(self._features[code - 1])
        status, walked = "ok", len(whole)
        for tick in range(LOOK_TICKS, walked, LOOK_TICKS):
            if should_stop is not None and should_stop(whole[:tick]):
                status, walked = "cut_short", tick
                break
        distance_m, signed_m = whole[walked - 1].tolist()
        result = replace(
            result_of(signed_m, status),
            duration_s=walked * PERIOD_S,
            distance_m=distance_m,
            yaw_change_rad=float(self._features[code - 1, YAW]),
            path_m=whole[:walked],
        )
        return WalkedTrial(result=result)


def plan_of(robot: Robot, **options: Any) -> TrialPlan:
    """The plan of a session's trials."""
    failure = options.pop("failure", Failure(leg=5))
    return TrialPlan(gait=make_gait(robot, "demo"), failures=each_failure(failure), **options)


def key_of(robot: Robot | None = None, **options: Any) -> PriorKey:
    """The question of a session's trials."""
    robot = robot or shipped()
    return PriorKey.of(robot, plan_of(robot, **options))


def made_up_prior(
    question: PriorKey | None = None,
    legs: tuple[int, ...] = (5,),
    worlds: int = 3,
    seed: int = 0,
    model: MadeUpModel | None = None,
) -> Prior:
    """A prior whose legs all walk in the worlds of one model."""
    model = model or MadeUpModel()
    features = np.stack([model.worlds(worlds, seed + leg) for leg in legs])
    paths = np.array([path_of(row) for row in features.reshape(-1, N_FEATURES)])
    paths = paths.reshape(*features.shape[:-1], CHECKPOINTS, 2)
    return Prior(
        key=question or key_of(),
        legs=legs,
        origin={"family": {"seed": 20}, "worlds": worlds, "code": {"hexctl": "made up"}},
        signed_m=paths[..., 1],
        progress_m=paths[..., 0],
        yaw_rad=features[..., YAW],
    )


def made_up_score_prior(
    question: PriorKey | None = None, legs: tuple[int, ...] = (5,), worlds: int = 3, seed: int = 0
) -> ScorePrior:
    """A prior of steered walks in which a world slows all gaits, and each gait its own way."""
    random = np.random.default_rng([seed, 3])
    gait = np.random.default_rng(9).normal(0, 0.2, (GAITS, len(SCORES)))
    world = random.normal(0, 0.1, (len(legs), worlds, 1, 1))
    own = random.normal(0, 0.03, (len(legs), worlds, GAITS, len(SCORES)))
    return ScorePrior(
        key=question or replace(key_of(hold="line", self_rotation="none"), posture="auto"),
        legs=legs,
        origin={"family": {"seed": 20}, "worlds": worlds, "code": {"hexctl": "made up"}},
        log_scores=2.0 + gait + world + own,
        valid=np.ones((len(legs), worlds, GAITS), dtype=bool),
    )


def optimizer_of(spec: SessionSpec) -> Optimizer:
    """The optimizer that `hexctl adapt` makes for a spec; `bayes` with a made-up prior."""
    if spec.optimizer == "trim":
        return TrimSearch(GaitSpace((spec.broken.leg,)), spec.seed)
    if spec.optimizer == "bayes":
        samples = standing_samples(MadeUpModel(), 12)
        return made_up_bayes(samples, target_m=1e-6, sag_rad=np.array(spec.sag_rad))
    inner = make_optimizer(spec.optimizer, GaitSpace((spec.broken.leg,)), spec.seed)
    return Deduplication(inner, spec.seed, paper_count=spec.count_repeats)
