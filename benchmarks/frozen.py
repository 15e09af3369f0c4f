"""Sensing that stands still at random moments of simulated walks, and whether the robot comes to rest.

`python -m benchmarks.frozen [TIMES] [KIND ...]` freezes each kind of sensing so many times, 20 unless given,
and prints the walks and rows. Where the position freezes, the robot walks within a fence of `FENCE_M`. A
camera draws and looks at its pictures; poses of a tracker come from outside, as to `hexctl serve`.
"""

import random
import sys
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from benchmarks.rows import Count, Row
from hexctl.adapt.arena import Geofence
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import EXPIRY_S, Guard
from hexctl.control.monitor.monitored_walk import watched_walk
from hexctl.control.monitor.recovery import make_recovery
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.gait.gait import make_gait
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import about_z, product
from hexctl.server.served_servos import ServedServos
from hexctl.simulators.camera.rendering import (
    FLOOR_TAGS,
    WEBCAM,
    RobotPosture,
    SceneRenderer,
    tag_on,
)
from hexctl.simulators.camera.usual_camera import LOOK_AT_M, NOISE, POSITION_M
from hexctl.types import JOINTS_PER_LEG, N_JOINTS, FloatArray, RobotState
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.observer import Observer
from hexctl.vision.robot_link import LegState
from hexctl.wire.pose import NO_COVARIANCE
from hexctl.wire.transit_delay import StampCheck

ROBOTS, GAITS = ("ant", "phantomx", "pexod"), ("tripod", "ripple", "wave")

FENCE_M = 0.5

#: Sensing that freezes: what a camera shows, a tracker sends, and a robot measures itself.
PICTURES = ("picture", "noisy picture")
NOISY = ("noisy tracker", "interrupted tracker")
POSES = ("tracker", *NOISY, "late tracker")
OWN = {
    "pose": ("base_position_world", "base_quaternion_world"),
    "imu": ("base_quaternion_world",),
    "joints": ("joint_positions_rad",),
    "joint": ("joint_positions_rad",),
    "contacts": ("foot_contacts",),
    "voltage": ("battery_v",),
}
KINDS = (*PICTURES, *POSES, *OWN)

#: Kinds that a fence depends on.
FENCED = (*PICTURES, *POSES, "pose")

#: When sensing freezes, in s of the simulation, whose walk begins after 1 s; and how long a walk is.
FREEZES_S, WALK_S = (1.0, 6.0), 30.0

#: Ticks between two pictures, and voltages at first, and at last, when the battery is low.
PICTURE_TICKS, VOLTAGES_V, LOW_V = 4, (12.0, 9.0), 10.0

#: An interrupted tracker sends for so long of each period.
SHOWN_S, INTERRUPTED_S = 0.2, 0.8

TRACKER_NOISE_M, TRACKER_NOISE_RAD = 0.001, 0.002

CAMERA = Camera.looking(WEBCAM.scaled(960, 540), np.array(POSITION_M), np.array(LOOK_AT_M))
FLOOR_CORNERS = {number: tag.corners for number, tag in FLOOR_TAGS.items()}


@dataclass(frozen=True, kw_only=True)
class Freeze:
    """What freezes, and when, in s; a late tracker is late by `late_s` from then on."""

    kind: str
    at_s: float
    joint: int
    late_s: float


class FrozenServos(ServedServos):
    """A simulated robot, one of whose senses freezes.

    Attributes:
        farthest_m: maximum true distance from the start.
    """

    def __init__(self, servos: SimServos, freeze: Freeze, seed: int) -> None:
        super().__init__(servos)
        self._sim, self._freeze = servos, freeze
        self._noise = np.random.default_rng(seed)
        self._stamps, self._came_s = StampCheck(), 0.0
        self._sent: list[tuple[float, FloatArray, FloatArray]] = []
        self._kept: RobotState | None = None
        self.farthest_m = 0.0

    def read(self) -> RobotState:
        """State of the servos as the frozen sense shows it."""
        now_s, (position, quaternion) = self.clock.now_s, self._sim.true_pose or self._missing()
        self.farthest_m = max(self.farthest_m, float(np.hypot(*position[:2])))
        if self._freeze.kind in POSES:
            self._track(now_s, position, quaternion)
        state = super().read()
        if self._freeze.kind not in OWN:
            return state
        low = now_s > sum(FREEZES_S) / 2
        voltage_v = VOLTAGES_V[low] + 0.02 * self._noise.standard_normal()
        if self._freeze.kind == "voltage":
            state = replace(state, battery_v=voltage_v, low_battery_v=LOW_V)
        return self._frozen(state) if now_s >= self._freeze.at_s else state

    def _frozen(self, state: RobotState) -> RobotState:
        self._kept = self._kept or state
        shown = {name: getattr(self._kept, name) for name in OWN[self._freeze.kind]}
        if self._freeze.kind == "joint":
            one = np.arange(N_JOINTS) == self._freeze.joint
            shown["joint_positions_rad"] = np.where(
                one, self._kept.joint_positions_rad, state.joint_positions_rad
            )
        return replace(state, **shown)

    def _track(self, now_s: float, position: FloatArray, quaternion: FloatArray) -> None:
        """Take what a tracker sends now, if it is not late."""
        position = position + TRACKER_NOISE_M * self._noise.standard_normal(3)
        self._sent.append((now_s, position, quaternion))
        freeze, frozen = self._freeze, now_s >= self._freeze.at_s
        until_s = now_s
        if frozen:
            until_s = now_s - freeze.late_s if freeze.kind == "late tracker" else freeze.at_s
        sent = [one for one in self._sent if one[0] <= until_s] or self._sent[:1]
        stamp_s, position, quaternion = sent[-1]
        if frozen and freeze.kind in NOISY:
            position = position + TRACKER_NOISE_M * self._noise.standard_normal(3)
            turn_rad = TRACKER_NOISE_RAD * float(self._noise.standard_normal())
            quaternion = product(about_z(turn_rad), quaternion)
        comes = not frozen or freeze.kind != "interrupted tracker" or now_s % INTERRUPTED_S < SHOWN_S
        if comes and self._stamps.admits(stamp_s if freeze.kind == "late tracker" else None, now_s):
            self.set_pose(position, quaternion, NO_COVARIANCE, self.clock.time.now())
            self._came_s = now_s
        elif now_s - self._came_s > EXPIRY_S:
            self.set_pose(None, None, NO_COVARIANCE, self.clock.time.now())

    def _missing(self) -> tuple[FloatArray, FloatArray]:
        return np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])


