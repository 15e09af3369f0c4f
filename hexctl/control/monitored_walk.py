"""A walk that notices failed legs, and does about them what its policy says."""

from dataclasses import dataclass

import numpy as np

from hexctl.control.controllers import Controller
from hexctl.control.monitor.leg_monitor import LegMonitor, Suspicion
from hexctl.control.preparation import WalkStart
from hexctl.control.recovery import GlideToStableGait, RecoveryPolicy, Response
from hexctl.control.steered_walk import SteeredWalk
from hexctl.control.steering import held
from hexctl.control.velocity_walk import MotionWalk, VelocityWalk
from hexctl.robot.failure import Failure
from hexctl.types import N_LEGS, BoolArray, FloatArray, RobotState


@dataclass(frozen=True, slots=True, kw_only=True)
class Noticed:
    """A failure that a walk has noticed, and what it did about it.

    Attributes:
        suspicion: which leg, how, when, by what.
        response: of the policy.
    """

    suspicion: Suspicion
    response: Response


class MonitoredWalk(Controller):
    """Walks as its plans say, watches its legs, and does what a policy says once one fails.

    Args:
        start: the robot, or batch of robots, ready to walk.
        policy: decides; None glides to a gait for the legs that are left.

    Attributes:
        walk: what it walks with.
        noticed: what it noticed so far, for each walk.
    """

    def __init__(self, start: WalkStart, policy: RecoveryPolicy | None = None) -> None:
        hold = held(start.plans[0], start.frame)
        self.walk: VelocityWalk = MotionWalk(start) if hold == "none" else SteeredWalk(start, hold=hold)
        self.walk.leave_plain()
        self.hold = hold
        self._start, self._policy = start, GlideToStableGait() if policy is None else policy
        self._headings_rad = [motion.heading_rad for motion in start.motions]
        self._failures = [[] if plan.belief is None else [plan.belief] for plan in start.plans]
        self.noticed: tuple[list[Noticed], ...] = tuple([] for _ in start.plans)
        for plan, heading_rad in zip(start.plans, self._headings_rad, strict=True):
            self._policy.prepare(start.robot, plan, heading_rad)
        believed = np.array(
            [[leg in plan.failed_legs for leg in range(1, N_LEGS + 1)] for plan in start.plans]
        )
        paces_hz = np.array([plan.gait.pace_hz for plan in start.plans])
        pick = slice(None) if start.batch_shape else 0
        self._monitor = LegMonitor(
            start.robot, start.batch_shape, start.period_s, paces_hz[pick], believed[pick]
        )

    @property
    def velocity_body(self) -> FloatArray:  # type: ignore[override]  # forwarded
        """The velocity that it walks with now, leading shape + (3,)."""
        return self.walk.velocity_body

    @property
    def limited_steps(self) -> FloatArray:  # type: ignore[override]  # forwarded
        """Steps in which it asked for more speed than its strokes allow, leading shape."""
        return self.walk.limited_steps

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, leading shape + (18,)."""
        self._monitor.update(state, self.walk.leg_phases)
        if self._monitor.new.any():
            self._respond(step)
        targets_rad = self.walk.targets_rad(step, state)
        self._monitor.sent(targets_rad, state.age_s)
        return targets_rad

    def done(self, step: int, state: RobotState) -> bool | BoolArray:
        """Whether the walk has come to a stand."""
        return self.walk.done(step, state)

    def stop(self, step: int) -> None:
        """Begin the soft stop."""
        self.walk.stop(step)

    def _respond(self, step: int) -> None:
        """Do what the policy says about the legs noticed in this tick."""
        new = np.atleast_2d(self._monitor.new).any(axis=-1)
        gaits, changes = list(self.walk.gaits), np.zeros(len(new), dtype=bool)
        for index in np.flatnonzero(new).tolist():
            row = (index,) if self._start.batch_shape else ()
            suspicion = self._monitor.suspicion(step, row)
            self._failures[index].append(suspicion.failure)
            response = self._answer(index, self._failures[index])
            self.noticed[index].append(Noticed(suspicion=suspicion, response=response))
            if response.gait is not None:
                gaits[index], changes[index] = response.gait, True
            if response.stop and not self._start.batch_shape:
                self.walk.stop(step)
        if changes.any():
            self.walk.glide_to(gaits, changes if self._start.batch_shape else changes[0])

    def _answer(self, index: int, failures: list[Failure]) -> Response:
        plan = self._start.plans[index]
        return self._policy.respond(self._start.robot, plan, self._headings_rad[index], failures)
