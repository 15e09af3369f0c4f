"""Intelligent trial and error: an archive of simulated gaits, searched by trials on the failed robot.

After A. Cully, J. Clune, D. Tarapore and J.-B. Mouret, "Robots that can adapt like animals", Nature 521
(2015). MAP-Elites fills an archive with the fastest gait of the intact robot for each combination of duty
factors. The archive is the mean of a Gaussian process over duty factors, with a Matern kernel (nu = 5/2).
Each trial walks the gait of the highest upper confidence bound. The search ends once the best trial reaches
90 % of the highest mean.
"""

import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.archive import ArchiveKind
from hexctl.control.batch import SimTrial
from hexctl.robot.configs import config_root
from hexctl.robot.model import Robot
from hexctl.study.recovery.shaped_walk import ShapeSearch
from hexctl.types import N_LEGS, FloatArray

VERSION = 1

KIND = ArchiveKind(name="behaviours", versions=(VERSION,), command="python -m benchmarks.build_archive")

BEHAVIOURS = "behaviours"

#: Length scale of the kernel, as published.
SCALE = 0.4

#: Weight of the uncertainty and variance of the noise: those published for the fastest gait at 0.32 m/s, here
#: for speeds as shares of the commanded one.
DARING, NOISE = 0.05 / 0.32, 0.001 / 0.32**2

#: Share of the highest mean at which the search ends, and maximum number of trials.
ENOUGH, MOST_TRIALS = 0.9, 20


@dataclass(frozen=True, kw_only=True, eq=False)
class Behaviours:
    """Archive of one robot.

    Attributes:
        shapes: of m gaits, (m, 6, 4).
        duties: share of the time that each foot is on the floor, (m, 6).
        speeds: along the line, as shares of the commanded speed, (m,).
        robot_fingerprint: of the robot that walked.
        origin: how it was built, in JSON values.
    """

    shapes: FloatArray
    duties: FloatArray
    speeds: FloatArray
    robot_fingerprint: str
    origin: dict[str, Any]

    @classmethod
    def of(cls, head: dict[str, Any], arrays: dict[str, NDArray[Any]]) -> "Behaviours":
        """The archive of a file."""
        parts = {name: arrays[name].astype(float) for name in ("shapes", "duties", "speeds")}
        return cls(**parts, robot_fingerprint=head["robot_fingerprint"], origin=head["origin"])

    def save(self, path: Path) -> None:
        """Write an archive atomically, in half precision; raises ArchiveFileError when the disk refuses."""
        arrays = {name: getattr(self, name).astype(np.float16) for name in ("shapes", "duties", "speeds")}
        head = {"robot_fingerprint": self.robot_fingerprint, "origin": self.origin}
        KIND.save(path, VERSION, head, arrays)

    def towards(self, heading_rad: float) -> "Behaviours":
        """The archive for another direction of travel, to the nearest leg of six equal ones."""
        legs = round(N_LEGS * heading_rad / math.tau)
        shapes, duties = (np.roll(each, legs, axis=1) for each in (self.shapes, self.duties))
        return replace(self, shapes=shapes, duties=duties)


def behaviours_file(robot: Robot) -> Path:
    """File of the shipped archive of a robot, which may be missing."""
    return config_root() / BEHAVIOURS / f"{robot.name}.npz"


def behaviours_of(robot: Robot) -> Behaviours:
    """The shipped archive of a robot; raises InputError for a robot without one."""
    return KIND.load_of_robot(behaviours_file(robot), robot.name, robot.fingerprint, Behaviours.of)


class TrialAndErrorSearch(ShapeSearch):
    """The search in an archive."""

    def __init__(self, behaviours: Behaviours) -> None:
        self._known, self._tried, self._scores = behaviours, list[int](), list[float]()

    def ask(self) -> list[FloatArray]:
        """The gait of the highest upper confidence bound."""
        mean, error = self._belief()
        over = len(self._tried) == MOST_TRIALS
        if over or (self._scores and max(self._scores) >= ENOUGH * mean.max()):
            return []
        self._tried.append(int(np.argmax(mean + DARING * error)))
        return [self._known.shapes[self._tried[-1]]]

    def tell(self, scores: FloatArray) -> None:
        """Take the score of the last gait."""
        self._scores += scores.tolist()

    def _belief(self) -> tuple[FloatArray, FloatArray]:
        """Mean and standard deviation of the scores of all gaits, (m,) each."""
        duties, speeds, tried = self._known.duties, self._known.speeds, self._tried
        if not tried:
            return speeds, np.ones(len(speeds))
        across = matern(duties, duties[tried])
        own = matern(duties[tried], duties[tried]) + NOISE * np.eye(len(tried))
        gain = np.linalg.solve(own, across.T).T
        mean = speeds + gain @ (np.array(self._scores) - speeds[tried])
        return mean, np.sqrt(np.maximum(0.0, 1 - (gain * across).sum(axis=-1)))


def search_of_behaviours(trial: SimTrial) -> TrialAndErrorSearch:
    """A search in the archive of a robot, turned to the direction of a walk."""
    return TrialAndErrorSearch(behaviours_of(trial.robot).towards(trial.plan.heading_rad))


def matern(one: FloatArray, other: FloatArray) -> FloatArray:
    """Matern kernel (nu = 5/2) between points (m, d) and (k, d), (m, k)."""
    scaled = np.sqrt(5) / SCALE * np.linalg.norm(one[:, np.newaxis] - other, axis=-1)
    return np.asarray((1 + scaled + scaled**2 / 3) * np.exp(-scaled))
