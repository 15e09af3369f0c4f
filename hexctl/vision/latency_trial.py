"""A camera's latency, measured: a standing robot twists its body once while the camera watches its tag."""

import threading
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Self

import numpy as np

from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.control.body_wiggle import AMPLITUDE_RAD, DURATION_S, BodyWiggle
from hexctl.control.controllers import Controller, Stand
from hexctl.control.guard import Guard
from hexctl.control.loop import run_controller
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.ik.leg_odometry import leg_motions
from hexctl.robot.model import Robot
from hexctl.types import FloatArray
from hexctl.vision.camera_options import CameraOptions
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import TagFinder
from hexctl.vision.estimation.latency import MOST_S, Latency, measure_latency
from hexctl.vision.observer import Observer
from hexctl.vision.place import USUAL_LATENCY_S, Place, load_place, save_place
from hexctl.vision.place_learning import seen_place
from hexctl.vision.robot_link import LegState, RobotLink, robot_link
from hexctl.vision.video.videos import VideoSource
from hexctl.waiting import StopRequested, never
from hexctl.wire.links import Link

#: How long the robot takes to its stance, and how long it rests there before the twist.
STANDING_S, RESTING_S = 1.0, 0.5

#: How long the tag is looked for before anything moves, and the share of pictures in which it must be seen.
LOOKING_S, LEAST_SEEN = 1.5, 0.5

#: How long the watch may wait for its last picture when it ends.
READ_S = 0.1


@dataclass(frozen=True, slots=True)
class LatencyTrial:
    """The result of a trial.

    Attributes:
        latency: latency of the camera.
        stored_s: value in the place file.
        pictures: number of pictures during the trial.
        seen: number of pictures with the robot's tag.
    """

    latency: Latency
    stored_s: float
    pictures: int
    seen: int


@dataclass(frozen=True, slots=True, kw_only=True)
class TwistAhead:
    """What a robot is about to do.

    Attributes:
        robot: its name.
        amplitude_rad: how far its body turns to each side, its feet in place.
        duration_s: how long it takes, with standing up.
    """

    robot: str
    amplitude_rad: float
    duration_s: float


@dataclass(frozen=True, kw_only=True)
class CameraLatency(CameraOptions):
    """A measurement of how late the pictures of a camera come; the robot stands and twists its body once.

        CameraLatency(camera="0", connect="tcp/127.0.0.1:7447").run(stop_requested)

    The place has been learned before; `latency_s` is stored in its file. A video file is refused.
    """

    def run(
        self,
        stop_requested: StopRequested = never,
        *,
        on_moving: Callable[[TwistAhead], None] = lambda _: None,
        on_event: Callable[[str], None] = lambda _: None,
    ) -> LatencyTrial | None:
        """Measure the latency and store it in the place file; None after a requested stop.

        Args:
            stop_requested: called at each tick; if True, the robot returns to its stance within 0.5 s.
            on_moving: called before the robot moves.
            on_event: called with a line when the camera is lost or found again.

        Raises InputError for invalid files, an invisible tag and too little motion, and then stores nothing;
        RobotFaultError and EStopError if the robot or the camera fails.
        """
        path = Path(self.place)
        if not path.exists():
            raise InputError(
                f"{argument('place')}: {self.place} is not there; allowed: a place that hexctl see --camera "
                "has learned"
            )
        link, known = self.load_link(), load_place(path)
        with ExitStack() as opened:
            video = opened.enter_context(self.open_video(on_event))
            if not video.live:
                raise InputError(f"{argument('camera')}: got a file; allowed: a camera or a stream")
            linked = opened.enter_context(robot_link(link, self.robot))
            finder = TagFinder()
            place = seen_place(known, video, finder, stop_requested)
            if place is None:
                return None
            watch = opened.enter_context(_Watch(video, linked, place, finder))
            if not _waited(stop_requested):
                return None
            _check_seen(watch, place, linked.robot)
            duration_s = STANDING_S + 2 * RESTING_S + DURATION_S + MOST_S
            on_moving(TwistAhead(robot=linked.robot.name, amplitude_rad=AMPLITUDE_RAD, duration_s=duration_s))
            if not _twisted(linked.robot, link, stop_requested):
                return None
        watch.check()
        latency = watch.measured(linked.robot)
        stored_s = round(max(0.0, latency.latency_s), 4)
        save_place(replace(known, latency_s=stored_s), path)
        return LatencyTrial(latency, stored_s, watch.pictures, len(watch.seen))


