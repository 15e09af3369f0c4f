"""The worlds of a prior as samples for one failed leg, with those of symmetric legs."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.optimizer import Observation
from hexctl.adapt.prior.drift import half_steady_s
from hexctl.adapt.prior.prior import CHECKPOINTS, SCORES, Outcomes, Prior, ScorePrior
from hexctl.adapt.space import GaitSpace
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.errors import InputError
from hexctl.robot.failure import UNKNOWN
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray

#: Features of a walk, in this order: deviation at the checkpoints, progress at half time and at the end, yaw.
PROGRESS_AT = (CHECKPOINTS // 2 - 1, CHECKPOINTS - 1)
N_FEATURES = CHECKPOINTS + len(PROGRESS_AT) + 1
FINAL, DISTANCE, YAW = CHECKPOINTS - 1, N_FEATURES - 2, N_FEATURES - 1

#: Features that change sign in a mirror.
MIRRORED = np.ones(N_FEATURES)
MIRRORED[: FINAL + 1] = MIRRORED[YAW] = -1.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Worlds as samples.

    Attributes:
        features: of each gait in each world, (worlds, gaits, N_FEATURES).
        finished: share of worlds in which each gait walked to the end, (gaits,).
        sag_rad: static deflection of the joints in the stance, (worlds, 18), or None.
        failed_leg_tells: whether the failed leg's deflection identifies worlds: it is limp in some and jammed
            in others.
    """

    leg: int
    features: FloatArray
    finished: FloatArray
    sag_rad: FloatArray | None = None
    failed_leg_tells: bool = False


def samples_of(prior: Prior, robot: Robot, leg: int) -> Samples:
    """Samples for a failed leg: of its worlds, and of symmetric legs.

    A turned or mirrored gait begins at another phase: it is a plausible walk of this leg, not the same one.
    Raises InputError if the prior has neither.
    """
    moved, sags_rad = [], []
    for symmetry, row, order in _moves(prior, robot, leg):
        progress_m, yaw_rad = prior.progress_m[row][..., PROGRESS_AT], prior.yaw_rad[row][..., np.newaxis]
        worlds = np.concatenate([prior.signed_m[row], progress_m, yaw_rad], axis=-1)[:, order]
        moved.append(worlds * MIRRORED if symmetry.mirrored else worlds)
        if prior.sag_rad is not None:
            sags_rad.append(symmetry.joints(prior.sag_rad[row]))
    features = np.concatenate(moved)
    _check_known(features[..., FINAL], leg)
    return Samples(
        leg=leg,
        features=_filled(features),
        finished=np.isfinite(features[..., FINAL]).mean(axis=0),
        sag_rad=np.concatenate(sags_rad) if sags_rad else None,
        failed_leg_tells=prior.key.failure == UNKNOWN,
    )


@dataclass(frozen=True, eq=False)
class ScoreSamples:
    """Scores of one failed leg's steered walks in worlds, by one objective.

    `log_scores` are natural logarithms, (worlds, gaits); for a walk that did not last, from its gait in other
    worlds. `valid` is the share of the worlds in which each gait's walk was valid, (gaits,).
    """

    leg: int
    log_scores: FloatArray
    valid: FloatArray


def score_samples_of(prior: ScorePrior, robot: Robot, leg: int, objective: str) -> ScoreSamples:
    """Samples of a prior for one failed leg, by one objective of `SCORES`.

    Raises InputError for another objective, or if the prior has neither the leg nor a symmetric one.
    """
    if objective not in SCORES:
        raise InputError(f"objective: got {objective} with a prior; allowed: {', '.join(SCORES)}")
    column, scores, valid = SCORES.index(objective), [], []
    for _, row, order in _moves(prior, robot, leg):
        scores.append(prior.log_scores[row, :, order, column].T)
        valid.append(prior.valid[row][:, order])
    known = np.concatenate(scores)
    _check_known(known, leg)
    never = ~np.isfinite(known).any(axis=0)
    filled = _filled(known)
    filled[:, never] = filled[:, ~never].mean(axis=0).max()
    return ScoreSamples(leg=leg, log_scores=filled, valid=np.concatenate(valid).mean(axis=0))


@dataclass(frozen=True, eq=False)
class DriftSamples:
    """Drift of the gaits of a failed leg in the worlds of a prior.

    Attributes:
        drifts_rad: course and half turn of each gait in each world, (worlds, gaits, 2).
        distance_m: mean distance from start to end of each gait, (gaits,).
    """

    leg: int
    drifts_rad: FloatArray
    distance_m: FloatArray


def drift_samples_of(prior: Prior, robot: Robot, leg: int) -> DriftSamples:
    """Drifts of a prior's worlds for one failed leg; raises InputError as `samples_of` does."""
    drifts, ways = [], []
    for symmetry, row, order in _moves(prior, robot, leg):
        path_m = np.stack([prior.progress_m[row], prior.signed_m[row]], axis=-1)[:, order]
        sign = -1.0 if symmetry.mirrored else 1.0
        drifts.append(sign * _drifts_rad(path_m, prior.key.duration_s))
        ways.append(np.hypot(*np.moveaxis(path_m[:, :, -1], -1, 0)))
    known = np.concatenate(drifts)
    _check_known(known, leg)
    distance_m = _filled(np.concatenate(ways)).mean(axis=0)
    return DriftSamples(leg=leg, drifts_rad=_filled(known), distance_m=distance_m)


