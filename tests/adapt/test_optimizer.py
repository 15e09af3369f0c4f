"""All optimizers keep to the interface; deduplication, the populations by their papers, and the registry."""

import json
import re
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any, ClassVar
from unittest import mock

import numpy as np
import pytest

from hexctl.adapt.optimizer import Observation, Optimizer
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.deduplication import Deduplication, SpaceExhaustedError
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.population import (
    BestEvolution,
    DifferentialEvolution,
    ParticleSwarm,
    Population,
    RandomEvolution,
)
from hexctl.adapt.optimizers.score_bayes import ScoreBayes
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.adapt.optimizers.strides import SLOWER, StrideSearch
from hexctl.adapt.optimizers.trim import TrimSearch
from hexctl.adapt.prior.samples import score_samples_of
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.session_optimizer import make_search
from hexctl.adapt.setting import load_setting
from hexctl.adapt.space import GaitSpace
from hexctl.control.planning.top_speed import Stride
from hexctl.errors import InputError
from hexctl.testing.optimizer_conformance import (
    BATCHES,
    ONE_FAILED,
    Make,
    OptimizerConformance,
    search,
    slope,
)
from hexctl.types import FloatArray
from tests.adapt.priors import MadeUpModel, made_up_bayes, made_up_score_prior
from tests.robots import shipped


def bare(name: str) -> Make:
    return lambda space, seed: make_optimizer(name, space, seed)


def fresh(name: str, **options: Any) -> Callable[[GaitSpace, int], Deduplication]:
    return lambda space, seed: Deduplication(make_optimizer(name, space, seed), seed, **options)


def paper(name: str) -> Make:
    return fresh(name, paper_count=True)


#: Every optimizer bare, two as a session asks them, one with the paper's count.
SEARCHES = {
    **{name: bare(name) for name in OPTIMIZERS},
    "fresh exhaustive": fresh("exhaustive"),
    "fresh pso": fresh("pso"),
    "paper dps": paper("dps"),
}


@pytest.mark.parametrize("name", SEARCHES)
class TestOptimizers(OptimizerConformance):
    @pytest.fixture
    def make(self, name: str) -> Make:
        return SEARCHES[name]

    @pytest.fixture(autouse=True)
    def _without_random_numbers(self, name: str) -> None:
        self.seeded = "exhaustive" not in name


def believing(space: GaitSpace, seed: int) -> Optimizer:
    return made_up_bayes(MadeUpModel().samples(8, leg=space.failed_legs[0]), seed=seed)


def scoring(space: GaitSpace, seed: int) -> Optimizer:
    samples = score_samples_of(made_up_score_prior(worlds=6), shipped("pexod"), 5, "speed")
    return ScoreBayes(space, seed, samples=replace(samples, leg=space.failed_legs[0]))


@pytest.mark.parametrize("make", [StrideSearch, TrimSearch, believing, scoring])
class TestSearchesOfSessions(OptimizerConformance):
    """For one failed leg: they know no gaits of a robot that has lost two, and leave nothing to chance."""

    spaces = (ONE_FAILED,)
    seeded = False


@pytest.mark.parametrize("name", ["pso", "psosp", "dps", "debest", "derand", "random", "exhaustive"])
@pytest.mark.parametrize("counting", [bare, paper], ids=lambda counting: counting.__name__)
def test_the_size_of_the_pieces_does_not_change_the_search(
    name: str, counting: Callable[[str], Make]
) -> None:
    first, *others = [search(counting(name)(ONE_FAILED, 3), 150, batch=batch) for batch in BATCHES]
    assert all(codes == first for codes in others)


@pytest.mark.parametrize("suggested", [[], [0], [121], [1, 2], ["1"]])
def test_suggestions_that_are_no_codes_are_refused_with_the_optimizers_name(suggested: list[Any]) -> None:
    class Odd(RandomSearch):
        name = "odd"

        def _suggest(self, count: int) -> list[int]:
            return suggested

    for optimizer in (Odd(ONE_FAILED, 1), Deduplication(Odd(ONE_FAILED, 1), 1)):
        with pytest.raises(InputError, match="optimizer: odd"):
            optimizer.ask(1)


def test_codes_of_numpy_are_stored_as_numbers() -> None:
    class Drawn(RandomSearch):
        def _suggest(self, count: int) -> list[int]:
            return list(self._random.integers(1, 121, count))

    optimizer = Drawn(ONE_FAILED, 1)
    assert optimizer.ask(3) == json.loads(json.dumps(optimizer.state()))["asked"]


