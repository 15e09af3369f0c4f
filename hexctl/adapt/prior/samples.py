"""A prior's simulations as samples of what one failed leg's 120 gaits might do."""

from dataclasses import dataclass

import numpy as np

from hexctl.adapt.prior.prior import CHECKPOINTS, Prior
from hexctl.adapt.prior.symmetry import Symmetries, Symmetry
from hexctl.adapt.shown import Shown
from hexctl.errors import InputError
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: What a walk shows, in this order: deviation at the checkpoints, progress at half time and at the end, yaw.
PROGRESS_AT = (CHECKPOINTS // 2 - 1, CHECKPOINTS - 1)
N_FEATURES = CHECKPOINTS + len(PROGRESS_AT) + 1
FINAL, DISTANCE, YAW = CHECKPOINTS - 1, N_FEATURES - 2, N_FEATURES - 1

#: What changes its sign in a mirror.
MIRRORED = np.ones(N_FEATURES)
MIRRORED[: FINAL + 1] = MIRRORED[YAW] = -1.0


@dataclass(frozen=True, eq=False)
class Samples:
    """Worlds as samples.

    Attributes:
        leg: the failed leg.
        features: what each gait showed in each world, (worlds, gaits, N_FEATURES).
        finished: the share of worlds in which each gait walked to the end, (gaits,).
        sag_rad: by how much the joints stayed behind in the stance, (worlds, 18); None where nobody looked.
    """

    leg: int
    features: FloatArray
    finished: FloatArray
    sag_rad: FloatArray | None = None


def samples_of(prior: Prior, robot: Robot, leg: int) -> Samples:
    """Return the samples for a failed leg: of its own worlds, and by the robot's symmetries of other legs'.

    Another leg's gait, turned or mirrored onto this one, begins at another point of its cycle. That makes it
    a plausible walk of this leg, not the same one, and a sample is no more than plausible anyway.
    Raises InputError when nothing in the prior says anything about the leg.
    """
    sources = _sources(robot, prior.question.self_rotation, prior.legs, leg)
    moved = [_moved_worlds(prior, symmetry, source) for symmetry, source in sources]
    if not moved:
        legs = ", ".join(str(known) for known in prior.legs)
        raise InputError(f"prior: got failed leg {leg}; allowed: {legs}")
    features = np.concatenate(moved)
    if not np.isfinite(features[..., FINAL]).any():
        raise InputError(
            f"prior: leg {leg} fell with every gait in every world; nothing can be told from that"
        )
    finished = np.isfinite(features[..., FINAL]).mean(axis=0)
    return Samples(
        leg=leg, features=_filled(features), finished=finished, sag_rad=_moved_sags(prior, sources)
    )


def serves(robot: Robot, self_rotation: str, legs: tuple[int, ...], leg: int) -> bool:
    """Return whether a prior of some legs says anything about a failed leg."""
    return bool(_sources(robot, self_rotation, legs, leg))


def _sources(robot: Robot, self_rotation: str, legs: tuple[int, ...], leg: int) -> list[tuple[Symmetry, int]]:
    """Return by which symmetries which legs become a failed leg.

    Without self-rotation the body does not follow the failed leg, and only what leaves the direction of
    travel as it is will do.
    """
    return [
        (symmetry, source)
        for symmetry in Symmetries(robot).all
        for source in legs
        if symmetry.legs[source - 1] == leg and (self_rotation != "none" or symmetry.keeps_heading)
    ]


def features_of(shown: Shown, duration_s: float) -> FloatArray:
    """Return what a walk of a planned duration showed, (N_FEATURES,), NaN for what it did not."""
    if shown.status == "diverged":
        return np.full(N_FEATURES, np.nan)  # where it went is the solver's business
    times_s = duration_s * np.arange(1, CHECKPOINTS + 1) / CHECKPOINTS
    rows = shown.at(times_s)
    yaw_rad = shown.yaw_change_rad if shown.finished else None
    return np.concatenate([rows[:, 1], rows[PROGRESS_AT, 0], [np.nan if yaw_rad is None else yaw_rad]])


def _moved_worlds(prior: Prior, symmetry: Symmetry, source: int) -> FloatArray:
    """Return the worlds of a leg, moved by a symmetry, (worlds, gaits, N_FEATURES)."""
    row = prior.legs.index(source)
    progress = prior.progress_m[row][..., PROGRESS_AT]
    features = np.concatenate([prior.signed_m[row], progress, prior.yaw_rad[row][..., np.newaxis]], axis=-1)
    if symmetry.mirrored:
        features = features * MIRRORED
    moved = np.empty_like(features)
    moved[:, symmetry.codes(source) - 1] = features
    return moved


def _moved_sags(prior: Prior, sources: list[tuple[Symmetry, int]]) -> FloatArray | None:
    """Return how the joints stood in the worlds of some legs, moved by symmetries, (worlds, 18)."""
    if prior.sag_rad is None:
        return None
    rows = [symmetry.joints(prior.sag_rad[prior.legs.index(source)]) for symmetry, source in sources]
    return np.concatenate(rows)


def _filled(features: FloatArray) -> FloatArray:
    """Return the features with what fallen robots did not show replaced by the mean of those that walked.

    What those that walked differ by is stretched, so that a gait which seldom walks is not believed the more
    alike in all worlds.
    """
    known = np.isfinite(features)
    counts = np.maximum(known.sum(axis=0), 1)
    means = np.where(known, features, 0.0).sum(axis=0) / counts
    stretched = means + (features - means) * np.sqrt(len(features) / counts)
    return np.asarray(np.where(known, stretched, means))
