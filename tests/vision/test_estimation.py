"""The filter of poses: late, lost, wild and carried sightings."""

import math
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np
import pytest

from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import FloatArray
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.pose_belief import STATES, OwnMotion, PoseBelief, Sighting
from hexctl.vision.estimation.pose_filter import HISTORY_S, PoseEstimate, PoseFilter
from tests.driven import Command, Driven, driven
from tests.robots import shipped

MEAN = np.array([0.3, -0.2, 0.8, 0.1, -0.05, 0.1, 0.2, 0.1, -0.03, 0.4])


def belief(mean: np.ndarray = MEAN) -> PoseBelief:
    return PoseBelief(0.0, mean.copy(), np.diag(np.arange(1.0, STATES + 1)) * 1e-8)


def stepped(start: PoseBelief, how: str) -> PoseBelief:
    if how == "coasted":
        return start.coasted(0.3, 0.5)
    own = OwnMotion(0.0, 0.2, np.array([0.02, -0.01, 0.1]), yaw_measured=how == "measured")
    return start.moved(own, 0.2)


@pytest.mark.parametrize("how", ["moved", "measured", "coasted"])
def test_covariances_follow_the_derivatives_of_the_step(how: str) -> None:
    start, tiny = belief(), 1e-6
    columns = [
        stepped(replace(start, mean=MEAN + way), how).mean
        - stepped(replace(start, mean=MEAN - way), how).mean
        for way in tiny * np.eye(STATES)
    ]
    jacobian = np.column_stack(columns) / (2 * tiny)
    if how != "coasted":
        jacobian[7:] = 0.0  # the velocity is only shown by odometry, and not followed
    noise = stepped(replace(start, covariance=np.zeros((STATES, STATES))), how).covariance
    expected = jacobian @ start.covariance @ jacobian.T + noise
    assert stepped(start, how).covariance == pytest.approx(expected, rel=1e-4, abs=1e-14)


def test_slip_is_learned() -> None:
    spread = np.diag([1e-6, 1e-6, 1e-6])
    at_first = PoseBelief.of(Sighting(0.0, PlanarPose(0, 0, 0), spread))
    now = at_first
    for tick in range(200):
        own = OwnMotion(0.02 * tick, 0.02 * (tick + 1), np.array([0.004, 0.0, 0.0]))
        now = now.moved(own, own.to_s)
        now = now.after(Sighting(own.to_s, PlanarPose(0.9 * 0.004 * (tick + 1), 0, 0), spread))
    assert now.mean[3] == pytest.approx(-0.1, abs=0.03)
    assert now.covariance[3, 3] < at_first.covariance[3, 3] / 4
    assert now.surprise(Sighting(4.0, PlanarPose(0.72, 0, 0), spread)) < 2
    assert now.surprise(Sighting(4.0, PlanarPose(0.82, 0, 0), spread)) > 5


#: From a picture to its sighting, share of sightings that never come, and from a motion to its report.
LATE_S, DROPPED, DELAY_S = 0.08, 0.1, 0.03

#: Standard deviation of sightings in m, m and rad.
SIGMA = np.array([0.01, 0.01, math.radians(0.5)])


@dataclass(frozen=True, kw_only=True)
class Eye:
    """How a camera sees, `LATE_S` late and without a tenth of the sightings.

    Attributes:
        fps: pictures per second.
        wild: share of the sightings that is anywhere within a metre.
        gap_s: from when to when there are no sightings.
        carried: at a time in s, the robot is put elsewhere in the floor's frame: x, y in m, yaw in rad.
    """

    fps: float = 30.0
    wild: float = 0.0
    gap_s: tuple[float, float] = (0.0, 0.0)
    carried: tuple[float, float, float, float] | None = None


@dataclass(frozen=True, eq=False)
class Followed:
    """What a filter said at each picture, and true poses then, (N, 3)."""

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
        rows = [
            (math.nan,) * 3 if pose is None else (pose.x_m, pose.y_m, pose.yaw_rad)
            for pose in (one.pose for one in self.estimates)
        ]
        return np.array(rows)

    def errors(self, from_s: float = 1.0) -> tuple[float, float]:
        """RMS of position in m and yaw in deg."""
        off = (self.poses - self.true)[self.times_s >= from_s]
        yaw_deg = np.degrees(np.angle(np.exp(1j * off[:, 2])))
        position_m2 = np.square(off[:, :2]).sum(axis=1)
        return float(np.sqrt(np.nanmean(position_m2))), float(np.sqrt(np.nanmean(yaw_deg**2)))

    def greatest_jump_m(self) -> float:
        """How much farther than the robot the published pose went between two pictures; not at restarts."""
        whole = np.array([before.restarts == after.restarts for before, after in pairwise(self.estimates)])
        steps = np.diff(self.poses[:, :2], axis=0) - np.diff(self.true[:, :2], axis=0)
        return float(np.nanmax(np.hypot(*steps.T)[whole]))


