"""The filter of poses, late, lost, wild and carried sightings, and the latency of a camera."""

import math
import time
from contextlib import nullcontext
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.body_wiggle import wiggle_targets_rad, wiggle_yaw_rad
from hexctl.errors import InputError
from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import FloatArray, JointTargets
from hexctl.vision import latency_trial
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.estimation.latency import measure_latency
from hexctl.vision.estimation.pose_belief import STATES, OwnMotion, PoseBelief, Sighting
from hexctl.vision.estimation.pose_filter import HISTORY_S, PoseEstimate, PoseFilter
from hexctl.vision.latency_trial import CameraLatency
from hexctl.vision.latency_trial import course as twist_course
from hexctl.vision.robot_link import LegState
from hexctl.vision.video.videos import Frame, VideoSource
from hexctl.waiting import wait_for
from tests.driven import Command, Driven, course, driven
from tests.robots import shipped
from tests.vision.test_place import saved

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


# The latency, by the robot's own motion.

#: A twist of the body, by its joints.
TIMES_S = 0.02 * np.arange(300, dtype=float)
TWIST = np.column_stack([np.zeros((300, 2)), wiggle_yaw_rad(TIMES_S - 1.0)])


def pictures(
    times_s: FloatArray, true: FloatArray, *, fps: float = 30.0, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Arrivals of pictures, and noisy poses in them."""
    rng = np.random.default_rng(seed)
    taken_s = np.arange(times_s[0] + 0.01, times_s[-1], 1 / fps)
    seen = np.column_stack([np.interp(taken_s, times_s, column) for column in true.T])
    return taken_s + LATE_S, seen + rng.normal(size=seen.shape) * SIGMA


def test_wild_sightings_do_not_count() -> None:
    arrivals_s, seen = pictures(TIMES_S, TWIST)
    seen[::9] += [0.4, 0.0, 1.0]
    assert abs(measure_latency(TIMES_S, TWIST, arrivals_s, seen).latency_s - 0.08) < 0.015


def test_a_body_that_turns_less_than_its_joints_say_tells_it_all_the_same() -> None:
    found = measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, TWIST * 0.7))
    assert abs(found.latency_s - 0.08) < 0.015
    assert found.factor == pytest.approx(0.7, abs=0.05)


@pytest.mark.parametrize("steady", [np.zeros((300, 3)), np.outer(TIMES_S, [0.1, 0.0, 0.0])])
def test_standing_and_even_motion_tell_nothing(steady: FloatArray) -> None:
    with pytest.raises(InputError, match="too little motion"):
        measure_latency(TIMES_S, steady, *pictures(TIMES_S, steady))


def test_a_tag_that_moves_otherwise_and_too_few_sightings_are_refused() -> None:
    with pytest.raises(InputError, match="latency"):
        measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, TWIST * 3))
    with pytest.raises(InputError, match="latency"):
        measure_latency(TIMES_S, TWIST, *pictures(TIMES_S, np.zeros((300, 3))))
    arrivals_s, seen = pictures(TIMES_S, TWIST)
    with pytest.raises(InputError, match="sightings"):
        measure_latency(TIMES_S, TWIST, arrivals_s[30:45], seen[30:45])


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "world", "fps"), [("ant", "flat", 30.0), ("pexod", "real:3", 15.0)])
def test_a_twist_reveals_the_latency_within_15_ms(robot: str, world: str, fps: float) -> None:
    """Joints are stamped when they were measured, poses when they are true."""
    model, rows = shipped(robot), []
    with SimServos(model, world=world) as servos:
        for targets_rad in wiggle_targets_rad(model, TIMES_S - 1.0):
            servos.clock.tick()
            state = servos.read()
            servos.write(JointTargets(targets_rad, servos.clock.now_s))
            assert servos.true_pose is not None
            position, quaternion = servos.true_pose
            pose = [*position[:2].tolist(), float(yaw_rad(quaternion))]
            rows.append((state.stamp_s, servos.clock.now_s, state.joint_positions_rad.copy(), pose))
    measured_s, times_s, joints_rad, true = (np.array(column) for column in zip(*rows, strict=True))
    own = course(leg_motions(model, measured_s, joints_rad).motions)
    found = [
        measure_latency(measured_s, own, *pictures(times_s, true, fps=fps, seed=seed)) for seed in range(5)
    ]
    assert max(abs(one.latency_s - 0.08) for one in found) < 0.015
    assert max(one.sigma_s for one in found) < 0.01


class Empty(VideoSource):
    """A camera that sees nothing but grey."""

    live, taken = True, 0

    def read(self, timeout_s: float = 1.0) -> Frame:
        """The next picture."""
        self.taken += 1
        return Frame(np.full((720, 1280, 3), 90, dtype=np.uint8), time.monotonic())

    def close(self) -> None:
        """Nothing is open."""


def test_a_robot_that_is_not_seen_does_not_move(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    linked = SimpleNamespace(robot=shipped(), states=list)
    video = Empty("empty")
    looked = lambda _: wait_for(lambda: video.taken > 3, 30, "no picture was taken")  # noqa: E731
    monkeypatch.setattr(latency_trial, "_waited", looked)
    monkeypatch.setattr(latency_trial, "robot_link", lambda *_: nullcontext(linked))
    monkeypatch.setattr(latency_trial, "seen_place", lambda known, *_: known)
    monkeypatch.setattr(CameraLatency, "open_video", lambda *_: video)
    place, moved = saved(tmp_path), list[object]()
    before = place.read_bytes()
    with pytest.raises(InputError, match="camera"):
        CameraLatency(camera="0", place=place).run(lambda: False, on_moving=moved.append)
    assert moved == []
    assert place.read_bytes() == before


def test_a_place_that_was_never_learned_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="place"):
        CameraLatency(camera="0", place=tmp_path / "place.yaml").run(lambda: False)


def test_the_course_of_a_twist_is_its_yaw() -> None:
    robot, times_s = shipped(), 0.02 * np.arange(220, dtype=float)
    joints = wiggle_targets_rad(robot, times_s)
    states = [LegState(float(at_s), row, None, None) for at_s, row in zip(times_s, joints, strict=True)]
    walked = twist_course(robot, states)
    assert walked[0].tolist() == [0, 0, 0]
    assert np.abs(walked[:, 2] - wiggle_yaw_rad(times_s)).max() < 0.005
    assert np.hypot(*walked[:, :2].T).max() < 0.005