def _drifts_rad(path_m: FloatArray, duration_s: float) -> FloatArray:
    """Course and half turn of paths of checkpoints, (..., CHECKPOINTS, 2), as of `drift_of`, (..., 2)."""
    steps_m = np.diff(path_m, axis=-2)
    direction_rad = np.unwrap(np.arctan2(steps_m[..., 1], steps_m[..., 0]), axis=-1)
    apart_s = duration_s * (np.arange(1.0, CHECKPOINTS) - CHECKPOINTS / 2) / CHECKPOINTS
    turn_rad_s = direction_rad @ apart_s / (apart_s @ apart_s)
    course_rad = np.arctan2(path_m[..., -1, 1], path_m[..., -1, 0])
    return np.stack([course_rad, turn_rad_s * half_steady_s(duration_s)], axis=-1)


def ranked_codes(prior: Prior | ScorePrior, robot: Robot, leg: int, objective: str = "speed") -> list[int]:
    """All codes, the best one of a prior first; gaits that fall in some worlds rank lower.

    Steered walks rank by the mean log score of the objective, one of `SCORES`, open-loop walks by the mean
    deviation. Raises InputError as `samples_of` and `score_samples_of` do.
    """
    if isinstance(prior, ScorePrior):
        scores = score_samples_of(prior, robot, leg, objective)
        worlds, means, share = len(scores.log_scores), scores.log_scores.mean(axis=0), scores.valid
    else:
        ends = samples_of(prior, robot, leg)
        means = np.log(np.abs(ends.features[..., FINAL]).mean(axis=0))
        worlds, share = len(ends.features), ends.finished
    order = np.argsort(means - np.log(chance_of(share, worlds)), kind="stable")
    return [int(row) + 1 for row in order]


def chance_of(share: FloatArray, worlds: int) -> FloatArray:
    """Probability from a share of some worlds, by Laplace's rule of succession: never zero."""
    return (worlds * share + 1) / (worlds + 2)


def covers(robot: Robot, self_rotation: str, legs: tuple[int, ...], leg: int) -> bool:
    """Whether a prior of some legs covers a failed leg, directly or by symmetry."""
    return bool(_sources(robot, self_rotation, legs, leg))


def _sources(
    robot: Robot, self_rotation: str, legs: tuple[int, ...], leg: int
) -> list[tuple[BodySymmetry, int]]:
    """Symmetries and the legs they move; without self-rotation they must keep the direction of travel."""
    return [
        (symmetry, source)
        for symmetry in body_symmetries(robot)
        for source in legs
        if symmetry.legs[source - 1] == leg and (self_rotation != "none" or symmetry.keeps_heading)
    ]


def _moves(prior: Outcomes, robot: Robot, leg: int) -> Iterator[tuple[BodySymmetry, int, NDArray[np.int64]]]:
    """Symmetries that move legs of a prior to one: the row of the leg, and the order of its moved gaits.

    Raises InputError if there is none.
    """
    sources = _sources(robot, prior.key.self_rotation, prior.legs, leg)
    if not sources:
        legs = ", ".join(str(known) for known in prior.legs)
        raise InputError(f"prior: got failed leg {leg}; allowed: {legs}")
    for symmetry, source in sources:
        yield symmetry, prior.legs.index(source), np.argsort(moved_codes(symmetry, source))


def _check_known(values: FloatArray, leg: int) -> None:
    if not np.isfinite(values).any():
        raise InputError(
            f"prior: leg {leg} fell with every gait in every world; nothing can be told from that"
        )


def moved_codes(symmetry: BodySymmetry, leg: int) -> NDArray[np.int64]:
    """Codes of the gaits that a symmetry makes, for codes 1..120 with a leg failed, (120,).

    A failed leg pins its own slot. If it becomes another leg all slots shift, and the walk begins at another
    phase: nearly the same walk, but not exactly.
    """
    before, moved_leg = GaitSpace((leg,)), symmetry.legs[leg - 1]
    slots = before.slots[:, np.array(symmetry.legs_before) - 1]
    shift = moved_leg - slots[:, [moved_leg - 1]]
    after = GaitSpace((moved_leg,))
    return np.array([after.code_of(row) for row in ((slots + shift - 1) % N_LEGS + 1).tolist()])


def features_of(observation: Observation, duration_s: float) -> FloatArray:
    """Features of a walk of a planned duration, (N_FEATURES,), NaN after its end."""
    if observation.status == "diverged":
        return np.full(N_FEATURES, np.nan)  # an unstable simulation says nothing
    times_s = duration_s * np.arange(1, CHECKPOINTS + 1) / CHECKPOINTS
    rows = observation.at(times_s)
    yaw_rad = observation.yaw_change_rad if observation.finished else None
    return np.concatenate([rows[:, 1], rows[PROGRESS_AT, 0], [np.nan if yaw_rad is None else yaw_rad]])


def _filled(features: FloatArray) -> FloatArray:
    """Replace unknown features of fallen robots by the mean; stretch the others of gaits that rarely walk."""
    known = np.isfinite(features)
    counts = np.maximum(known.sum(axis=0), 1)
    means = np.where(known, features, 0.0).sum(axis=0) / counts
    stretched = means + (features - means) * np.sqrt(len(features) / counts)
    return np.asarray(np.where(known, stretched, means))
