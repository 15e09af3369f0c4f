"""Sightings of a driven robot, with the flaws of a camera, and what a filter makes of them."""

import math
from dataclasses import dataclass, field
from itertools import pairwise

import numpy as np

from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import BoolArray, FloatArray
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_belief import Sighting
from hexctl.vision.estimation.pose_filter import PoseEstimate, PoseFilter
from tests.driven import Driven
from tests.robots import shipped

DELAY_S = 0.03
SIGMA = np.array([0.01, 0.01, math.radians(0.5)])


@dataclass(frozen=True, kw_only=True)
class Eye:
    """How a camera sees: rate, lateness, noise, losses.

    Attributes:
        fps: pictures per second.
        late_s: from a picture to its sighting.
        dropped: share of the sightings that never come.
        wild: share that is anywhere within a metre.
        gaps: intervals in s without sightings.
        carried: at a time in s, the robot is put elsewhere in the floor's frame: x, y in m, yaw in rad.
        seed: of the noise.
    """

    fps: float = 30.0
    late_s: float = 0.08
    dropped: float = 0.1
    wild: float = 0.0
    gaps: tuple[tuple[float, float], ...] = ()
    carried: tuple[float, float, float, float] | None = None
    seed: int = 0


@dataclass(frozen=True, eq=False)
class Followed:
    """What a filter said at the rate of the pictures, beside the truth.

    Attributes:
        estimates: one for each picture.
        true: poses then, (N, 3).
    """

    estimates: list[PoseEstimate]
    true: FloatArray
    filter: PoseFilter = field(repr=False)

    @property
    def times_s(self) -> FloatArray:
        """When, (N,)."""
        return np.array([one.at_s for one in self.estimates])

    @property
    def poses(self) -> FloatArray:
        """What it said, (N, 3); NaN where lost."""
        return np.array([as_row(one.pose) for one in self.estimates])

    def errors(self, from_s: float = 1.0, to_s: float = math.inf) -> tuple[float, float]:
        """RMS of position in m and yaw in deg."""
        return rms(self.poses - self.true, (self.times_s >= from_s) & (self.times_s < to_s))

    def error_at(self, at_s: float) -> float:
        """Distance from the truth at a time, in m."""
        place = int(np.searchsorted(self.times_s, at_s))
        return float(np.hypot(*(self.poses - self.true)[place, :2]))

    def greatest_jump_m(self) -> float:
        """How much farther than the robot the published pose went between two pictures; not at restarts."""
        whole = np.array([before.restarts == after.restarts for before, after in pairwise(self.estimates)])
        steps = np.diff(self.poses[:, :2], axis=0) - np.diff(self.true[:, :2], axis=0)
        return float(np.nanmax(np.hypot(*steps.T)[whole]))


def as_row(pose: PlanarPose | None) -> tuple[float, float, float]:
    """A pose as three numbers."""
    return (math.nan,) * 3 if pose is None else (pose.x_m, pose.y_m, pose.yaw_rad)


def rms(off: FloatArray, rows: BoolArray) -> tuple[float, float]:
    """RMS of position in m and yaw in deg."""
    chosen = off[rows]
    yaw_deg = np.degrees(np.angle(np.exp(1j * chosen[:, 2])))
    return float(np.sqrt(np.nanmean(np.square(chosen[:, :2]).sum(axis=1)))), float(
        np.sqrt(np.nanmean(yaw_deg**2))
    )


def followed(walk: Driven, eye: Eye) -> Followed:
    """A filter that follows driven `ant`, whose own motion comes `DELAY_S` late."""
    rng = np.random.default_rng(eye.seed)
    motions = leg_motions(shipped(), walk.times_s, walk.joints_rad).motions
    true = carried(walk, eye)
    poses = PoseFilter()
    estimates, truths, told = [], [], 0
    waiting: list[Sighting] = []
    for frame in range(int(walk.times_s[-1] * eye.fps)):
        now_s = frame / eye.fps
        while told < len(motions) and walk.times_s[told + 1] <= now_s - DELAY_S:
            poses.move(walk.times_s[told], walk.times_s[told + 1], motions[told])
            told += 1
        waiting += sighted(at(walk.times_s, true, now_s), now_s, eye, rng)
        for one in [one for one in waiting if one.at_s + eye.late_s <= now_s + 1e-9]:
            waiting.remove(one)
            poses.see(one)
        estimates.append(poses.estimate(now_s))
        truths.append(at(walk.times_s, true, now_s))
    return Followed(estimates, np.array(truths), poses)


def carried(walk: Driven, eye: Eye) -> FloatArray:
    """True poses, (T, 3), the robot put elsewhere at a time."""
    true = walk.poses.copy()
    if eye.carried is not None:
        at_s, *elsewhere = eye.carried
        true[walk.times_s >= at_s] += elsewhere
    return true


def at(times_s: FloatArray, rows: FloatArray, at_s: float) -> FloatArray:
    """Rows (T, 3) at a time between theirs."""
    return np.array([np.interp(at_s, times_s, column) for column in rows.T])


def sighted(true: FloatArray, at_s: float, eye: Eye, rng: np.random.Generator) -> list[Sighting]:
    """The sighting of a pose, if there is one."""
    lost, wild = rng.random(2)
    noise, anywhere = rng.normal(size=3) * SIGMA, rng.uniform(-1, 1, 3)
    if lost < eye.dropped or any(from_s <= at_s < to_s for from_s, to_s in eye.gaps):
        return []
    x_m, y_m, yaw_rad = true + (anywhere if wild < eye.wild else noise)
    return [Sighting(at_s, PlanarPose(x_m, y_m, wrapped_rad(yaw_rad)), np.diag(SIGMA**2))]
