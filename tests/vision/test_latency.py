"""The latency of a camera, by the robot's own motion."""

import time
from contextlib import nullcontext
from functools import cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.body_wiggle import BodyWiggle, wiggle_targets_rad, wiggle_yaw_rad
from hexctl.control.controllers import Controller, Stand
from hexctl.control.guard import Guard
from hexctl.control.loop import run_controller
from hexctl.errors import InputError
from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.rotations import yaw_rad
from hexctl.types import FloatArray, JointTargets, RobotState
from hexctl.vision import latency_trial
from hexctl.vision.estimation.latency import measure_latency
from hexctl.vision.latency_trial import CameraLatency
from hexctl.vision.latency_trial import course as twist_course
from hexctl.vision.robot_link import LegState
from hexctl.vision.video.videos import Frame, VideoSource
from hexctl.waiting import wait_for
from tests.driven import course
from tests.robots import shipped
from tests.vision.test_place import saved
from tests.vision.test_pose_filter import SIGMA

#: A twist of the body, by its joints.
TIMES_S = 0.02 * np.arange(300, dtype=float)
TWIST = np.column_stack([np.zeros((300, 2)), wiggle_yaw_rad(TIMES_S - 1.0)])


def pictures(
    times_s: FloatArray, true: FloatArray, *, late_s: float = 0.08, fps: float = 30.0, seed: int = 0
) -> tuple[FloatArray, FloatArray]:
    """Arrivals of pictures, and noisy poses in them."""
    rng = np.random.default_rng(seed)
    taken_s = np.arange(times_s[0] + 0.01, times_s[-1], 1 / fps)
    seen = np.column_stack([np.interp(taken_s, times_s, column) for column in true.T])
    return taken_s + late_s, seen + rng.normal(size=seen.shape) * SIGMA


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


@cache
def simulated(robot: str, world: str) -> tuple[FloatArray, ...]:
    """A simulated robot that stands, twists and stands.

    Returns when joints were measured and the poses that they tell, and times and poses of the truth.
    """
    model, servos = shipped(robot), SimServos(robot, world=world)
    rows: list[tuple[float, float, FloatArray, FloatArray, float]] = []

    class Watch:
        def record(self, tick: object, state: RobotState, wanted_rad: FloatArray, sent: JointTargets) -> None:
            assert servos.true_pose is not None
            position, quaternion = servos.true_pose
            joints_rad, yaw = state.joint_positions_rad.copy(), float(yaw_rad(quaternion))
            rows.append((state.stamp_s, servos.clock.now_s, joints_rad, position, yaw))

        def took(self, work_s: float) -> None:
            pass

    with Guard(servos) as guard:
        stance = model.stance_angles_rad
        twist = BodyWiggle(model, period_s=0.02)
        controllers: tuple[Controller, ...] = (
            Stand(model, stance, 1, 50),
            twist,
            Stand(model, stance, 1, 40),
        )
        for controller in controllers:
            run_controller(guard, controller, [Watch()])
    measured_s, times_s = np.array([row[:2] for row in rows]).T
    own = course(leg_motions(model, measured_s, np.array([row[2] for row in rows])).motions)
    return measured_s, own, times_s, np.array([[*row[3][:2], row[4]] for row in rows])


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "world", "fps"), [("ant", "flat", 30.0), ("pexod", "real:3", 15.0)])
def test_a_twist_tells_the_latency_within_15_ms(robot: str, world: str, fps: float) -> None:
    measured_s, own, times_s, true = simulated(robot, world)
    found = [
        measure_latency(measured_s, own, *pictures(times_s, true, fps=fps, seed=seed)) for seed in range(5)
    ]
    assert max(abs(one.latency_s - 0.08) for one in found) < 0.015
    assert max(one.sigma_s for one in found) < 0.01


class Empty(VideoSource):
    """A camera that sees nothing but grey."""

    live, taken = True, 0

    def read(self, timeout_s: float = 1.0) -> Frame:
        """A picture."""
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
