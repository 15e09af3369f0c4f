"""A simulated robot that knows its place by a rendered camera alone, not in real time."""

from collections import deque
from dataclasses import dataclass, field, replace

import numpy as np

from benchmarks.see_floor import FLOOR_TAGS
from hexctl.backends.base import ServosWrapper
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import load_world
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_result import TrialResult
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import about_z, wrapped_rad, yaw_rad
from hexctl.simulators.camera.rendering import WEBCAM, RobotPosture, SceneRenderer, tag_on
from hexctl.study.hold_walks import HoldCase, HoldPlace
from hexctl.types import RobotState
from hexctl.vision.detection.camera import Camera, place_camera
from hexctl.vision.detection.floor import averaged_corners
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.observer import Observer
from hexctl.vision.robot_link import LegState

#: Pictures per second, how late they come, and the share that never does.
FPS, LATENCY_S, DROPPED = 30.0, 0.08, 0.02

#: The camera looks across the walk: a walk of 15 s of `ant` goes up to 2.2 m ahead.
CAMERA = Camera.looking(WEBCAM, np.array([1.0, -1.63, 1.63]), np.array([1.0, 0.0, 0.0]))
WALK_S = 15.0

#: Tags next to the walk.
TAGS = {
    number: PlacedTag(
        number, tag.edge_m, PlanarPose(0.6 * tag.pose.x_m + 1.0, 0.6 * tag.pose.y_m + 0.25, tag.pose.yaw_rad)
    )
    for number, tag in FLOOR_TAGS.items()
}

#: Period of what is seen before the robot walks, and how often.
_STEP_S, _STEPS = 0.02, 30


@dataclass(slots=True)
class PoseErrors:
    """How far off the pose was that the robot was told, tick by tick.

    Attributes:
        off_m: told minus true, x and y, in m.
        off_rad: of the heading.
        sights: what each pose rested on.
    """

    off_m: list[tuple[float, float]] = field(default_factory=list)
    off_rad: list[float] = field(default_factory=list)
    sights: list[str] = field(default_factory=list)

    @property
    def greatest_step_m(self) -> float:
        """Largest change of the error between two ticks."""
        steps = np.diff(np.array(self.off_m), axis=0)
        return float(np.hypot(*steps.T).max())


class SeenServos(ServosWrapper):
    """A simulation whose pose is what a rendered camera sees of it.

    Attributes:
        errors: of the pose.
    """

    def __init__(self, servos: SimServos, seed: int = 0) -> None:
        super().__init__(servos)
        self._simulated, self._tag = servos, tag_on(servos.robot)
        self._seed = seed
        self._random = np.random.default_rng(seed)
        self._late: deque[tuple[float, Picture]] = deque()
        self._renderer: SceneRenderer | None = None
        self.errors = PoseErrors()

    def connect(self) -> None:
        """Connect, place the camera by the tags, and look at the standing robot for a while."""
        super().connect()
        renderer = SceneRenderer(self.robot, CAMERA, TAGS, self._tag, seed=self._seed)
        self._renderer, finder = renderer, TagFinder()
        corners = {number: tag.corners for number, tag in TAGS.items()}
        views = [finder.search(renderer.draw(self._posture()), thorough=True) for _ in range(20)]
        camera = place_camera(WEBCAM, averaged_corners(views), corners)
        if camera is None:
            raise RuntimeError("the rendered camera sees no tag of the floor")
        self._observer = Observer(self.robot, camera, corners, self._tag, latency_s=LATENCY_S, finder=finder)
        state = super().read()
        for step in range(-_STEPS, 0):
            at_s = state.stamp_s + step * _STEP_S
            self._observer.listen(LegState(at_s, state.joint_positions_rad, None, None))
            self._observer.look(renderer.draw(self._posture()), at_s)
            self._observer.estimate(at_s)
        self._next_s = state.stamp_s

    def read(self) -> RobotState:
        """State of the simulation, with the pose that was seen."""
        state = super().read()
        now_s, renderer = state.stamp_s, self._renderer
        if renderer is None:
            return state
        self._observer.listen(LegState(now_s, state.joint_positions_rad, None, None))
        if now_s >= self._next_s - 1e-9:
            self._next_s += 1 / FPS
            if self._random.random() >= DROPPED:
                self._late.append((now_s + LATENCY_S, renderer.draw(self._posture(), now_s)))
        while self._late and self._late[0][0] <= now_s + 1e-9:
            self._observer.look(self._late.popleft()[1], now_s)
        estimate = self._observer.estimate(now_s)
        self.errors.sights.append(estimate.sight)
        if estimate.pose is None:
            return replace(state, base_position_world=None, base_quaternion_world=None)
        pose, posture = estimate.pose, self._posture()
        x_m, y_m = posture.position_floor[:2]
        self.errors.off_m.append((pose.x_m - x_m, pose.y_m - y_m))
        self.errors.off_rad.append(wrapped_rad(pose.yaw_rad - float(yaw_rad(posture.quaternion_floor))))
        return replace(
            state,
            base_position_world=np.array([pose.x_m, pose.y_m, self._observer.height_m]),
            base_quaternion_world=about_z(pose.yaw_rad),
        )

    def close(self) -> None:
        """Close the simulation and what draws it."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        super().close()

    def _posture(self) -> RobotPosture:
        simulation = self._simulated.compiled.physics.data.ptr
        qpos = np.array(simulation.qpos[:25])
        return RobotPosture(qpos[:3], qpos[3:7], qpos[7:])


def held_walk(
    number: int, leg: int, failure: str, *, seen: bool, duration_s: float = WALK_S
) -> tuple[TrialResult, PoseErrors]:
    """A walk of `ant` that holds its line with a failed leg, in a world of `transfer` with a level floor.

    Args:
        number: of the world; its sensors are perfect.
        leg: that has failed, 1..6.
        failure: as `parse_kind` reads it.
        seen: whether the pose is what a camera sees, or the true one.
        duration_s: of the walk.
    """
    robot = load_robot("ant")
    drawn = load_world(f"transfer:{number}")
    even = {"slope_deg": 0.0, "roughness_m": 0.0, "state_latency_s": 0.0, "lost_poses": 0.0}
    world = drawn.model_copy(update={**even, "sensor_noise": type(drawn.sensor_noise)()})
    case = HoldCase(leg=leg, failure=failure, hold="line")
    conditions = HoldPlace(
        robot=robot, family="transfer", number=number, kind="even", world=world, duration_s=duration_s
    )
    simulated = SimServos(robot, world=world, failures=case.leg_failure, seed=number)
    servos = SeenServos(simulated, seed=number) if seen else simulated
    with Guard(servos) as guard:
        result = run_trial(guard, conditions.trial(case).plan)
    return result, servos.errors if isinstance(servos, SeenServos) else PoseErrors()
