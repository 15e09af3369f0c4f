"""Current pose of a robot, from late sightings and its own motion, without jumps.

A picture shows the robot at the time of exposure. The filter therefore applies each sighting at its own time
and replays the motion since then. It rejects implausible sightings. If several of these agree for a while,
the robot was carried: the filter restarts and reports it. The published pose moves smoothly to the estimate.
"""

import bisect
import math
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hexctl.robot.rotations import wrapped_rad
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_belief import POSE, OwnMotion, PoseBelief, Sighting

#: `seeing`: a sighting was believed just now; `bridging`: odometry only; `lost`: nothing is known.
Sight = Literal["seeing", "bridging", "lost"]

#: A sighting is recent for this time, and without sightings for longer than the other there is no pose.
SEEING_S, LOST_AFTER_S = 0.3, 3.0

#: Sightings and motions older than this are not played again.
HISTORY_S = 1.0

#: Sightings farther off than this many standard deviations are not believed.
MOST_SIGMA = 5.0

#: Sightings that agree with one another are nearer than this.
AGREE_SIGMA = 4.0

#: So many sightings must agree for a first pose, and for so long where another pose is believed.
LEAST_AGREEING = 3
AGREEING_S = 0.3

#: How long rejected sightings are kept.
SUSPECT_S = 1.0

#: Time constant of the velocity without odometry. A robot without messages is soon stopped by its guard.
STOPPING_S = 0.1

#: After this time without odometry the velocity comes from sightings only, and decays with the other time.
ODOMETRY_GONE_S = 0.5
COASTING_S = 0.5

#: Corrections are blended in with this time constant, no faster than this and in no larger steps.
BLENDING_S = 0.07
MOST_BLENDED = np.array([0.3, 0.3, math.radians(60.0)])
MOST_BLENDED_STEP = np.array([0.01, 0.01, math.radians(2.0)])


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class PoseEstimate(ArrayFields):
    """Pose of a robot at one time.

    Attributes:
        at_s: the time.
        sight: source of the pose.
        pose: in the floor's frame; None while lost.
        covariance: of x, y in m and yaw in rad, (3, 3); None while lost.
        age_s: age of the picture of the last accepted sighting; infinite without one.
        restarts: number of restarts because the robot was elsewhere.
    """

    at_s: float
    sight: Sight
    pose: PlanarPose | None
    covariance: FloatArray | None
    age_s: float
    restarts: int


