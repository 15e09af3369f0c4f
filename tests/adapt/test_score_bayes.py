"""The belief over scores of steered walks, and the search with it."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizer import Observation
from hexctl.adapt.optimizers.score_bayes import ScoreBayes, ScoreBelief
from hexctl.adapt.prior.samples import ScoreSamples, score_samples_of
from hexctl.testing.optimizer_conformance import ONE_FAILED, Make, OptimizerConformance
from hexctl.types import FloatArray
from tests.adapt.priors import made_up_score_prior
from tests.robots import shipped


def samples() -> ScoreSamples:
    return score_samples_of(made_up_score_prior(worlds=6), shipped("pexod"), 5, "speed")


def search(**options: Any) -> ScoreBayes:
    return ScoreBayes(ONE_FAILED, 0, **{"samples": samples(), **options})


def unseen(seed: int = 8) -> FloatArray:
    """Scores in a world that the samples do not have, s/m."""
    return np.exp(made_up_score_prior(worlds=1, seed=seed).log_scores[0, 0, :, 0])


def walk(one: ScoreBayes, scores: FloatArray, trials: int) -> list[int]:
    codes = []
    for _ in range(trials):
        (code,) = one.ask()
        one.tell([code], [float(scores[code - 1])])
        codes.append(code)
    return codes


class TestConformance(OptimizerConformance):
    spaces = (ONE_FAILED,)
    seeded = False

    @pytest.fixture
    def make(self) -> Make:
        return lambda space, seed: ScoreBayes(
            space, seed, samples=replace(samples(), leg=space.failed_legs[0])
        )


def test_invalid_gaits_are_never_recommended_nor_asked_for_again() -> None:
    one = search()
    (code,) = one.ask()
    one.tell([code], [INVALID_SCORE])
    assert one.recommended() is None
    scores = unseen()
    scores[code - 1] = INVALID_SCORE
    codes = walk(one, scores, 30)
    assert code not in codes
    assert one.recommended() in codes


def test_a_gait_that_seldom_walked_in_the_worlds_is_not_the_first() -> None:
    first = search().ask()[0]
    valid = samples().valid.copy()
    valid[first - 1] = 0.0
    assert search(samples=replace(samples(), valid=valid)).ask()[0] != first


def test_a_repeat_is_learned_from() -> None:
    one, scores = search(), unseen()
    first, _ = walk(one, scores, 2)
    seen = Observation(path_m=np.zeros((0, 2)), duration_s=30.0, yaw_change_rad=None, status="ok")
    one.repeat(first, 1e-3, seen)
    assert one.recommended() == first
    one.repeat(first, INVALID_SCORE, seen)
    assert one.recommended() != first


def test_the_search_is_over_when_the_trials_left_are_not_worth_it() -> None:
    one, scores = search(worth=0.01, budget=40), unseen()
    assert one.worthwhile
    trials = 0
    while one.worthwhile and trials < 40:
        walk(one, scores, 1)
        trials += 1
    assert 1 <= trials < 40
    best = one.recommended()
    assert best is not None
    assert scores[best - 1] / scores.min() < 1.03
    assert search(worth=0.0).worthwhile


def test_a_trial_is_believed_and_moves_the_others_with_it() -> None:
    belief = ScoreBelief(samples(), noise=0.005)
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
    calm, torn = ScoreBelief(samples(), noise=0.005), ScoreBelief(samples(), noise=0.005)
    mean, _ = calm.forecast()
    for number, code in enumerate((3, 40, 77, 110)):
        calm.observe(code, float(mean[code - 1]))
        torn.observe(code, float(mean[code - 1]) + (-1) ** number)
    untold = 60
    assert torn.forecast()[1][untold, untold] > 5 * calm.forecast()[1][untold, untold]