def followed(walk: Driven, eye: Eye) -> Followed:
    """A filter that follows driven `ant`, whose own motion comes `DELAY_S` late."""
    rng = np.random.default_rng(0)
    motions = leg_motions(shipped(), walk.times_s, walk.joints_rad).motions
    true = walk.poses.copy()
    if eye.carried is not None:
        true[walk.times_s >= eye.carried[0]] += eye.carried[1:]
    poses = PoseFilter()
    estimates, truths, told = [], [], 0
    waiting: list[Sighting] = []
    for frame in range(int(walk.times_s[-1] * eye.fps)):
        now_s = frame / eye.fps
        while told < len(motions) and walk.times_s[told + 1] <= now_s - DELAY_S:
            poses.move(walk.times_s[told], walk.times_s[told + 1], motions[told])
            told += 1
        waiting += sighted(at(walk.times_s, true, now_s), now_s, eye, rng)
        for one in [one for one in waiting if one.at_s + LATE_S <= now_s + 1e-9]:
            waiting.remove(one)
            poses.see(one)
        estimates.append(poses.estimate(now_s))
        truths.append(at(walk.times_s, true, now_s))
    return Followed(estimates, np.array(truths), poses)


def at(times_s: FloatArray, rows: FloatArray, at_s: float) -> FloatArray:
    """Rows (T, 3) at a time between theirs."""
    return np.array([np.interp(at_s, times_s, column) for column in rows.T])


def sighted(true: FloatArray, at_s: float, eye: Eye, rng: np.random.Generator) -> list[Sighting]:
    """The sighting of a pose, if there is one."""
    lost, wild = rng.random(2)
    noise, anywhere = rng.normal(size=3) * SIGMA, rng.uniform(-1, 1, 3)
    if lost < DROPPED or eye.gap_s[0] <= at_s < eye.gap_s[1]:
        return []
    x_m, y_m, yaw_rad = true + (anywhere if wild < eye.wild else noise)
    return [Sighting(at_s, PlanarPose(x_m, y_m, wrapped_rad(yaw_rad)), np.diag(SIGMA**2))]


AHEAD: tuple[Command, ...] = ((1, 0, 0, 0), (7, 1, 0, 0))
STOPPING: tuple[Command, ...] = ((1, 0, 0, 0), (5, 1, 0, 0), (3, 0, 0, 0))


def seen_at(at_s: float, x_m: float = 0.0, y_m: float = 0.0, yaw_rad: float = 0.0) -> Sighting:
    return Sighting(at_s, PlanarPose(x_m, y_m, yaw_rad), np.diag(SIGMA**2))


def fixed(until_s: float = 1.0) -> PoseFilter:
    """A filter that has seen a robot stand at the origin."""
    poses = PoseFilter()
    for frame in range(round(until_s * 30) + 1):
        if frame:
            poses.move((frame - 1) / 30, frame / 30, np.zeros(3))
        poses.see(seen_at(frame / 30))
        poses.estimate(frame / 30)
    return poses


@pytest.mark.slow
def test_it_follows_a_walk_to_millimetres() -> None:
    course = followed(driven("ant", AHEAD), Eye(fps=15.0))
    assert course.errors()[0] < 0.008
    assert course.errors()[1] < 0.5
    assert course.greatest_jump_m() < 0.02
    assert course.estimates[-1].sight == "seeing"


@pytest.mark.slow
def test_wild_sightings_are_not_believed() -> None:
    course = followed(driven("ant", AHEAD), Eye(wild=0.1))
    assert course.errors()[0] < 0.01
    assert course.filter.restarts == 0


@pytest.mark.slow
def test_two_seconds_without_sight_are_bridged() -> None:
    course = followed(driven("ant", STOPPING, world="real:3"), Eye(gap_s=(5.0, 7.0)))
    off_m = (course.poses - course.true)[np.searchsorted(course.times_s, 7.0), :2]
    assert np.hypot(*off_m) < 0.025
    assert course.greatest_jump_m() < 0.02
    bridging = course.estimates[int(6.9 * 30)]
    before = course.estimates[int(4.9 * 30)]
    assert (before.sight, bridging.sight, course.filter.restarts) == ("seeing", "bridging", 0)
    assert bridging.covariance is not None
    assert before.covariance is not None
    assert bridging.covariance[0, 0] > before.covariance[0, 0]


@pytest.mark.slow
def test_a_robot_that_is_carried_is_told_once() -> None:
    course = followed(driven("ant", STOPPING), Eye(carried=(7.0, 0.3, 0.0, 0.5), wild=0.05))
    assert course.filter.restarts == 1
    assert course.errors(7.6)[0] < 0.01
    since_s = course.times_s[[one.restarts for one in course.estimates].index(1)] - 7.0
    assert 0.3 <= since_s < 0.55