class WatchedServos(FrozenServos):
    """A simulated robot that a camera watches, whose pictures freeze; a noisy one is drawn with new noise."""

    def __init__(self, servos: SimServos, freeze: Freeze, seed: int, renderer: SceneRenderer) -> None:
        super().__init__(servos, freeze, seed)
        self._renderer, tag = renderer, tag_on(servos.robot)
        self._observer = Observer(servos.robot, CAMERA, FLOOR_CORNERS, tag, finder=TagFinder())
        self._posture: RobotPosture | None = None
        self._picture: Picture | None = None

    def read(self) -> RobotState:
        """State of the servos with the pose that the camera gives."""
        now_s = self.clock.now_s
        state = super().read()
        self._observer.listen(LegState(now_s, state.joint_positions_rad, None, None))
        if self.clock.index % PICTURE_TICKS == 0:
            self._observer.look(self._drawn(now_s, state), now_s)
        estimate = self._observer.estimate(now_s)
        if estimate.pose is None:
            self.set_pose(None, None, NO_COVARIANCE, self.clock.time.now())
        else:
            pose = estimate.pose
            position = np.array([pose.x_m, pose.y_m, self._observer.height_m])
            self.set_pose(position, about_z(pose.yaw_rad), NO_COVARIANCE, self.clock.time.now())
        return super().read()

    def _drawn(self, now_s: float, state: RobotState) -> Picture:
        frozen = now_s >= self._freeze.at_s
        if self._posture is None or not frozen:
            self._posture = RobotPosture(*(self._sim.true_pose or self._missing()), state.joint_positions_rad)
        if self._picture is None or not frozen or self._freeze.kind == "noisy picture":
            self._picture = self._renderer.draw(self._posture)
        return self._picture


def walked(kind: str, number: int) -> tuple[TrialResult, Freeze, float]:
    """Result of a walk in which something freezes, and how far past a fence the robot came, in m."""
    chance = random.Random(f"{kind} {number}")
    robot = load_robot(chance.choice(ROBOTS if kind not in PICTURES else ROBOTS[:1]))
    gait = make_gait(robot, chance.choice(GAITS), amplitude=chance.choice((None, 0.8 * robot.gait.amplitude)))
    freeze = Freeze(
        kind=kind,
        at_s=chance.uniform(*FREEZES_S),
        joint=chance.randrange(N_JOINTS),
        late_s=chance.uniform(0.5, 3.0),
    )
    plan = TrialPlan(gait=gait, duration_s=WALK_S, hold=chance.choice(("auto", "none")))
    with ExitStack() as stack:
        simulated = SimServos(robot, seed=number)
        if kind in PICTURES:
            drawing = SceneRenderer(robot, CAMERA, FLOOR_TAGS, tag_on(robot), noise=NOISE, seed=number)
            renderer = stack.enter_context(drawing)
            servos: FrozenServos = WatchedServos(simulated, freeze, number, renderer)
        else:
            servos = FrozenServos(simulated, freeze, number)
        guard = Guard(servos, tilt_of=servos.tilt_of, trusts_position=servos.has_simulated_pose)
        stack.enter_context(guard)
        fence = Geofence(FENCE_M) if kind in FENCED else None
        result = run_trial(guard, plan, watched_walk(make_recovery("stop")), should_stop=fence)
    return result, freeze, servos.farthest_m - FENCE_M


def is_safe(result: TrialResult, freeze: Freeze) -> bool:
    """Whether the robot came to rest, or went on without a decision by what froze."""
    if result.status != "ok":
        legs = [one.failure.leg for one in result.noticed]
        return freeze.kind != "joint" or legs == [1 + freeze.joint // JOINTS_PER_LEG]
    return freeze.kind in ("voltage", "joint", "contacts") and not result.noticed


def frozen_rows(times: int, kinds: Sequence[str]) -> Iterator[Row]:
    """How often a robot is safe although its sensing freezes, and how far past a fence it comes."""
    for kind in kinds:
        walks = [walked(kind, number) for number in range(times)]
        for number, (result, freeze, past_m) in enumerate(walks):
            past = f", {past_m:+.2f} m past the fence" if kind in FENCED else ""
            print(f"  {kind} {number}: at {freeze.at_s:.2f} s: {result!r}{past}", flush=True)
        safe = sum(is_safe(result, freeze) for result, freeze, _ in walks)
        yield Count(safe, times).row(f"frozen.{kind.replace(' ', '_')}", "at rest, or no decision taken")
        if kind in FENCED:
            farthest_m = max(past_m for _, _, past_m in walks)
            yield Row(f"frozen.{kind.replace(' ', '_')}_past_fence", farthest_m, "m", note="farthest")


if __name__ == "__main__":
    given = sys.argv[1:]
    for row in frozen_rows(int(given[0]) if given else 20, given[1:] or KINDS):
        print(row, flush=True)
