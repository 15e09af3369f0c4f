"""Robots that learn together: many simulations in batches, as an environment of Stable-Baselines3.

The observations, actions and rewards are those of `HexapodEnvironment`. The simulations are compiled once:
each keeps its world and starts again where its preparation ended, with another failure and heading.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from stable_baselines3.common.vec_env import VecEnv

from hexctl.backends.sim.sensing import LOST_COMMANDS, LOST_POSES, Losses, Noise
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_batch import SimBatch, batch_layout
from hexctl.backends.sim.world import World
from hexctl.control.guard import FALL_TICKS, Guard, StepLimits, leaning
from hexctl.control.preparation import WalkStart, prepare
from hexctl.control.scoring.walk_quality import WalkEffort
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import ideal_speed_m_s, make_gait
from hexctl.learning.environment import FALL, HexapodEnvironment, drawn_failure, reward_of
from hexctl.learning.learned_walk import LearnedWalk
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: Most robots of a batch: their episodes begin and end together, those of other batches at other times.
TOGETHER = 32

#: Share of episodes with a failure, its earliest and latest time, and length of an episode.
FAILING, FAILURE_S, DURATION_S = 0.8, (1.0, 4.0), 15.0


class Batch:
    """Robots of one layout, which begin their episodes together."""

    def __init__(
        self, servos: Sequence[SimServos], starts: Sequence[WalkStart], accepted_rad: FloatArray
    ) -> None:
        self._servos, self._starts, self._accepted_at_start_rad = servos, starts, accepted_rad
        self.size, self._number = len(servos), 0
        robot, plan = servos[0].robot, starts[0].plans[0]
        self._robot, self._limits = robot, StepLimits.of(robot, starts[0].period_s)
        self._ideal_m = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0)) * starts[0].period_s

    def begin(
        self, draw: np.random.Generator, kinds: Sequence[str], headings_deg: Sequence[float]
    ) -> FloatArray:
        """Begin an episode of all robots; their observations."""
        self._number += 1
        for one in self._servos:
            for failure in one.failures:
                one.change_leg(failure.leg, None)
            one.events = (drawn_failure(draw, kinds, FAILURE_S),) if draw.random() < FAILING else ()
            world, seed = one.world, one.seed
            one.sensors.noise = Noise(world.sensor_noise, seed, self._number)
            one.sensors.pose_loss = Losses(world.lost_poses, LOST_POSES, seed, self._number)
            one.loss = Losses(world.lost_commands, LOST_COMMANDS, seed, self._number)
        headings_rad = np.radians(draw.choice(headings_deg, self.size))
        start = _together(self._starts, headings_rad)
        assert start.frame is not None
        self._frame, self._walk = start.frame, LearnedWalk(start)
        self._batch = SimBatch(self._servos, [1] * self.size, 1)
        self._accepted_rad, self._effort = self._accepted_at_start_rad, WalkEffort((self.size,))
        self._leaning_ticks = np.zeros(self.size, dtype=int)
        self.step, self._energy_j = 0, np.zeros(self.size)
        self.over = np.zeros(self.size, dtype=bool)
        observation = self._sense()
        self.path_m = self._true_path_m()
        return observation

    def after(self, actions: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Observations and rewards after actions, (n, ...); `over` says who has fallen by now."""
        asked_rad = self._walk.act(self.step, self._state, actions)
        self._accepted_rad = self._limits.apply(asked_rad, self._accepted_rad)
        self._batch.write(self._accepted_rad)
        self._effort.add(self._state, self._accepted_rad)
        before_m, before_j, over = self.path_m, self._energy_j, self.over
        observation = self._sense()
        self.path_m, joints_j = self._true_path_m(), self._effort.joints_j
        self._energy_j = before_j if joints_j is None else joints_j.sum(axis=-1)
        moved_m, spent_j = self.path_m[:, 0] - before_m[:, 0], self._energy_j - before_j
        rewards = reward_of(self._robot, self._ideal_m, moved_m, self.path_m[:, 1], spent_j)
        self._leaning_ticks = np.where(leaning(self._batch.true_pose[1]), self._leaning_ticks + 1, 0)
        self.over = over | (self._leaning_ticks >= FALL_TICKS) | ~self._batch.running
        self._batch.running &= ~self.over
        self.step += 1
        rewards = np.where(self.over & ~over, -FALL, np.where(over, 0.0, rewards))
        return np.nan_to_num(observation), rewards

    def _sense(self) -> FloatArray:
        self._batch.tick()
        self._state = self._batch.read()
        return self._walk.observe(self._state)

    def _true_path_m(self) -> FloatArray:
        frame, rows = self._frame, self._batch.true_pose[0]
        each = zip(rows, frame.origin_world, np.atleast_1d(frame.heading_rad), strict=True)
        return np.stack(
            [TrialFrame(origin, heading, 0.0).path(row[np.newaxis])[0] for row, origin, heading in each]
        )