class _Watch:
    """A thread that looks at pictures and listens to the legs, from `with` to its end."""

    def __init__(self, video: VideoSource, linked: RobotLink, place: Place, finder: TagFinder) -> None:
        self._video, self._linked = video, linked
        seen = linked.robot, place.viewpoint, place.floor_corners, place.tag
        self._observer = Observer(*seen, finder=finder, latency_s=USUAL_LATENCY_S)
        self.pictures = 0
        self.seen: list[tuple[float, PlanarPose]] = []
        self._states: list[LegState] = []
        self._moved = False
        self._error: Exception | None = None
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._run, name="watch", daemon=True)

    def __enter__(self) -> Self:
        self._thread.start()
        return self

    def __exit__(self, *error: object) -> None:
        self._end.set()
        self._thread.join()

    def check(self) -> None:
        """Raise the error of the thread, and InputError if the camera was moved meanwhile."""
        if self._error is not None:
            raise self._error
        if self._moved:
            raise InputError(f"{argument('camera')}: it was moved meanwhile; allowed: one that stands still")

    def measured(self, robot: Robot) -> Latency:
        """Latency from all sightings and states; raises InputError if the motion does not reveal it."""
        times_s = np.array([state.at_s for state in self._states])
        arrivals_s = np.array([at_s for at_s, _ in self.seen])
        if len(times_s) < 2 or not len(arrivals_s):
            raise InputError(
                "latency: got no states of the robot; allowed: a robot that reports its joint angles"
            )
        seen = np.array([(pose.x_m, pose.y_m, pose.yaw_rad) for _, pose in self.seen])
        return measure_latency(times_s, course(robot, self._states), arrivals_s, seen)

    def _run(self) -> None:
        try:
            while not self._end.is_set():
                self._step()
        except Exception as error:  # noqa: BLE001  raised again on the caller's thread
            self._error = error

    def _step(self) -> None:
        frame = self._video.read(READ_S)
        for state in self._linked.states():
            self._observer.listen(state)
            if not self._states or state.at_s > self._states[-1].at_s:
                self._states.append(state)
        if frame is None:
            return
        observation = self._observer.look(frame.gray(), frame.at_s)
        self._observer.estimate(time.monotonic())
        self.pictures += 1
        self._moved |= observation.change is not None and observation.change.tag_id is None
        if observation.robot is not None:
            self.seen.append((frame.at_s, observation.robot.pose_floor))


def course(robot: Robot, states: Sequence[LegState]) -> FloatArray:
    """Poses of a body by its joints, x and y in m and unwrapped yaw in rad, from (0, 0, 0) on, (T, 3).

    The states are two or more, and ascend.
    """
    times_s = np.array([state.at_s for state in states])
    motions = leg_motions(robot, times_s, np.array([state.joint_positions_rad for state in states])).motions
    yaw_rad = np.concatenate([[0.0], np.cumsum(motions[:, 2])])
    steps = (motions[:, 0] + 1j * motions[:, 1]) * np.exp(1j * yaw_rad[:-1])
    middle = np.concatenate([[0.0], np.cumsum(steps)])
    return np.column_stack([middle.real, middle.imag, yaw_rad])


def _waited(stop_requested: Callable[[], bool]) -> bool:
    """Wait while the camera watches a resting robot; False if a stop was requested."""
    until_s = time.monotonic() + LOOKING_S
    while time.monotonic() < until_s and not stop_requested():
        time.sleep(0.02)
    return not stop_requested()


def _check_seen(watch: _Watch, place: Place, robot: Robot) -> None:
    """Raise RobotFaultError for a camera without pictures, and InputError where the tag is not in them."""
    watch.check()
    if not watch.pictures:
        raise RobotFaultError(
            f"the camera sent no picture within {LOOKING_S:g} s; is this computer too busy?"
        )
    if len(watch.seen) < LEAST_SEEN * watch.pictures:
        raise InputError(
            f"{argument('camera')}: tag {place.robot_tag.id} on {robot.name} is seen in "
            f"{len(watch.seen)} of {watch.pictures} pictures; allowed: half of them or more"
        )


def _twisted(robot: Robot, link: Link, stop_requested: Callable[[], bool]) -> bool:
    """Take the lease, stand, twist, rest and return the lease; False if a stop was requested.

    Raises ReachError or LimitError if the robot cannot twist so far, and the errors of `run_controller`.
    """
    with Guard(ZenohServos(robot, link=link)) as servos:
        period_s = servos.clock.period_s

        def steps(duration_s: float) -> int:
            return round(duration_s / period_s)

        stance_rad = robot.stance_angles_rad
        phases: tuple[Controller, ...] = (
            Stand(robot, servos.accepted_rad(), steps(STANDING_S), steps(RESTING_S)),
            BodyWiggle(robot, period_s=period_s),
            # The last pictures of the twist come that late.
            Stand(robot, stance_rad, 1, steps(RESTING_S + MOST_S)),
        )
        for phase in phases:
            run_controller(servos, phase, until=lambda _step, _state: stop_requested())
            if stop_requested():
                run_controller(servos, Stand(robot, servos.accepted_rad(), steps(RESTING_S)))
                return False
    return True
