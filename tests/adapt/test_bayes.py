"""Searches with a prior, of straight and of steered walks: good in worlds like those of their prior."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.bayes import SURE, Bayes
from hexctl.adapt.optimizers.score_bayes import ScoreBayes, ScoreBelief
from hexctl.adapt.prior.samples import FINAL, N_FEATURES, Samples, ScoreSamples, score_samples_of
from hexctl.backends.clock import PERIOD_S
from hexctl.errors import InputError
from hexctl.testing.optimizer_conformance import ONE_FAILED, search, travelled
from hexctl.types import FloatArray
from tests.adapt.priors import (
    DURATION_S,
    GAITS,
    MadeUpModel,
    made_up_bayes,
    made_up_score_prior,
    standing_samples,
    tell,
    whole_path_of,
)
from tests.robots import shipped

MODEL = MadeUpModel()

SAMPLES = MODEL.samples(24)

BELIEVED = MODEL.samples(48)


def worlds(count: int, seed: int = 500) -> FloatArray:
    """Worlds of the model that the prior has not seen, (count, gaits, N_FEATURES)."""
    return MODEL.worlds(count, seed)


def solvable(count: int, seed: int = 500) -> FloatArray:
    """Such worlds in which some gait is within 2 cm."""
    drawn = worlds(4 * count, seed)
    found: FloatArray = drawn[np.abs(drawn[..., FINAL]).min(axis=1) < 0.02][:count]
    assert len(found) == count
    return found


def adapt(search: Bayes, world: FloatArray, budget: int = 60) -> list[int]:
    """Search in a world without noise until sure, and return the codes walked."""
    codes: list[int] = []
    while len(codes) < budget and not search.finished:
        (code,) = search.ask()
        codes.append(code)
        tell(search, code, world[code - 1])
    return codes


def told(search: Bayes, code: int, features: FloatArray, status: str = "ok") -> None:
    """Tell a search a trial of a gait that it would not have asked for."""
    search._asked = [code]
    tell(search, code, features, status)


def finals(world: FloatArray, codes: list[int]) -> FloatArray:
    return np.asarray(np.abs(world[np.array(codes) - 1, FINAL]))


def test_it_needs_far_fewer_trials_than_random_search() -> None:
    """In worlds of its prior's model; random search needs 121 / (n + 1) for one of n good gaits."""
    needed, by_chance = [], []
    for seed, world in enumerate(solvable(15)):
        codes = adapt(made_up_bayes(BELIEVED), world)
        assert finals(world, codes).min() <= 0.025
        needed.append(len(codes))
        drawn = search(RandomSearch(ONE_FAILED, seed), 120)
        within = np.flatnonzero(finals(world, drawn) <= 0.025)
        by_chance.append(int(within[0]) + 1)
    assert np.mean(needed) < 0.5 * np.mean(by_chance)
    assert np.mean(needed) < 12


def test_it_is_sure_only_of_a_gait_that_was_walked_and_is_within_the_target() -> None:
    for target_m in (0.025, 0.1):
        for world in solvable(6, seed=77):
            optimizer = made_up_bayes(BELIEVED, target_m=target_m)
            codes = adapt(optimizer, world)
            assert optimizer.finished
            sure = [code for code in codes if optimizer.predict(code).chance >= SURE]
            assert sure
            assert (finals(world, sure) <= target_m).all()
            assert optimizer.recommended() in sure
            # And it did not continue after it had found one, save one so near to the target that it may miss.
            assert all(off_m > 0.9 * target_m for off_m in finals(world, codes)[:-1])


def test_before_the_first_trial_nothing_is_finished_however_sure_the_prior() -> None:
    still = np.zeros((32, GAITS, N_FEATURES))
    still += np.random.default_rng(0).normal(0, 1e-4, still.shape)
    still[..., -3:-1] = [1.6, 3.2]
    optimizer = made_up_bayes(Samples(leg=5, features=still, finished=np.ones(GAITS)))
    expected = optimizer.predict(1)
    assert expected.trial_sd_m == pytest.approx(math.hypot(expected.sd_m, 0.001))
    assert expected.chance > SURE
    assert not optimizer.finished
    tell(optimizer, optimizer.ask()[0], still[0, 0])
    assert optimizer.finished


