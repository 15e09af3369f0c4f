"""Acquisition functions: expected improvement of the smallest deviation over one or two trials."""

import math

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from numpy.typing import NDArray

from hexctl.adapt.prior.belief import Forecast
from hexctl.types import BoolArray, FloatArray

#: Best deviation assumed before any trial: gaits that end farther off all count as equally bad.
WORST_M = 0.5

#: Numbers of candidates for two trials ahead: with maximum gain, and with maximum uncertainty.
PROMISING, LEAST_KNOWN = 40, 10

#: Discount of the gain of the second trial.
LATER = 0.98

#: Nodes and weights of the quadrature over outcomes of a trial, in standard scores.
_SCORES, _WEIGHTS = hermegauss(7)
_WEIGHTS = _WEIGHTS / _WEIGHTS.sum()


def chance_within(mean_m: FloatArray, sd_m: FloatArray, bound_m: float) -> FloatArray:
    """Probability that normal deviations lie within a bound on either side."""
    from scipy.special import ndtr

    return np.asarray(ndtr((bound_m - mean_m) / sd_m) - ndtr((-bound_m - mean_m) / sd_m))


def chance_above(mean_m: FloatArray, sd_m: FloatArray, bound_m: float) -> FloatArray:
    """Probability that normal values lie above a bound."""
    from scipy.special import ndtr

    return np.asarray(ndtr((mean_m - bound_m) / sd_m))


def expected_size_m(mean_m: FloatArray, sd_m: FloatArray) -> FloatArray:
    """Expected absolute value of normal deviations: the mean of the folded normal."""
    from scipy.special import erf

    score = mean_m / sd_m
    tails = sd_m * math.sqrt(2 / math.pi) * np.exp(-0.5 * score * score)
    return np.asarray(tails + mean_m * erf(score / math.sqrt(2)))


def expected_excess(mean: FloatArray, sd: FloatArray) -> FloatArray:
    """Expected part of normal values above zero, E[max(0, x)].

    With x = best - f it is the expected improvement of f on a best (Mockus 1978).
    """
    from scipy.special import ndtr

    score = mean / sd
    density = np.exp(-0.5 * score * score) / math.sqrt(2 * math.pi)
    return np.asarray(mean * ndtr(score) + sd * density)


def expected_gain_m(mean_m: FloatArray, sd_m: FloatArray, best_m: FloatArray | float) -> FloatArray:
    """Expected improvement of the absolute value of normal deviations on a best, in m.

    E[max(0, best - |f|)] (Mockus 1978) for an absolute value: a tent of three ramps.
    """
    nearer, farther = expected_excess(mean_m + best_m, sd_m), expected_excess(mean_m - best_m, sd_m)
    return nearer - 2 * expected_excess(mean_m, sd_m) + farther


def most_promising(forecast: Forecast, chance_valid: FloatArray, tried: BoolArray, best_m: float) -> int:
    """Row of the untried gait with the maximum gain over one trial; arguments as of `most_useful`."""
    gain = expected_gain_m(forecast.mean_m, forecast.sd_m, min(best_m, WORST_M)) * chance_valid
    return int(np.argmax(np.where(tried, -np.inf, _rounded(gain))))


def most_useful(forecast: Forecast, chance_valid: FloatArray, tried: BoolArray, best_m: float) -> int:
    """Row of the untried gait with the maximum gain over two trials.

    The first outcome changes the belief about all gaits; the second trial is then the best one. The
    expectation over outcomes is a quadrature (as in the knowledge gradient, Frazier 2008).

    Args:
        chance_valid: probability that a trial of each gait is valid, (gaits,).
        tried: gaits that are left out, (gaits,).
        best_m: smallest expected deviation of a walked gait, infinity before any.
    """
    best_m = min(best_m, WORST_M)
    allowed = np.where(tried, 0.0, chance_valid)
    sd_m = forecast.sd_m
    now = expected_gain_m(forecast.mean_m, sd_m, best_m) * allowed
    rows = _candidates(now, np.where(tried, 0.0, sd_m), tried)
    trial_sd_m = np.hypot(sd_m[rows], forecast.noise_m)
    pull = forecast.covariance_m2[:, rows] / trial_sd_m  # change of every gait per standard score of a trial
    then_mean = forecast.mean_m[:, np.newaxis, np.newaxis] + pull[:, :, np.newaxis] * _SCORES
    then_sd = np.sqrt(np.maximum(sd_m[:, np.newaxis] ** 2 - pull**2, 1e-8))[:, :, np.newaxis]
    # Mean of the gait itself after the trial; noise makes it move less than the outcome.
    own = forecast.mean_m[rows][:, np.newaxis] + (sd_m[rows] ** 2 / trial_sd_m)[:, np.newaxis] * _SCORES
    valid = chance_valid[rows][:, np.newaxis]
    then_best = valid * np.minimum(best_m, np.abs(own)) + (1 - valid) * best_m
    second = expected_gain_m(then_mean, then_sd, then_best) * allowed[:, np.newaxis, np.newaxis]
    second[rows, np.arange(rows.size)] = 0.0
    gain = now[rows] + LATER * (second.max(axis=0) @ _WEIGHTS)
    return int(rows[np.argmax(_rounded(gain))])


def _candidates(gain: FloatArray, sd_m: FloatArray, tried: BoolArray) -> NDArray[np.int64]:
    promising = np.argsort(-_rounded(gain), kind="stable")[:PROMISING]
    rows = np.union1d(promising, np.argsort(-_rounded(sd_m), kind="stable")[:LEAST_KNOWN])
    return rows[~tried[rows]]


def _rounded(values_m: FloatArray) -> FloatArray:
    """Values to the nanometre: mirrored gaits differ in last bits, depending on the processor."""
    return np.asarray(np.round(values_m, 9))
