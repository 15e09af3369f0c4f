"""The transfer benchmark: its worlds, its courses, its figures, on made-up landscapes."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import CHECKPOINTS, Prior, PriorKey
from hexctl.backends.sim.world import load_randomization
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError, RobotFaultError
from hexctl.gait.gait import make_gait
from hexctl.robot.failure import Failure
from hexctl.study.landscape import NUMBERS, Landscape
from hexctl.study.paper.searches import curve_of
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.transfer.transfer_plan import TransferFound, TransferPlan
from hexctl.study.transfer.transfer_searches import by_seconds, floor_m, search_worlds, walk_of
from hexctl.types import FloatArray
from tests.robots import shipped
from tests.study.made_up_transfer import courses_of, found_in

GAITS, HIDDEN, DURATION_S = 120, 3, 10.0


def _finals(worlds: int, seed: int) -> FloatArray:
    """Ends of all gaits in some worlds, which a few hidden numbers move, (worlds, gaits)."""
    model, random = np.random.default_rng(0), np.random.default_rng([seed, 1])
    middle, pull = model.uniform(-1.5, 1.5, GAITS), model.normal(0, 0.2, (HIDDEN, GAITS))
    return np.asarray(middle + random.normal(size=(worlds, HIDDEN)) @ pull)


def _question() -> PriorKey:
    robot = shipped()
    plan = TrialPlan(gait=make_gait(robot, "demo"), duration_s=DURATION_S, belief=Failure(leg=5))
    return PriorKey.of(robot, plan)


def _prior() -> Prior:
    finals = _finals(24, seed=1)[np.newaxis]
    share = np.arange(1, CHECKPOINTS + 1) / CHECKPOINTS
    progress = np.broadcast_to(1.3 * share, (*finals.shape, CHECKPOINTS))
    return Prior(
        key=_question(),
        legs=(5,),
        origin={},
        signed_m=finals[..., np.newaxis] * share**1.5,
        progress_m=progress.copy(),
        yaw_rad=0.5 * finals,
    )


def _plan(**changes: Any) -> TransferPlan:
    values: dict[str, Any] = {
        "robot": shipped(),
        "family": load_randomization("transfer"),
        "prior": _prior(),
        "worlds": 4,
        "legs": (5,),
        "optimizers": ("bayes", "bayes-early", "pso", "random"),
        "runs": 3,
        "budget": 25,
        "duration_s": DURATION_S,
    }
    return TransferPlan(**{**values, **changes})


def _landscape(spec: Any, finals: FloatArray, invalid: int = 0) -> Landscape:
    """A landscape with these ends; the first gaits, by number, made no progress."""
    share = np.arange(1, spec.n_points + 1) / spec.n_points
    numbers = np.zeros((GAITS, len(NUMBERS)))
    numbers[:, NUMBERS.index("signed_m")] = finals
    numbers[:, NUMBERS.index("distance_m")] = 1.3
    numbers[:, NUMBERS.index("yaw_change_rad")] = 0.5 * finals
    paths = np.zeros((GAITS, spec.n_points, 2), dtype=np.float32)
    paths[..., 0], paths[..., 1] = 1.3 * share, finals[:, np.newaxis] * share**1.5
    status = np.where(np.arange(GAITS) < invalid, "no_progress", "ok").astype("<U16")
    codes = np.array(spec.codes)
    return Landscape(spec=spec, codes=codes, status=status, numbers=numbers, paths_m=paths)


@pytest.fixture(scope="module")
def landscapes() -> list[Landscape]:
    specs = _plan().specs()
    finals = _finals(len(specs), seed=2)
    return [_landscape(spec, row, invalid=7) for spec, row in zip(specs, finals, strict=True)]


@pytest.fixture(scope="module")
def findings(landscapes: list[Landscape]) -> TransferFound:
    return found_in(_plan(), landscapes)


def test_no_world_of_the_benchmark_is_one_of_a_prior() -> None:
    unseen = [spec.world for spec in _plan(worlds=60).specs()]
    known = [
        spec.world for spec in PriorPlan(robot=shipped(), family=load_randomization("randomised")).specs()
    ]
    assert not [world for world in unseen if world in known]
    assert len({world.model_dump_json() for world in unseen}) == len(unseen)


def test_half_of_the_worlds_are_of_a_kind_that_no_world_of_a_prior_is() -> None:
    plan = _plan(worlds=30)
    plain = [spec for spec in plan.specs() if plan.kind_of(spec) == "plain"]
    assert len(plain) == 15
    for spec in plan.specs():
        world = spec.world
        odd = (world.roughness_m, world.servo_backlash_deg, world.servo_delay_s)
        like_a_prior = not any(odd) and (world.friction_cone, world.time_step_s) == ("elliptic", 0.002)
        assert like_a_prior == (spec in plain)


def test_bumps_are_other_ones_in_every_world() -> None:
    assert len({spec.seed for spec in _plan(worlds=30).specs()}) == 30


@pytest.mark.slow
def test_curves_never_rise_and_never_pass_the_best_gait(findings: TransferFound) -> None:
    for name in _plan().optimizers:
        curves = curve_of(findings.of(name))
        for name in ("mean_m", "median_m", "p90_m"):
            assert (np.diff(curves[name]) <= 1e-12).all()
        assert curves["mean_m"].iloc[-1] >= floor_m(findings.runs)[0] - 1e-12


def test_a_prior_that_knows_the_worlds_needs_fewer_trials_than_random(findings: TransferFound) -> None:
    bayes, random = (curve_of(findings.of(name)) for name in ("bayes", "random"))
    assert bayes["mean_m"][14] < random["mean_m"][14] / 2


def test_seconds_and_trials_tell_the_same_story(findings: TransferFound) -> None:
    budget = _plan().budget
    ends_s = np.asarray(DURATION_S * np.arange(1, budget + 1) + 1e-6, dtype=np.float64)
    for name in ("pso", "random"):
        means = by_seconds(findings.of(name), ends_s)["mean_m"].to_numpy()
        assert np.abs(means - curve_of(findings.of(name))["mean_m"].to_numpy()).max() < 1e-12


def test_ending_walks_early_saves_seconds_and_gets_no_gait_for_them(findings: TransferFound) -> None:
    whole, early = (courses_of(findings, name) for name in ("bayes", "bayes-early"))
    for one, other in zip(whole, early, strict=True):
        assert one.walked_s[len(one.codes) - 1] == pytest.approx(DURATION_S * len(one.codes))
        assert other.walked_s[len(other.codes) - 1] <= DURATION_S * len(other.codes) + 1e-9
    assert sum(course.walked_s[-1] / len(course.codes) for course in early) < DURATION_S * len(early)


def test_a_walk_is_what_a_session_would_have_seen(landscapes: list[Landscape]) -> None:
    landscape = landscapes[0]
    shown = walk_of(landscape, 50)
    assert shown.duration_s == pytest.approx(DURATION_S)
    assert shown.status == "ok"
    assert shown.path_m[-1, 1] == pytest.approx(landscape.number("signed_m")[49], abs=1e-6)
    lengths: list[int] = []

    def after_four_seconds(path_m: FloatArray) -> bool:
        lengths.append(len(path_m))
        return len(path_m) >= 200

    cut = walk_of(landscape, 50, after_four_seconds)
    assert lengths == [50, 100, 150, 200]
    assert cut.duration_s == pytest.approx(4.0)
    assert (cut.status, cut.yaw_change_rad) == ("cut_short", None)


def test_landscapes_without_a_valid_gait_are_left_out_and_counted(landscapes: list[Landscape]) -> None:
    plan = _plan(optimizers=("random",))
    dead = _landscape(plan.specs()[0], _finals(1, seed=3)[0], invalid=GAITS)
    some = found_in(plan, [dead, landscapes[1]])
    values = plan.numbers(some)
    assert (values["landscapes"], values["landscapes_without_valid_gait"]) == (1, 1)
    with pytest.raises(RobotFaultError, match="no gait is valid"):
        search_worlds(plan, [dead])


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"worlds": 0}, "worlds"),
        ({"budget": 0}, "budget"),
        ({"runs": 0}, "runs"),
        ({"legs": (5, 9)}, "9"),
        ({"duration_s": 11.0}, "duration"),
        ({"duration_s": 12.0}, "duration 10 s, not 12 s"),
        ({"optimizers": ("bayes", "bayes")}, "once"),
        ({"optimizers": ("nobody",)}, "nobody"),
        ({"robot": shipped("pexod")}, "robot ant, not pexod"),
    ],
)
def test_what_cannot_be_asked_is_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        _plan(**changes).check()


def test_a_prior_from_the_same_worlds_is_refused() -> None:
    prior = replace(_prior(), origin={"family": load_randomization("transfer").model_dump(mode="json")})
    with pytest.raises(InputError, match="built from these worlds"):
        _plan(prior=prior).check()