def test_a_few_sightings_elsewhere_do_not_carry_it_away() -> None:
    poses = fixed()
    for frame in range(6):
        assert not poses.see(seen_at(1.1 + frame / 30, 0.5))
    assert poses.see(seen_at(1.35))
    for frame in range(6):
        assert not poses.see(seen_at(1.4 + frame / 30, 0.5))
    assert poses.restarts == 0


def test_a_first_pose_needs_sightings_that_agree() -> None:
    poses = PoseFilter()
    for at_s, x_m in ((0.0, 0.0), (0.03, 0.7), (0.06, -0.4), (0.09, 0.001)):
        assert not poses.see(seen_at(at_s, x_m))
        assert poses.estimate(at_s).sight == "lost"
    assert not poses.see(seen_at(0.12, 0.7))
    assert not poses.see(seen_at(0.15, 0.001))
    assert poses.see(seen_at(0.18, 0.0))
    found = poses.estimate(0.2)
    assert found.pose is not None
    assert abs(found.pose.x_m) < 0.01
    assert found.restarts == 0


def test_it_is_lost_after_a_while_and_found_again_by_agreement() -> None:
    poses = fixed()
    assert poses.estimate(3.9).sight == "bridging"
    lost = poses.estimate(4.1)
    assert (lost.sight, lost.pose, lost.covariance) == ("lost", None, None)
    assert not poses.see(seen_at(4.2, 0.5))
    assert not poses.see(seen_at(4.23, 0.5))
    assert poses.see(seen_at(4.26, 0.5))
    assert poses.estimate(4.3).pose is not None


def test_the_order_in_which_sightings_come_does_not_matter() -> None:
    walk = [(0.02 * tick, 0.02 * (tick + 1), np.array([0.002, 0.0, 0.001])) for tick in range(100)]
    sightings = [seen_at(0.02 * tick + 0.007, 0.002 * tick) for tick in range(0, 100, 3)]
    results = []
    for late in (0, 4):
        poses = PoseFilter()
        for three in sightings[:3]:
            poses.see(three)
        left = sightings[3:]
        for from_s, to_s, motion in walk:
            poses.move(from_s, to_s, motion)
            while left and left[min(late, len(left) - 1)].at_s <= to_s:
                poses.see(left.pop(min(late, len(left) - 1)))
        assert not left
        results.append(poses.estimate(2.0))
    assert results[0].pose is not None
    assert results[1].pose is not None
    assert (results[1].pose.x_m, results[1].pose.yaw_rad) == pytest.approx(
        (results[0].pose.x_m, results[0].pose.yaw_rad), abs=2e-4
    )


def test_too_old_a_sighting_is_refused() -> None:
    poses = fixed(4.0)
    assert poses.see(seen_at(4.0 - 0.8 * HISTORY_S))
    assert not poses.see(seen_at(2.0))


def test_what_is_published_glides_to_a_correction() -> None:
    poses = fixed()
    poses.move(1.0, 1.2, np.array([0.1, 0.0, 0.0]))
    for tick in range(15):
        poses.move(1.2 + 0.02 * tick, 1.22 + 0.02 * tick, np.zeros(3))
    shown = [poses.estimate(1.5)]
    for frame in range(30):
        poses.see(seen_at(1.5 + frame / 30, 0.14))
        shown.append(poses.estimate(1.5 + (frame + 1) / 30))
    along = [one.pose.x_m for one in shown if one.pose is not None]
    assert along[0] == pytest.approx(0.1, abs=0.01)
    assert along[-1] == pytest.approx(0.14, abs=0.01)
    assert np.abs(np.diff(along)).max() < 0.012


def test_motions_that_come_in_bursts_make_no_leap() -> None:
    """On a busy computer ten steps of 3 mm come within a millisecond, and then none for 0.2 s."""
    pose_filter, x_m, last_s = PoseFilter(), 0.0, 0.0
    offs_m = []
    for burst in range(40):
        for step in range(10):
            at_s = 0.2 * (burst + 1) + 1e-4 * step
            pose_filter.move(max(last_s, at_s - 1e-4), at_s, np.array([0.003, 0.0, 0.0]))
            x_m, last_s = x_m + 0.003, at_s
        for picture in range(4):
            now_s = last_s + 0.05 * picture
            pose_filter.see(Sighting(now_s, PlanarPose(x_m, 0.0, 0.0), np.eye(3) * 1e-5))
            estimate = pose_filter.estimate(now_s + 0.04)
            if estimate.pose is not None and burst > 5:
                offs_m.append(abs(estimate.pose.x_m - x_m))
    assert max(offs_m) < 0.05
