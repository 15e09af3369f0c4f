"""Controllers that walk by a policy: along a constant command, and driven."""

import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from hexctl.columns import Column
from hexctl.control.controllers import Controller
from hexctl.control.drive.drive_walk import DriveWalk, VelocityCommand
from hexctl.control.policy.contract import PolicyContract
from hexctl.control.policy.policy import Policy
from hexctl.control.policy.policy_motion import PolicyMotion
from hexctl.control.preparation import WalkStart
from hexctl.errors import InputError, check_type
from hexctl.types import FloatArray, RobotState

#: Share of the maximum speed in a direction that is commanded unless another is asked for.
USUAL_SHARE = 0.5


#: Directions of a command.
AXES = ("forward in m/s", "left in m/s", "of the turn in rad/s")


class _ByPolicy(Controller):
    """What a controller tells of the motion that makes its targets."""

    motion: PolicyMotion

    @property
    def own_columns(self) -> tuple[Column, ...]:  # type: ignore[override]  # of the motion
        """Columns of the observation and the actions."""
        return self.motion.columns

    @property
    def own_values(self) -> Mapping[str, FloatArray]:  # type: ignore[override]  # of the motion
        """Observation and actions of the last step."""
        return self.motion.values

    def why_stopped(self, index: int = 0) -> str | None:
        """Why the policy was stopped, or None."""
        trouble = self.motion.trouble
        return None if trouble is None else f"policy: {trouble}"

    def news(self) -> Sequence[str]:
        """Events since the last call."""
        return self.motion.news()


class PolicyController(_ByPolicy):
    """Walks with a constant command by a policy, with a soft start and stop.

        policy = hexctl.Policy.load("walk.onnx")
        hexctl.run(controller=lambda start: hexctl.PolicyController(start, policy, [0.1, 0.0, 0.0]))

    Args:
        start: a single robot.
        policy: with its contract.
        velocity_body: commanded velocity, forward and left in m/s and turn in rad/s, (3,).
        limit_s: longest inference; two longer ones in a row stop the walk softly. None for no limit.
        now_s: time by which inferences are measured.

    Raises InputError for a batch, a policy that observes what the robot does not measure, and a velocity
    beyond its ranges.
    """

    def __init__(
        self,
        start: WalkStart,
        policy: Policy,
        velocity_body: Sequence[float] | FloatArray = (0.0, 0.0, 0.0),
        *,
        limit_s: float | None = None,
        now_s: Callable[[], float] = time.perf_counter,
    ) -> None:
        check_type(policy, Policy, "policy", "a Policy, as Policy.load('walk.onnx') gives")
        if start.batch_shape:
            raise InputError(f"policy: got a batch of {len(start.plans)} robots; allowed: one robot")
        self._wanted = checked_command(policy.contract, np.asarray(velocity_body, dtype=float))
        self.motion = PolicyMotion(start.robot, policy, start.period_s, limit_s=limit_s, now_s=now_s)
        self._stops = False

    @property
    def velocity_body(self) -> FloatArray:  # type: ignore[override]  # of the motion
        """Velocity that the policy observes, (3,)."""
        return self.motion.command

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (18,)."""
        return self.motion.targets_rad(step, state, self._wanted, goes=not self._stops)

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the policy was stopped, or a soft stop has ended."""
        return self.motion.trouble is not None or (self._stops and self.motion.mode == "resting")

    def stop(self, step: int) -> int:
        """Begin the soft stop; the steps that it takes."""
        self._stops = True
        return self.motion.return_steps


class PolicyWalk(_ByPolicy, DriveWalk):
    """A driven walk by a policy, in place of the gaits of `DriveWalk`.

    Without a command the robot returns to its stance, and rests.
    """

    def __init__(
        self, start: WalkStart, desired: VelocityCommand, policy: Policy, *, limit_s: float | None = None
    ) -> None:
        self._velocity: FloatArray = np.zeros(3)
        self.policy = policy
        self.motion = PolicyMotion(start.robot, policy, start.period_s, limit_s=limit_s)
        super().__init__(start, desired)

    @property
    def velocity_body(self) -> FloatArray:  # set by a stop, too
        """Velocity that the policy observes, (3,); a stop sets it."""
        return self._velocity

    @velocity_body.setter
    def velocity_body(self, velocity: FloatArray) -> None:
        self._velocity = velocity
        self.motion.restart()

    @property
    def at_rest(self) -> bool:
        """Whether it stands in its stance."""
        return self.motion.mode == "resting"

    @property
    def home(self) -> bool:
        """Whether it stands in its stance."""
        return self.at_rest

    @property
    def leg_phases(self) -> None:  # type: ignore[override]  # a policy has no cycle
        """None: a policy has no cycle."""
        return

    def go_home(self) -> None:
        """Let a stopped policy walk again; without a command it returns to the stance anyway."""
        self.motion.trouble = None

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (18,)."""
        desired = np.asarray(self._desired(), dtype=float)
        targets_rad = self.motion.targets_rad(step, state, desired, goes=bool(desired.any()))
        self._velocity = self.motion.command
        return targets_rad


def checked_command(contract: PolicyContract, velocity: FloatArray) -> FloatArray:
    """A velocity, (3,); raises InputError beyond the ranges of a contract."""
    if velocity.shape != (3,) or not np.isfinite(velocity).all():
        raise InputError("policy: velocity: allowed: three finite numbers, forward, left and turn")
    ranges = contract.command_ranges
    for name, value, bounds in zip(AXES, velocity.tolist(), [] if ranges is None else ranges, strict=False):
        low, high = bounds.tolist()
        if not low - 1e-9 <= value <= high + 1e-9:
            raise InputError(
                f"policy: got {value:g} for the velocity {name}; allowed: {low:g} to {high:g}, as trained"
            )
    return velocity


def usual_speed_m_s(contract: PolicyContract, heading_rad: float) -> float:
    """Usual share of the maximum speed of a policy in a direction; 0 if it was not trained to go there."""
    if contract.command_ranges is None:
        return 0.0
    speeds = []
    for part, (low, high) in zip(
        (np.cos(heading_rad), np.sin(heading_rad)), contract.command_ranges[:2].tolist(), strict=True
    ):
        if abs(part) > 1e-9:
            speeds.append(max(0.0, (high if part > 0 else low) / part))
    return float(USUAL_SHARE * min(speeds))


def inference_us(motion: PolicyMotion) -> dict[str, Any]:
    """Durations of the inferences in microseconds: `p50`, `p99`, `max`; None without any."""
    if not len(motion.inference_s):
        return dict.fromkeys(("p50", "p99", "max"))
    found = np.percentile(np.array(motion.inference_s) * 1e6, [50, 99, 100])
    return dict(zip(("p50", "p99", "max"), (round(float(one), 1) for one in found), strict=True))