def test_a_gait_is_confirmed_with_its_own_doubt_and_the_simulations_together() -> None:
    world = solvable(1)[0]
    (code,) = made_up_bayes(BELIEVED).ask()
    on_the_line = world[code - 1] * 0.0
    for uncertainty_m, sure in ((0.014, True), (0.017, False)):  # 0.025 m is 1.79 and 1.47 times as much
        optimizer = made_up_bayes(BELIEVED, uncertainty_m=uncertainty_m)
        assert optimizer.ask() == [code]
        tell(optimizer, code, on_the_line)
        assert optimizer.finished is sure
        chance = math.erf(0.025 / uncertainty_m / math.sqrt(2))
        assert optimizer.predict(code).chance == pytest.approx(chance, abs=0.01)


def test_what_the_trials_left_gain_together_decides() -> None:
    """With many trials left a search goes on where a single one would not be worth it."""
    world = worlds(4)[3]

    def walked(budget: int) -> int:
        optimizer = made_up_bayes(BELIEVED, target_m=0.0001, worth_m=0.004, budget=budget)
        count = 0
        while optimizer.worthwhile and count < 30:
            (code,) = optimizer.ask(1)
            tell(optimizer, code, world[code - 1])
            count += 1
        return count

    assert walked(1) < walked(10) <= walked(40) <= 30


@pytest.mark.parametrize("status", ["fell", "diverged", "no_progress", "cut_short"])
def test_a_gait_that_failed_is_not_asked_for_again(status: str) -> None:
    world = worlds(1)[0]
    optimizer = made_up_bayes(SAMPLES)
    failed: list[int] = []
    for index in range(40):
        if optimizer.finished:
            break
        (code,) = optimizer.ask()
        assert code not in failed
        if index % 2 == 0:
            failed.append(code)
            tell(optimizer, code, world[code - 1], status)
        else:
            tell(optimizer, code, world[code - 1] + 0.1)
    assert failed
    assert all(optimizer.predict(code).chance == 0.0 for code in failed)


def test_a_gait_that_fell_once_is_not_settled_on_though_it_walked_before() -> None:
    optimizer = made_up_bayes(SAMPLES)
    good = np.array([*np.zeros(10), 1.6, 3.2, 0.0])
    told(optimizer, 8, good)
    assert optimizer.finished
    told(optimizer, 8, good, "fell")
    assert not optimizer.finished
    assert optimizer.recommended() is None
    assert optimizer.predict(8).chance == 0.0


def stopped_after_s(optimizer: Bayes, code: int, path: FloatArray) -> float | None:
    enough = optimizer.early_stopping(code)
    for tick in range(50, len(path), 50):
        if enough(path[:tick]):
            return tick * PERIOD_S
    return None


def straight(code: int, final_m: float) -> FloatArray:
    """A walk of a gait of a usual world, but to another end."""
    features = BELIEVED.features[0, code - 1].copy()
    features[: FINAL + 1] = final_m * (np.arange(1, 11) / 10) ** 1.5
    features[-1] = 0.4 * final_m
    return whole_path_of(features)


def promising(optimizer: Bayes, within_m: float = 0.15) -> list[int]:
    """The gaits that are believed to end near the line."""
    return [int(row) + 1 for row in np.flatnonzero(np.abs(optimizer.forecast().mean_m) < within_m)]


def test_a_walk_far_off_has_should_stop_and_one_on_the_line_has_not() -> None:
    optimizer = made_up_bayes(BELIEVED)
    codes = promising(optimizer)[:6]
    assert codes
    for code in codes:
        assert stopped_after_s(optimizer, code, straight(code, 0.0)) is None
        for far_m in (-6.0, 6.0):
            stopped_s = stopped_after_s(optimizer, code, straight(code, far_m))
            assert stopped_s is not None
            assert DURATION_S / 4 <= stopped_s < 0.7 * DURATION_S


def test_a_walk_is_not_stopped_in_its_first_third_nor_when_the_robot_is_lost() -> None:
    enough = made_up_bayes(BELIEVED).early_stopping(1)
    path = straight(1, 30.0)
    assert not any(enough(path[:tick]) for tick in range(50, round(0.29 * len(path)), 50))
    path[700:] = np.nan
    assert not enough(path[:1000])


