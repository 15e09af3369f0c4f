"""A run by a policy: its command, the plan that scores it, its controller and its part of the outcome."""

import math
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.policy.policy import Policy
from hexctl.control.policy.policy_controller import (
    PolicyController,
    checked_command,
    inference_us,
    usual_speed_m_s,
)
from hexctl.control.policy.policy_motion import SLOW_S, PolicyMotion
from hexctl.control.preparation import WalkStart
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError, argument
from hexctl.gait.gait import PACE_HZ, ideal_speed_m_s, make_gait
from hexctl.robot.model import Robot
from hexctl.runs.run_spec import RunSpec
from hexctl.types import JOINT_NAMES, FloatArray


@dataclass(slots=True, eq=False)
class PolicyRun:
    """A policy that walks a spec; as a custom controller it makes the controller of a walk.

    Attributes:
        robot: that walks.
        policy: with its contract.
        velocity_body: commanded velocity, forward and left in m/s and turn in rad/s, (3,).
        paced: whether a wall clock paces the walk: then slow inferences stop it.
        motion: of the walk; None before it.
    """

    robot: Robot
    policy: Policy
    velocity_body: FloatArray
    paced: bool
    motion: PolicyMotion | None = field(default=None, init=False)

    @classmethod
    def of(cls, spec: RunSpec, robot: Robot) -> "PolicyRun | None":
        """The run of a spec, None without a policy.

        Raises InputError for an unusable policy or contract, and for a command beyond its ranges.
        """
        if spec.policy is None:
            return None
        policy = spec.policy if isinstance(spec.policy, Policy) else Policy.load(Path(spec.policy))
        velocity = checked_command(policy.contract, _velocity(spec, policy))
        PolicyMotion(robot, policy, 1.0)  # refuses what the robot does not measure
        return cls(robot, policy, velocity, spec.paced)

    @property
    def controller_name(self) -> str:
        """Name in results and of recordings."""
        return self.policy.name

    def __call__(self, start: WalkStart) -> PolicyController:
        """Controller of a robot that stands."""
        limit_s = SLOW_S if self.paced else None
        controller = PolicyController(start, self.policy, self.velocity_body, limit_s=limit_s)
        self.motion = controller.motion
        return controller

    def plan(self, spec: RunSpec) -> TrialPlan:
        """Plan that scores the walk: its gait only stands for the commanded speed."""
        speed_m_s, gait = float(np.hypot(*self.velocity_body[:2])), make_gait(self.robot, "demo")
        if self.policy.contract.command_ranges is None:
            speed_m_s = spec.speed_m_s or 0.0
        plan = TrialPlan(
            gait=gait,
            heading_rad=spec.heading_rad or 0.0,
            turn_rate_rad_s=spec.turn_rate_rad_s or 0.0,
            duration_s=spec.duration_s,
            failures=spec.failures,
            self_rotation="none",
        )
        if not speed_m_s:
            return replace(plan, travel=0.0)
        share = speed_m_s / ideal_speed_m_s(self.robot, gait, plan.motion(0.0))
        return replace(plan, gait=replace(gait, pace_hz=min(share * gait.pace_hz, PACE_HZ.high)))

    def values(self) -> dict[str, Any]:
        """Values of the outcome: name, command, inferences, and joints at their limits."""
        motion, forward_left_turn = self.motion, [round(float(one), 6) for one in self.velocity_body]
        ticks = 0 if motion is None else len(motion.inference_s)
        saturated = [] if motion is None else (motion.saturated / max(1, ticks)).tolist()
        return {
            "name": self.policy.name,
            "contract": self.policy.contract.origin,
            "velocity_body": forward_left_turn,
            "inferences": ticks,
            "inference_us": dict.fromkeys(("p50", "p99", "max")) if motion is None else inference_us(motion),
            "saturated": {
                JOINT_NAMES[joint]: round(share, 3) for joint, share in enumerate(saturated) if share
            },
        }


def _velocity(spec: RunSpec, policy: Policy) -> FloatArray:
    heading_rad, turn = spec.heading_rad or 0.0, spec.turn_rate_rad_s or 0.0
    if policy.contract.command_ranges is None:
        if turn or heading_rad:
            raise InputError(
                f"{argument('policy')}: {policy.name} observes no command; allowed: without "
                f"{argument('heading_rad')} and {argument('turn_rate_rad_s')}"
            )
        return np.zeros(3)
    on_spot = spec.turn_rate_rad_s is not None and spec.heading_rad is None
    speed_m_s = spec.speed_m_s
    if speed_m_s is None:
        speed_m_s = 0.0 if on_spot else usual_speed_m_s(policy.contract, heading_rad)
        if not speed_m_s and not on_spot:
            raise InputError(
                f"{argument('heading_rad')}: {policy.name} was not trained to go that way; allowed: the "
                "ranges of its command, which hexctl policy show prints"
            )
    return np.array([speed_m_s * math.cos(heading_rad), speed_m_s * math.sin(heading_rad), turn])