def _together(starts: Sequence[WalkStart], headings_rad: FloatArray) -> WalkStart:
    """Start of a batch in other headings."""
    frames = [start.frame for start in starts]
    yaws = np.array([frame.yaw_rad for frame in frames if frame is not None])
    origins = np.stack([frame.origin_world for frame in frames if frame is not None])
    plans = [
        replace(start.plans[0], heading_rad=float(heading))
        for start, heading in zip(starts, headings_rad, strict=True)
    ]
    frame = TrialFrame(origins, yaws + headings_rad, yaws)  # type: ignore[arg-type]
    return replace(starts[0], plans=tuple(plans), batch_shape=(len(plans),), frame=frame, turned_rad=0.0)


def batches_of(robot: Robot, worlds: Sequence[World]) -> list[Batch]:
    """A robot in each world, prepared, in batches."""
    plan = TrialPlan(
        gait=make_gait(robot, "tripod"), self_rotation="none", hold="line", duration_s=DURATION_S
    )
    layouts: dict[object, list[tuple[SimServos, WalkStart, FloatArray]]] = {}
    for seed, world in enumerate(worlds):
        servos = SimServos(robot, world=world, seed=seed)
        servos.connect()
        guard = Guard(servos)
        start = prepare(guard, plan)
        layouts.setdefault(batch_layout(servos), []).append((servos, start, guard.accepted_rad()))
    parts = [alike[at : at + TOGETHER] for alike in layouts.values() for at in range(0, len(alike), TOGETHER)]
    return [
        Batch([a for a, _, _ in part], [b for _, b, _ in part], np.stack([c for _, _, c in part]))
        for part in parts
    ]


class RobotBatches(VecEnv):  # type: ignore[misc]  # Stable-Baselines3 may be missing
    """All batches. A robot that has fallen goes on in episodes of one tick until its batch ends."""

    def __init__(
        self, batches: Sequence[Batch], kinds: Sequence[str], headings_deg: Sequence[float], seed: int
    ) -> None:
        spaces = HexapodEnvironment()
        self._batches, self._kinds, self._headings_deg = batches, kinds, headings_deg
        self._draw, self._first = np.random.default_rng(seed), True
        super().__init__(sum(one.size for one in batches), spaces.observation_space, spaces.action_space)
        self.finished: list[dict[str, float]] = []

    def reset(self) -> FloatArray:
        """Begin the first episodes."""
        begun = [one.begin(self._draw, self._kinds, self._headings_deg) for one in self._batches]
        self._ends = [
            round(DURATION_S / 0.02 * (1 + place) / len(self._batches)) for place in range(len(self._batches))
        ]
        self._returns = [np.zeros(one.size) for one in self._batches]
        return np.concatenate(begun).astype(np.float32)

    def step_async(self, actions: FloatArray) -> None:
        """Keep the actions of the next tick."""
        self._actions = actions

    def step_wait(self) -> tuple[FloatArray, FloatArray, FloatArray, list[dict[str, Any]]]:
        """One tick of all robots."""
        seen, rewards, dones, infos = [], [], [], []
        at = 0
        for place, batch in enumerate(self._batches):
            fallen = batch.over
            observation, reward = batch.after(self._actions[at : at + batch.size])
            at += batch.size
            self._returns[place] += reward
            ends = batch.step >= self._ends[place]
            for row in range(batch.size):
                info: dict[str, Any] = {}
                if ends or batch.over[row]:
                    info = {"terminal_observation": observation[row].astype(np.float32)}
                    info["TimeLimit.truncated"] = bool(ends and not batch.over[row])
                infos.append(info)
            dones.append(batch.over | ends)
            if ends:
                self._finish(place)
                observation = batch.begin(self._draw, self._kinds, self._headings_deg)
            seen.append(observation)
            rewards.append(np.where(fallen, 0.0, reward))
        return np.concatenate(seen).astype(np.float32), np.concatenate(rewards), np.concatenate(dones), infos

    def _finish(self, place: int) -> None:
        batch, full = self._batches[place], round(DURATION_S / 0.02)
        if batch.step == full:
            for row in range(batch.size):
                progress_m, deviation_m = batch.path_m[row].tolist()
                self.finished.append(
                    {
                        "reward": float(self._returns[place][row]),
                        "progress_m": progress_m,
                        "deviation_m": abs(deviation_m),
                        "fell": float(batch.over[row]),
                    }
                )
        self._returns[place], self._ends[place] = np.zeros(batch.size), full

    def close(self) -> None:
        """Nothing to close."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """An attribute, for each robot."""
        return [getattr(self, attr_name, None)] * self.num_envs

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Refused: nothing of a robot can be set."""
        raise NotImplementedError

    def env_method(self, method_name: str, *args: Any, indices: Any = None, **kwargs: Any) -> list[Any]:
        """Refused: a robot has no own methods."""
        raise NotImplementedError

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No robot is wrapped."""
        return [False] * self.num_envs