@pytest.mark.parametrize("name", ["pso", "psosp", "dps", "debest", "derand"])
@pytest.mark.parametrize("best", [12, 77])
def test_searches_find_the_best_of_a_smooth_landscape_far_sooner_than_chance(name: str, best: int) -> None:
    # 60 of 120 codes contain the best one with probability 1/2: 27 or more of 30 have probability 4e-6.
    searches = [
        search(fresh(name)(ONE_FAILED, seed), 60, landscape=lambda code: float(abs(code - best)))
        for seed in range(30)
    ]
    assert sum(best in codes for codes in searches) >= 27


PAGE = Path(__file__).resolve().parents[2] / "docs" / "how-to" / "extend.md"


@pytest.fixture
def nearby(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Make:
    blocks = re.findall(r"```python\n(.*?)```", PAGE.read_text(encoding="utf-8"), flags=re.DOTALL)
    (program,) = [block for block in blocks if "class Nearby" in block]
    (tmp_path / "nearby.py").write_text(program, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.delitem(sys.modules, "nearby", raising=False)
    return lambda space, seed: make_optimizer("nearby:Nearby", space, seed)


class TestNearby(OptimizerConformance):
    @pytest.fixture
    def make(self, nearby: Make) -> Make:
        return nearby


@pytest.mark.parametrize("name", ["genetic", "bayes", "nowhere:Thing", "math:nothing", ":", "pathlib:Path"])
def test_unknown_optimizers_are_refused(name: str) -> None:
    with pytest.raises(InputError, match="optimizer"):
        make_optimizer(name, ONE_FAILED, 0)


class Scripted(Optimizer):
    """Asks for one code and writes down what it is told."""

    name = "scripted"

    def __init__(self, space: GaitSpace, seed: int) -> None:
        super().__init__(space, seed)
        self.told: list[tuple[int, float]] = []

    def _suggest(self, count: int) -> list[int]:
        return [5] * count

    def _learn(self, codes: list[int], scores: list[float]) -> None:
        self.told += zip(codes, scores, strict=True)

    def _search_state(self) -> dict[str, Any]:
        return {}

    def _restore_search(self, state: dict[str, Any]) -> None:
        pass


class Forgetful(Scripted):
    """Learns nothing."""

    _learn = Optimizer._learn


def test_an_optimizer_that_does_not_learn_is_refused_before_it_is_asked() -> None:
    with pytest.raises(InputError, match="_learn"):
        make_optimizer(Forgetful, ONE_FAILED, 0)


@pytest.mark.parametrize("name", OPTIMIZERS)
@pytest.mark.parametrize(("batch", "landscape"), [(1, slope), (64, lambda _: 1e9)], ids=["slope", "flat"])
def test_every_code_is_handed_out_once_and_then_it_is_exhausted(
    name: str, batch: int, landscape: Callable[[int], float]
) -> None:
    optimizer = fresh(name)(ONE_FAILED, 1)
    codes = search(optimizer, 1000, batch=batch, landscape=landscape)
    assert sorted(codes) == list(range(1, 121))
    assert optimizer.exhausted
    with pytest.raises(SpaceExhaustedError, match=name):
        optimizer.ask()


def test_a_search_that_is_stuck_gets_help_after_the_patience_and_asks_on() -> None:
    inner = Scripted(ONE_FAILED, 0)
    optimizer = Deduplication(inner, 0, patience=20)
    assert search(optimizer, 1) == [5]
    for extra in range(30):
        search(optimizer, 1)
        assert len(inner.told) == 1 + 20 + extra
    assert set(inner.told) == {(5, slope(5))}, "a code that it did not ask for"


@pytest.mark.parametrize("stop", [0, 3])
def test_help_goes_on_after_a_restore(stop: int) -> None:
    # By then the swarm has collapsed.
    original, restored = (fresh("pso", patience=5)(ONE_FAILED, seed) for seed in (5, 6))
    search(original, 60 + stop)
    restored.restore(original.state())
    assert search(restored, 20) == search(original, 20)


SEEN = Observation(path_m=np.zeros((3, 2)), duration_s=1.0, yaw_change_rad=0.0, status="ok")

#: Calls that are passed to the search, with arguments.
CALLS: dict[str, tuple[Any, ...]] = {
    "recommended": (),
    "predict": (3,),
    "trim": (3,),
    "stride": (3,),
    "early_stopping": (3,),
    "repeat": (5, 0.5, SEEN),
}


@pytest.mark.parametrize("paper_count", [False, True])
def test_everything_that_the_search_says_passes_through(paper_count: bool) -> None:
    told = {"judges_target": True, "trims": True, "exhausted": True, "finished": True, "worthwhile": False}
    inner = mock.create_autospec(Scripted(ONE_FAILED, 0), space=ONE_FAILED, **told)
    inner.name = "outspoken"
    optimizer = Deduplication(inner, 0, paper_count=paper_count)
    for name, arguments in CALLS.items():
        given = getattr(optimizer, name)(*arguments)
        getattr(inner, name).assert_called_once_with(*arguments)
        assert name == "repeat" or given is getattr(inner, name).return_value
    inner.ask.return_value = [1, 2]
    optimizer.tell(optimizer.ask(2), [0.1, 0.2], [SEEN, None])
    inner.tell.assert_called_once_with([1, 2], [0.1, 0.2], [SEEN, None])
    fields = ("space", "name", *told)
    assert [getattr(optimizer, name) for name in fields] == [getattr(inner, name) for name in fields]
    public = {name for name in {*vars(Optimizer), *Optimizer.__annotations__} if not name.startswith("_")}
    assert public | {"space"} == {*fields, *CALLS, "ask", "tell", "state", "restore"}, "is it passed through?"


@pytest.mark.parametrize("options", [{"paper_count": True}, {"patience": 7}, None], ids=str)
def test_states_of_other_rules_and_of_bare_searches_are_refused(options: dict[str, Any] | None) -> None:
    optimizer, bare = fresh("pso")(ONE_FAILED, 1), make_optimizer("pso", ONE_FAILED, 0)
    other = bare if options is None else fresh("pso", **options)(ONE_FAILED, 1)
    before = optimizer.state()
    with pytest.raises(InputError):
        optimizer.restore(other.state())
    assert optimizer.state() == before
    with pytest.raises(InputError):
        bare.restore(before)


Function = Callable[[FloatArray], FloatArray]

LOW, HIGH = -5.0, 5.0


def sphere(points: FloatArray) -> FloatArray:
    """Σ x², minimum 0 at 0; points (..., dimension)."""
    return np.asarray((points**2).sum(axis=-1))


def rosenbrock(points: FloatArray) -> FloatArray:
    """(1 - x)² + 100 (y - x²)², minimum 0 at (1, 1); points (..., 2)."""
    x, y = points[..., 0], points[..., 1]
    return np.asarray((1 - x) ** 2 + 100 * (y - x**2) ** 2)


def population_of(core: type[Population], seed: int, dimension: int = 2) -> Population:
    """A population of ten in the box."""
    return core([LOW] * dimension, [HIGH] * dimension, np.random.default_rng(seed))


def minimum(core: type[Population], function: Function, generations: int, seed: int) -> float:
    """The lowest value found in a number of generations."""
    population = population_of(core, seed)
    for _ in range(generations):
        population.advance(function(population.positions))
    return float(population.kept_scores.min())


FAR = 1e9  # walls that are never met


class Certain(np.random.Generator):
    """A generator whose uniform numbers in [0, 1] are all 1: the deterministic swarm."""

    def random(self, size: object = None, *_: object, **__: object) -> FloatArray:  # type: ignore[override]
        return np.ones(size)  # type: ignore[call-overload, no-any-return]


class Tuned(ParticleSwarm):
    """A swarm in one dimension far from all walls, with other weights."""

    def __init__(
        self, inertia: float, cognitive: float, social: float, random: np.random.Generator, size: int
    ):
        super().__init__([-FAR], [FAR], random, size)
        self.weights = inertia, cognitive, social

    inertia: ClassVar[float] = property(lambda self: self.weights[0])  # type: ignore[assignment]
    cognitive: ClassVar[float] = property(lambda self: self.weights[1])  # type: ignore[assignment]
    social: ClassVar[float] = property(lambda self: self.weights[2])  # type: ignore[assignment]


def stagnating(swarm: ParticleSwarm, own: float, best: float, start: float, steps: int) -> FloatArray:
    """The positions of a swarm whose particles all remember `own` and follow `best`, (steps, size).

    Particle 0 is the one that holds the best.
    """
    swarm.positions = np.full((swarm.size, 1), start)
    swarm.velocities = np.zeros((swarm.size, 1))
    swarm.kept = np.full((swarm.size, 1), own)
    swarm.kept[0] = best
    swarm.kept_scores = np.ones(swarm.size)
    swarm.kept_scores[0] = 0.0
    swarm.known[:] = True
    path = []
    for _ in range(steps):
        swarm.advance(np.full(swarm.size, 2.0))  # never better
        path.append(swarm.positions[:, 0])
    return np.array(path)


@pytest.mark.parametrize(
    ("inertia", "cognitive", "social"), [(0.5, 0.5, 2.0), (0.7, 0.3, 0.3), (0.9, 1.0, 1.5)]
)
def test_without_chance_a_particle_moves_as_trelea_has_it(
    inertia: float, cognitive: float, social: float
) -> None:
    # Trelea 2003: x(t+1) = (1 + ω - φ) x(t) - ω x(t-1) + φ p, in closed form by the roots of λ² - ... = 0.
    swarm = Tuned(inertia, cognitive, social, Certain(np.random.PCG64(0)), 10)
    path = stagnating(swarm, own=3.0, best=8.0, start=-40.0, steps=30)[:, 1]
    weight = cognitive + social
    point = (cognitive * 3.0 + social * 8.0) / weight
    roots = np.roots([1, -(1 + inertia - weight), inertia])
    # x(0) = x(-1) = start, since the first velocity is 0.
    shares = np.linalg.solve(np.array([[1, 1], 1 / roots]), np.full(2, -40.0 - point))
    expected = [point + (shares * roots**step).sum().real for step in range(1, 31)]
    np.testing.assert_allclose(path, expected, rtol=1e-9, atol=1e-9)


SEEDS = 150

GENERATIONS = 25


def ours(core: type[DifferentialEvolution], function: Function) -> FloatArray:
    """Logarithms of the minima found with many seeds, (SEEDS,)."""
    return np.log10([minimum(core, function, GENERATIONS, seed) for seed in range(SEEDS)])


def scipys(strategy: str, function: Function) -> FloatArray:
    """The same found by SciPy: 10 individuals, uniform start, whole generations, CR = 0.5."""
    from scipy.optimize import differential_evolution

    runs = [
        differential_evolution(
            lambda points: function(points.T),
            [(LOW, HIGH)] * 2,
            strategy=strategy,
            popsize=5,  # times two dimensions
            init="random",
            maxiter=GENERATIONS - 1,  # besides the first generation
            mutation=0.7,
            recombination=0.5,
            updating="deferred",
            vectorized=True,
            polish=False,
            tol=0,
            atol=0,
            rng=1000 + seed,
        )
        for seed in range(SEEDS)
    ]
    assert {run.nit for run in runs} == {GENERATIONS - 1}
    return np.log10([run.fun for run in runs])


@pytest.mark.long
@pytest.mark.parametrize(
    ("core", "strategy", "function"),
    [(BestEvolution, "best1bin", rosenbrock), (RandomEvolution, "rand1bin", sphere)],
)
def test_it_converges_as_scipys_does(
    core: type[DifferentialEvolution], strategy: str, function: Function
) -> None:
    from scipy.stats import mannwhitneyu

    # 150 minima each: one from the other is told by rank (Mann-Whitney), and by their medians in decades.
    found, reference = ours(core, function), scipys(strategy, function)
    assert mannwhitneyu(found, reference).pvalue > 0.01
    assert np.median(found) == pytest.approx(np.median(reference), abs=0.5)


@pytest.mark.parametrize("core", [BestEvolution, RandomEvolution])
def test_challengers_are_made_of_the_parents_by_the_equation(core: type[DifferentialEvolution]) -> None:
    population = population_of(core, 4, 1)
    population.advance(sphere(population.positions))
    parents, best = population.kept[:, 0], population.kept_scores.argmin()
    for i, challenger in enumerate(population.positions[:, 0]):
        others = [j for j in range(10) if j != i]
        made = [
            parents[base] + 0.7 * (parents[r] - parents[s])
            for base in (others if core is RandomEvolution else [best])
            for r in others
            for s in others
            if r != s and (core is BestEvolution or base not in (r, s))
        ]
        outside = any(not LOW <= point <= HIGH for point in made)
        assert outside or min(abs(challenger - point) for point in made) < 1e-12


def test_the_best_of_the_table_walks_more_slowly_and_then_with_other_orders_of_the_legs() -> None:
    spec = new_spec(failed_leg=5, objective="speed")
    setting = load_setting(spec)
    search = make_search(spec, setting.robot, setting.plan, None)
    strides: list[Stride] = []
    while not search.exhausted:
        if len(strides) == 9:  # a search that goes on from its state
            state, search = search.state(), make_search(spec, setting.robot, setting.plan, None)
            search.restore(state)
        (code,) = search.ask()
        stride = search.stride(code)
        assert stride is not None
        strides.append(stride)
        search.tell([code], [1 / (stride.pace_hz * stride.amplitude)])
    best = strides[0]
    assert strides[6].pace_hz == pytest.approx(SLOWER * best.pace_hz, abs=1e-3)
    assert strides[7:] == [best] * 23  # of the 24 orders of five legs on a circle one walked before