#: What a trial `[code, score, status, numbers]` cannot be, by its place; or the whole of it.
DAMAGE: list[tuple[int | slice, object]] = [
    *((0, code) for code in (0, 121, -1, "five")),
    *((3, numbers) for numbers in (None, [1.0], ["far"] * N_FEATURES)),
    (slice(None), []),
]


@pytest.mark.parametrize(("place", "value"), DAMAGE, ids=str)
def test_a_damaged_state_is_refused_and_nothing_is_taken_over(place: int | slice, value: object) -> None:
    standing = standing_samples(MODEL, 24)
    optimizer = made_up_bayes(standing, target_m=1e-6, sag_rad=MODEL.sags(1, 500)[0])
    adapt(optimizer, worlds(1)[0], budget=2)
    before = travelled(optimizer.state())
    damaged = travelled(optimizer.state())
    damaged["search"]["trials"][1][place] = value
    with pytest.raises(InputError):
        optimizer.restore(damaged)
    assert optimizer.state() == before


def score_samples() -> ScoreSamples:
    return score_samples_of(made_up_score_prior(worlds=6), shipped("pexod"), 5, "speed")


def scoring(**options: Any) -> ScoreBayes:
    return ScoreBayes(ONE_FAILED, 0, **{"samples": score_samples(), **options})


UNSEEN = np.exp(made_up_score_prior(worlds=1, seed=8).log_scores[0, 0, :, 0])


def unseen(code: int) -> float:
    """The score of a gait in a world that the samples do not have, s/m."""
    return float(UNSEEN[code - 1])


def test_invalid_gaits_are_never_recommended_nor_asked_for_again() -> None:
    one = scoring()
    (code,) = one.ask()
    one.tell([code], [INVALID_SCORE])
    assert one.recommended() is None
    codes = search(one, 30, landscape=lambda other: INVALID_SCORE if other == code else unseen(other))
    assert code not in codes
    assert one.recommended() in codes


def test_a_gait_that_seldom_walked_in_the_worlds_is_not_the_first() -> None:
    first = scoring().ask()[0]
    valid = score_samples().valid.copy()
    valid[first - 1] = 0.0
    assert scoring(samples=replace(score_samples(), valid=valid)).ask()[0] != first


def test_a_repeat_is_learned_from() -> None:
    one = scoring()
    first, _ = search(one, 2, landscape=unseen)
    seen = Observation(path_m=np.zeros((0, 2)), duration_s=30.0, yaw_change_rad=None, status="ok")
    one.repeat(first, 1e-3, seen)
    assert one.recommended() == first
    one.repeat(first, INVALID_SCORE, seen)
    assert one.recommended() != first


def test_the_search_is_over_when_the_trials_left_are_not_worth_it() -> None:
    one, trials = scoring(worth=0.01, budget=40), 0
    while one.worthwhile and trials < 40:
        trials += len(search(one, 1, landscape=unseen))
    assert 1 <= trials < 40
    best = one.recommended()
    assert best is not None
    assert unseen(best) / UNSEEN.min() < 1.03
    assert scoring(worth=0.0).worthwhile


def test_a_trial_is_believed_and_moves_the_others_with_it() -> None:
    belief = ScoreBelief(score_samples(), noise=0.005)
    before, spread = belief.forecast()
    belief.observe(7, before[6] + 0.1)
    after, narrowed = belief.forecast()
    assert after[6] == pytest.approx(before[6] + 0.1, abs=0.005)
    # A slow world is slow for all gaits.
    others = np.delete(after - before, 6)
    assert 0.03 < others.mean() < 0.1
    assert narrowed[6, 6] < 0.05 * spread[6, 6]
    assert (np.diagonal(narrowed) <= np.diagonal(spread) + 1e-12).all()


def test_a_world_unlike_all_others_widens_the_belief() -> None:
    calm, torn = ScoreBelief(score_samples(), noise=0.005), ScoreBelief(score_samples(), noise=0.005)
    mean, _ = calm.forecast()
    for number, code in enumerate((3, 40, 77, 110)):
        calm.observe(code, float(mean[code - 1]))
        torn.observe(code, float(mean[code - 1]) + (-1) ** number)
    untold = 60
    assert torn.forecast()[1][untold, untold] > 5 * calm.forecast()[1][untold, untold]