class PoseFilter:
    """Fuses sightings of a robot with its own motion, all on one clock; `restarts` counts carried robots."""

    def __init__(self) -> None:
        self._motions: list[OwnMotion] = []
        self._yaw: tuple[float, float] | None = None
        self._base: PoseBelief | None = None
        self._fused: list[tuple[Sighting, PoseBelief]] = []
        self._mark: tuple[PoseBelief, PoseBelief] | None = None
        self._suspects: list[Sighting] = []
        self._slip_of: PoseBelief | None = None
        self._accepted_s, self._newest_s = -math.inf, -math.inf
        self._published_s, self._offset = -math.inf, np.zeros(3)
        self.restarts = 0

    def move(self, from_s: float, to_s: float, motion: FloatArray, yaw_rad: float | None = None) -> None:
        """Apply a motion measured by the robot itself, for example by leg odometry.

        Args:
            from_s: its start; no earlier than the end of the previous motion.
            to_s: its end.
            motion: (3,), in the body's frame at the beginning: forward and left in m, counter-clockwise in
                rad.
            yaw_rad: yaw at the end from the robot's own sensor, or None; only its changes count.
        """
        before, self._yaw = self._yaw, None if yaw_rad is None else (to_s, yaw_rad)
        measured = yaw_rad is not None and before is not None and abs(before[0] - from_s) < 1e-6
        if measured and yaw_rad is not None and before is not None:
            motion = np.array([motion[0], motion[1], wrapped_rad(yaw_rad - before[1])])
        own = OwnMotion(from_s, to_s, motion, measured)
        with self._blended(self._published_s):
            self._motions.append(own)
            self._seen_until(to_s)
            self._replay(bisect.bisect_right(self._times, from_s))

    def see(self, sighting: Sighting) -> bool:
        """Take in a sighting, which may be older than others; whether it is believed."""
        self._seen_until(sighting.at_s)
        base = self._base
        if base is None:
            return self._suspect(sighting)
        if sighting.at_s < base.at_s:
            return False
        index = bisect.bisect_right(self._times, sighting.at_s)
        prior = self._advanced(self._fused[index - 1][1] if index else base, sighting.at_s)
        if prior.surprise(sighting) > MOST_SIGMA:
            return self._suspect(sighting)
        with self._blended(max(self._published_s, sighting.at_s)):
            self._fused.insert(index, (sighting, prior.after(sighting)))
            self._replay(index + 1)
        self._accepted_s = max(self._accepted_s, sighting.at_s)
        return True

    def estimate(self, now_s: float) -> PoseEstimate:
        """The pose at a time, no earlier than the last one asked for; to be asked at a steady rate."""
        age_s = now_s - self._accepted_s
        if self._base is not None and age_s > LOST_AFTER_S:
            self.forget()
        if self._base is None:
            return PoseEstimate(
                at_s=now_s, sight="lost", pose=None, covariance=None, age_s=age_s, restarts=self.restarts
            )
        self._blend(now_s)
        believed = self._at(now_s)
        x_m, y_m, yaw_rad = (believed.mean[POSE] + self._offset).tolist()
        return PoseEstimate(
            at_s=now_s,
            sight="seeing" if age_s <= SEEING_S else "bridging",
            pose=PlanarPose(x_m, y_m, wrapped_rad(yaw_rad)),
            covariance=believed.covariance[POSE, POSE] + np.outer(self._offset, self._offset),
            age_s=max(0.0, age_s),
            restarts=self.restarts,
        )

    @property
    def _times(self) -> list[float]:
        return [sighting.at_s for sighting, _ in self._fused]

    def _at(self, at_s: float) -> PoseBelief:
        """Belief at a time, or after the newest sighting and motion where these are later."""
        return self._advanced(self._newest(), at_s)

    def _newest(self) -> PoseBelief:
        """Belief after the newest sighting and motion."""
        last = self._fused[-1][1] if self._fused else self._base
        assert last is not None  # noqa: S101  asked for only where something is believed
        until_s = self._motions[-1].to_s if self._motions else -math.inf
        return self._exactly(max(last.at_s, until_s)) or last

    def _advanced(self, belief: PoseBelief, to_s: float) -> PoseBelief:
        """A belief after the robot's motions until a time."""
        first = bisect.bisect_right(self._motions, belief.at_s, key=lambda own: own.to_s)
        for own in self._motions[first:]:
            if max(own.from_s, belief.at_s) >= to_s:
                break
            if own.from_s > belief.at_s + 1e-9:
                belief = self._coasted(belief, own.from_s)
            belief = belief.moved(own, to_s)
        return self._coasted(belief, to_s) if to_s > belief.at_s + 1e-9 else belief

    def _coasted(self, belief: PoseBelief, to_s: float) -> PoseBelief:
        """A belief at a time until which there was no odometry."""
        before = bisect.bisect_right(self._motions, belief.at_s + 1e-9, key=lambda own: own.to_s)
        told_s = self._motions[before - 1].to_s if before else -math.inf
        if belief.at_s >= told_s + ODOMETRY_GONE_S:
            return belief.coasted(to_s, COASTING_S)
        stopped_s = min(to_s, told_s + ODOMETRY_GONE_S)
        belief = belief.coasted(stopped_s, STOPPING_S)
        return belief if stopped_s == to_s else belief.coasted(to_s, COASTING_S)

    def _replay(self, index: int) -> None:
        """Take in the sightings from an index on once more, after something before them has changed."""
        belief = self._fused[index - 1][1] if index else self._base
        for later in range(index, len(self._fused)):
            sighting = self._fused[later][0]
            assert belief is not None  # noqa: S101  there are sightings, so there is a base
            belief = self._advanced(belief, sighting.at_s).after(sighting)
            self._fused[later] = (sighting, belief)

    def _suspect(self, sighting: Sighting) -> bool:
        """Keep a rejected sighting, and restart if enough others agree with it."""
        recent = [one for one in self._suspects if one.at_s >= self._newest_s - SUSPECT_S]
        self._suspects = sorted([*recent, sighting], key=lambda one: one.at_s)
        agreeing = [one for one in self._suspects if self._agree(one, sighting)]
        span_s = agreeing[-1].at_s - agreeing[0].at_s
        if len(agreeing) < LEAST_AGREEING or 2 * len(agreeing) <= len(self._suspects):
            return False
        if self._base is not None:
            if span_s < AGREEING_S or agreeing[0].at_s <= self._accepted_s:
                return False
            self.restarts += 1
        self._begin(agreeing)
        return True

    def _agree(self, one: Sighting, other: Sighting) -> bool:
        """Whether the robot's own motion can explain the second sighting after the first."""
        early, late = sorted((one, other), key=lambda each: each.at_s)
        start = PoseBelief.of(early, self._slip_of)
        return self._advanced(start, late.at_s).surprise(late) <= AGREE_SIGMA

    def _begin(self, sightings: Sequence[Sighting]) -> None:
        """Believe in sightings that agree, and in nothing before them."""
        belief = PoseBelief.of(sightings[0], self._slip())
        self._base, self._fused, self._suspects = belief, [], []
        for sighting in sightings[1:]:
            belief = self._advanced(belief, sighting.at_s).after(sighting)
            self._fused.append((sighting, belief))
        self._accepted_s = sightings[-1].at_s
        self._published_s, self._offset = -math.inf, np.zeros(3)

    def _slip(self) -> PoseBelief | None:
        return self._newest() if self._base is not None else self._slip_of

    def forget(self) -> None:
        """Believe in no pose any more; the slip stays."""
        self._slip_of = self._slip()
        self._base, self._fused = None, []

    def _seen_until(self, at_s: float) -> None:
        """Note how far time is, and drop what will not be played again."""
        self._newest_s = max(self._newest_s, at_s)
        oldest_s = self._newest_s - HISTORY_S
        while self._fused and self._fused[0][0].at_s < oldest_s:
            self._base = self._fused.pop(0)[1]
        if self._base is not None and self._base.at_s < oldest_s - HISTORY_S / 2:
            self._base = self._advanced(self._base, oldest_s)
        kept_s = oldest_s if self._base is None else min(oldest_s, self._base.at_s)
        while len(self._motions) > 1 and self._motions[0].to_s < kept_s:
            self._motions.pop(0)

    @contextmanager
    def _blended(self, at_s: float) -> Iterator[None]:
        """Keep the published pose across a correction in this block; the difference decays smoothly."""
        if self._base is None or self._published_s == -math.inf:
            yield
            return
        before = self._exactly(at_s)
        yield
        after = self._exactly(at_s)
        if before is not None and after is not None:
            self._offset = self._offset + before.mean[POSE] - after.mean[POSE]
            self._offset[2] = wrapped_rad(self._offset[2])

    def _exactly(self, at_s: float) -> PoseBelief | None:
        """Belief at a time from everything up to it; None before the first sighting.

        Each motion asks for it. The belief after the newest motion is kept, because replaying all motions
        since the last sighting takes too long.
        """
        index = bisect.bisect_right(self._times, at_s)
        origin = self._fused[index - 1][1] if index else self._base
        if origin is None or origin.at_s > at_s:
            return None
        belief = origin
        if self._mark is not None and self._mark[0] is origin and self._mark[1].at_s <= at_s:
            belief = self._mark[1]
        ended = bisect.bisect_right(self._motions, at_s, key=lambda own: own.to_s)
        if ended and self._motions[ended - 1].to_s > belief.at_s:
            belief = self._advanced(belief, self._motions[ended - 1].to_s)
            self._mark = (origin, belief)
        return self._advanced(belief, at_s)

    def _blend(self, now_s: float) -> None:
        """Let the remaining correction decay until a time."""
        took_s = max(0.0, now_s - self._published_s)
        self._published_s = now_s
        if took_s == 0 or math.isinf(took_s):
            return
        most = np.minimum(MOST_BLENDED * took_s, MOST_BLENDED_STEP)
        less = (1 - math.exp(-took_s / BLENDING_S)) * self._offset
        share = float(np.min(most / np.maximum(np.abs(less), most)))
        self._offset = self._offset - share * less
