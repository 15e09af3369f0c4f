"""The hexapod as a Gymnasium environment, in which policies learn to walk when legs fail.

    environment = gymnasium.make("hexctl.learning.environment:hexctl/Hexapod-v0", worlds=("slippery",))

It runs what a trial runs: the simulated servos, the guard, the preparation and the tick of 20 ms.
"""

from collections.abc import Sequence
from math import radians
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from hexctl.backends.base import as_robot
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulation_model import FIRST_JOINT
from hexctl.backends.sim.world import World, as_world
from hexctl.control.guard import Guard
from hexctl.control.preparation import prepare, ticks_of
from hexctl.control.scoring.walk_quality import WalkEffort
from hexctl.control.trial_plan import DURATION_S, TrialPlan
from hexctl.errors import InputError, MissingExtraError, SimulationDivergedError
from hexctl.gait.gait import ideal_speed_m_s, make_gait
from hexctl.learning.learned_walk import ACTION_SIZE, OBSERVATION_SIZE, OBSERVED, LearnedWalk
from hexctl.robot.failure import FailureEvent
from hexctl.robot.failure_grammar import parse_coming_kind
from hexctl.robot.model import Robot
from hexctl.types import GRAVITY_M_S2, N_LEGS, FloatArray, JointTargets, check_finite

if TYPE_CHECKING:
    from hexctl.export.render import RobotRenderer

try:
    import gymnasium
    from gymnasium.spaces import Box
except ModuleNotFoundError as error:
    raise MissingExtraError("hexctl.learning.environment", "learn") from error

ID = "hexctl/Hexapod-v0"

#: Width and height of a picture.
PICTURE_PX = (640, 480)

Observation = NDArray[np.float32]
Values = FloatArray | float

#: Reward of a tick: progress as a share of the commanded one, less these for a deviation of the robot's size
#: and for a cost of transport of 1. A fall costs the last.
DEVIATION, EFFORT, FALL = 2.0, 0.05, 10.0


