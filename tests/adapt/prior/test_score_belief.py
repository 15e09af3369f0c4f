"""The belief over scores of steered walks."""

import numpy as np
import pytest

from hexctl.adapt.prior.samples import ScoreSamples, score_samples_of
from hexctl.adapt.prior.score_belief import ScoreBelief
from hexctl.types import FloatArray
from tests.adapt.priors import made_up_score_prior
from tests.robots import shipped


def samples(worlds: int = 6) -> ScoreSamples:
    return score_samples_of(made_up_score_prior(worlds=worlds), shipped("pexod"), 5, "speed")


def unseen() -> FloatArray:
    """Log scores in a world that the samples do not have."""
    return np.asarray(made_up_score_prior(worlds=1, seed=8).log_scores[0, 0, :, 0])


def test_before_any_trial_the_mean_is_that_of_the_worlds() -> None:
    mean, covariance = ScoreBelief(samples(), noise=0.01).forecast()
    np.testing.assert_allclose(mean, samples().log_scores.mean(axis=0))
    np.testing.assert_allclose(covariance, covariance.T)
    assert np.linalg.eigvalsh(covariance).min() > 0


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


def test_trials_bring_the_belief_nearer_to_the_world() -> None:
    belief, world = ScoreBelief(samples(), noise=0.005), unseen()
    errors = []
    for code in range(1, 120, 10):
        errors.append(float(np.sqrt(((belief.forecast()[0] - world) ** 2).mean())))
        belief.observe(code, float(world[code - 1]))
    assert errors[-1] < 0.6 * errors[0]


def test_a_world_unlike_all_others_widens_the_belief() -> None:
    calm, torn = ScoreBelief(samples(), noise=0.005), ScoreBelief(samples(), noise=0.005)
    mean, _ = calm.forecast()
    for number, code in enumerate((3, 40, 77, 110)):
        calm.observe(code, float(mean[code - 1]))
        torn.observe(code, float(mean[code - 1]) + (-1) ** number)
    untold = 60
    assert torn.forecast()[1][untold, untold] > 5 * calm.forecast()[1][untold, untold]