class HexapodEnvironment(gymnasium.Env[Observation, FloatArray]):
    """A walk along a line during which a leg may fail; `LearnedWalk` describes actions and observations.

    Each episode draws world, heading, leg, failure and its time. Episodes of one seed are alike. A fall ends
    an episode, and so does a simulation that diverges. `info` has true progress and deviation in m.

    Args:
        robot: name or path of a robot file, or a Robot.
        worlds: a name, path or World, or several; members of a family as `randomised:7`.
        failures: a kind of failures while walking, or several, as `locked`, `limp` or `stuck:coxa`.
        failing: share of the episodes with a failure.
        failure_s: earliest and latest time of the failure.
        headings_deg: directions of travel.
        gait: name or code of the gait that the policy modulates.
        duration_s: length of an episode.
        render_mode: `rgb_array` lets `render` draw; None.

    Raises InputError for invalid values.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 50}  # noqa: RUF012  as Gymnasium

    def __init__(
        self,
        *,
        robot: Robot | str | Path = "ant",
        worlds: World | str | Path | Sequence[World | str | Path] = ("flat",),
        failures: str | Sequence[str] = ("locked", "limp", "missing"),
        failing: float = 0.8,
        failure_s: tuple[float, float] = (1.0, 4.0),
        headings_deg: float | Sequence[float] | FloatArray = (0.0,),
        gait: int | str = "tripod",
        duration_s: float = 15.0,
        render_mode: str | None = None,
    ) -> None:
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise InputError(f"render_mode: got {render_mode!r}; allowed: 'rgb_array', or None")
        self.render_mode = render_mode
        self._renderer: RobotRenderer | None = None
        worlds = [worlds] if isinstance(worlds, World | str | Path) else worlds
        failures = [failures] if isinstance(failures, str) else failures
        headings_deg = np.atleast_1d(np.asarray(headings_deg, dtype=float))
        self._robot, self._worlds = as_robot(robot), [as_world(world) for world in worlds]
        DURATION_S.check("duration_s", duration_s)
        _check_failures(failures, failing, failure_s, duration_s)
        for name, given in (("worlds", worlds), ("headings_deg", headings_deg)):
            if len(given) == 0:  # of an array, too
                raise InputError(f"{name}: got none; allowed: one or more")
        self._failures, self._failing, self._failure_s = list(failures), failing, failure_s
        self._plans = [
            TrialPlan(
                gait=make_gait(self._robot, gait),
                heading_rad=radians(float(heading_deg)),
                duration_s=duration_s,
                self_rotation="none",
                hold="line",
            )
            for heading_deg in headings_deg
        ]
        self.action_space = Box(-1.0, 1.0, (ACTION_SIZE,), np.float64)
        self.observation_space = Box(-OBSERVED, OBSERVED, (OBSERVATION_SIZE,), np.float32)
        self._episode: _Episode | None = None
        self.spec = gymnasium.spec(ID)  # `gymnasium.make` gives it one with its own keywords

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Observation, dict[str, Any]]:
        """Stand a robot in another world, ready for its first step; observation and info."""
        super().reset(seed=seed)
        self.close()
        draw = self.np_random
        world = self._worlds[int(draw.integers(len(self._worlds)))]
        plan = self._plans[int(draw.integers(len(self._plans)))]
        fails = draw.random() < self._failing
        events = [drawn_failure(draw, self._failures, self._failure_s)] if fails else []
        servos = SimServos(
            self._robot, world=world, seed=int(draw.integers(1 << 31)), events=events, all_sensors=True
        )
        self._episode = _Episode(servos, plan)
        return self._episode.observation, self._episode.info

    def step(self, action: FloatArray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        """Send the targets of an action, (18,), and let one control period pass; raises InputError."""
        assert self._episode is not None, "call reset before step"  # noqa: S101  as Gymnasium's own
        sent = np.asarray(action, dtype=float)
        if sent.shape != self.action_space.shape:
            raise InputError(f"action: got shape {sent.shape}; allowed: {self.action_space.shape}")
        check_finite(sent, sent.shape, "action")  # one that is kept would spoil all later ones
        return self._episode.after(sent)

    def render(self) -> NDArray[np.uint8] | None:
        """Picture of the robot on the plane of its floor, (480, 640, 3); None without a `render_mode`.

        Raises NoRendererError on a machine that cannot draw.
        """
        if self.render_mode is None or self._episode is None:
            return None
        from hexctl.export.render import RobotRenderer
        from hexctl.recording.recorded_trial import LEG_CONDITIONS

        servos, simulation = self._episode.servos, self._episode.servos.compiled
        if self._renderer is None:
            floor = simulation.floor.quaternion_world
            self._renderer = RobotRenderer(self._robot, floor, "follow", *PICTURE_PX)
        conditions = np.zeros(N_LEGS, dtype=np.int64)
        for failure in servos.failures:
            look = "missing" if failure.kind == "missing" else "failed"
            conditions[failure.leg - 1] = LEG_CONDITIONS.index(look)
        place_m, turn, joints_rad = np.split(simulation.physics.data.qpos, [3, FIRST_JOINT])
        self._renderer.posed.place(place_m, turn, joints_rad, conditions)
        return self._renderer.picture()

    def close(self) -> None:
        """Free the simulation, and what draws."""
        if self._renderer is not None:
            self._renderer.close()
            self._renderer = None
        if self._episode is not None:
            self._episode.servos.close()
            self._episode = None


def _check_failures(
    kinds: Sequence[str], failing: float, between_s: tuple[float, float], duration_s: float
) -> None:
    for kind in kinds:
        parse_coming_kind(1, kind)
    if not 0 <= failing <= 1:
        raise InputError(f"failing: got {failing:g}; allowed: 0 to 1, as a share of the episodes")
    if failing and not kinds:
        raise InputError("failures: got none; allowed: one or more kinds, or failing=0")
    if failing and not 0 <= between_s[0] <= between_s[1] < duration_s:
        raise InputError(
            f"failure_s: got {between_s}; allowed: two times that do not descend, in an episode of "
            f"{duration_s:g} s"
        )


def drawn_failure(
    draw: np.random.Generator, kinds: Sequence[str], between_s: tuple[float, float]
) -> FailureEvent:
    """A failure of some kind of some leg at some time."""
    leg, kind = int(draw.integers(1, N_LEGS + 1)), kinds[int(draw.integers(len(kinds)))]
    at_s = round(float(draw.uniform(*between_s)), 2)
    return FailureEvent(at_s=at_s, leg=leg, failure=parse_coming_kind(leg, kind))


def reward_of(
    robot: Robot, ideal_m: float, moved_m: Values, deviation_m: Values, spent_j: Values
) -> FloatArray:
    """Reward of a tick without a fall, leading shape.

    Args:
        ideal_m: commanded progress of a tick.
        moved_m: progress along the line in the tick, leading shape.
        deviation_m: from the line, leading shape.
        spent_j: energy of the tick, leading shape.
    """
    cost = spent_j / (robot.mass_kg * GRAVITY_M_S2 * ideal_m)
    return np.asarray(moved_m / ideal_m - DEVIATION * np.abs(deviation_m) / robot.size_m - EFFORT * cost)


class _Episode:
    """A walk that waits for the action of its next tick."""

    def __init__(self, servos: SimServos, plan: TrialPlan) -> None:
        servos.connect()
        self.servos, self._guard = servos, Guard(servos)
        start = prepare(self._guard, plan)
        assert start.true_frame is not None  # noqa: S101  a simulation knows its pose
        self._frame, self._ticks = start.true_frame, ticks_of(servos, plan.duration_s)
        self._walk, self._effort, self._energy_j = LearnedWalk(start), WalkEffort(), 0.0
        self._ideal_m = ideal_speed_m_s(servos.robot, plan.gait, plan.motion(0.0)) * start.period_s
        servos.walk_begins()
        self._step = 0
        self._sense()
        self._path_m = self._true_path_m()

    @property
    def info(self) -> dict[str, Any]:
        return {"progress_m": float(self._path_m[0]), "deviation_m": float(self._path_m[1])}

    def after(self, action: FloatArray) -> tuple[Observation, float, bool, bool, dict[str, Any]]:
        asked_rad = self._walk.act(self._step, self._state, action)
        sent = self._guard.write(JointTargets(asked_rad, self._time_s))
        self._effort.add(self._state, sent.joint_positions_rad)
        self._step += 1
        try:
            self._sense()
            fell = self._guard.stopped is not None
        except SimulationDivergedError:
            fell = True
        reward = -FALL if fell else self._reward()
        return self.observation, reward, fell, self._step >= self._ticks, self.info

    def _sense(self) -> None:
        self._time_s = self._guard.clock.tick().time_s
        self._state = self._guard.read()
        self.observation = self._walk.observe(self._state).astype(np.float32)

    def _reward(self) -> float:
        before_m, before_j = self._path_m, self._energy_j
        self._path_m, self._energy_j = self._true_path_m(), self._effort.energy_j() or 0.0
        moved_m, spent_j = self._path_m[0] - before_m[0], self._energy_j - before_j
        return float(reward_of(self.servos.robot, self._ideal_m, moved_m, self._path_m[1], spent_j))

    def _true_path_m(self) -> FloatArray:
        pose = self.servos.true_pose
        assert pose is not None  # noqa: S101  connected
        return np.asarray(self._frame.path(pose[0][np.newaxis])[0])


gymnasium.register(id=ID, entry_point=f"{__name__}:{HexapodEnvironment.__name__}")
