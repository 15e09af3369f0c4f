"""The controller behind `Drive`: standing up, driving and sitting down."""

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from hexctl.columns import Column
from hexctl.control.controllers import SITTING_S, Controller, Stand, sitting_angles_rad
from hexctl.control.drive.arbiter import Arbiter, Decision
from hexctl.control.drive.drive_walk import DriveWalk
from hexctl.control.drive.velocity_hold import VelocityHold
from hexctl.control.monitor.monitored_walk import MonitoredWalk
from hexctl.control.monitor.recovery import Recovery
from hexctl.control.planning.speed_envelope import VelocityLimits
from hexctl.control.policy.policy import Policy
from hexctl.control.policy.policy_controller import PolicyWalk
from hexctl.control.preparation import WalkStart
from hexctl.control.telemetry_watch import Temperatures, pace
from hexctl.control.trial_plan import Feet, TrialPlan
from hexctl.gait.body_pose import LEVEL, BodyPose
from hexctl.gait.gait import Gait
from hexctl.gait.posture import STANCE
from hexctl.robot.failure import Failure, NoticedFailure
from hexctl.robot.model import Robot
from hexctl.types import FloatArray, RobotState

MODES = ("standing up", "driving", "sitting down", "sitting")


class DriveController(Controller):
    """Follows an arbiter's velocity and body pose within limits; stands up first, and sits on request.

    A stop freezes the robot in any mode: its steps and motions continue where they were once the stop is
    cleared. With warm servos the velocity is reduced before the guard stops the robot. If the recovery stops
    the robot after a failure, it comes to a stand, and the arbiter is stopped until it is cleared.

    Attributes:
        mode: one of `MODES`.
        decision: the last one of the arbiter.
        walk: replaced when the robot stands up.
    """

    def __init__(
        self,
        robot: Robot,
        gait: Gait,
        start_rad: FloatArray,
        *,
        period_s: float,
        arbiter: Arbiter,
        recovery: Recovery,
        hold: bool = True,
        level: bool = False,
        failures: Sequence[Failure] = (),
        feet: Feet = "planned",
        policy: Policy | None = None,
        limit_s: float | None = None,
    ) -> None:
        """Stand up from joint angles.

        Args:
            policy: walks in place of the gait, within the ranges of its command.
            limit_s: longest inference of the policy; two longer ones in a row stop it.
        """
        self._policy, self._inference_limit_s = policy, limit_s
        self._robot, self._gait, self._period_s = robot, gait, period_s
        self._arbiter, self._recovery = arbiter, recovery
        self._known, self._feet = tuple(failures), feet
        self._hold = VelocityHold() if hold and policy is None else None
        self._level = level
        self._asked_pose: BodyPose | None = None
        self._asked: FloatArray = np.zeros(3)
        self._news: tuple[str, ...] = ()
        self._moving_steps = max(1, round(SITTING_S / period_s))
        self._sit_asked = False
        self.decision = Decision()
        self._limits = VelocityLimits.of(robot, gait)
        self._temperatures, self._pace, self._warm_said = Temperatures(), 1.0, False
        self._step = self._began = self._updated_step = self._frozen_steps = 0
        self.mode = MODES[0]
        self._sent_rad = start_rad
        self._be("standing up", Stand(robot, start_rad, self._moving_steps))
        self._new_walk()

    @property
    def velocity_body(self) -> FloatArray:  # type: ignore[override]  # of the walk
        """The velocity commanded to the legs now: forward, left in m/s, turn in rad/s, (3,)."""
        return self.walk.velocity_body if self.mode == "driving" else np.zeros(3)

    @property
    def leg_phases(self) -> FloatArray | None:  # type: ignore[override]  # of the walk
        """Normalised times of the legs in the last step, (6,); None while they do not step."""
        return self.walk.leg_phases if self.mode == "driving" else None

    @property
    def leg_suspicion(self) -> FloatArray | None:  # type: ignore[override]  # of the monitor
        """Evidence against each leg, an alarm at 1, (6,)."""
        return self._monitored.leg_suspicion

    @property
    def most(self) -> tuple[float, float, float]:
        """Maximum speeds forward and left in m/s and turn in rad/s, each by itself, on the intact legs."""
        if self._policy is not None:
            forward, left, turn = self._ranges.max(axis=1).tolist()
            return forward, left, turn
        rows = [one.leg for one in self.known_failures()] or [0]
        speeds = self._limits.speeds_m_s[rows].min(axis=0)
        turn_rad_s = float(self._limits.turn_rates_rad_s[rows].min())
        share = float(self.walk.poser.stroke_share)
        return (
            share * float(min(speeds[0], speeds[4])),
            share * float(min(speeds[2], speeds[6])),
            share * turn_rad_s,
        )

    @property
    def level(self) -> bool:
        """Whether the body is kept level; may be set."""
        return self._level

    @level.setter
    def level(self, level: bool) -> None:
        self._level = self.walk.poser.level = level

    @property
    def holds(self) -> bool:
        """Whether slip is corrected; may be set."""
        return self._hold is not None

    @holds.setter
    def holds(self, holds: bool) -> None:
        self._hold = (self._hold or VelocityHold()) if holds else None

    @property
    def pose_share(self) -> float:
        """Share of the commanded body pose that the legs reach."""
        return self.walk.poser.pose_share

    @property
    def at_rest(self) -> bool:
        """Whether no target moves: it stands, sits, or is frozen by a stop."""
        stands = self.mode == "driving" and self.walk.at_rest and self._asked_pose is None
        return self.mode == "sitting" or stands or self.decision.freezes

    def known_failures(self, index: int = 0) -> tuple[Failure, ...]:
        """Given and detected failures, by leg."""
        return self._monitored.known_failures(index)

    @property
    def limited_steps(self) -> NDArray[np.int64] | int:  # type: ignore[override]  # of the walk
        """Steps in which the velocity was reduced to keep feet within reach."""
        return self.walk.limited_steps

    def noticed_failures(self, index: int = 0) -> tuple[NoticedFailure, ...]:
        """Failures detected since it stood up last."""
        return self._monitored.noticed_failures(index)

    def news(self) -> Sequence[str]:
        """Events since the last call."""
        news, self._news = (*self._news, *self._monitored.news(), *self.walk.news()), ()
        return news

    def change_gait(self, gait: Gait) -> None:
        """Walk with another gait from now on; the change is in stride."""
        if gait == self._gait:
            return
        self._limits = VelocityLimits.of(self._robot, gait)
        self._gait = gait
        self.walk.change_gait(self._suited(gait))

    def change_recovery(self, recovery: Recovery) -> None:
        """Respond to legs that fail from now on in another way."""
        self._recovery = recovery
        self._monitored.change_recovery(recovery)

    def stand(self) -> None:
        """Stand up, or step all feet to their places; ends a stop for a failed leg."""
        self._sit_asked = False
        self._monitored.walk_on()
        if self.mode in ("sitting", "sitting down"):
            self._be("standing up", Stand(self._robot, self._sent_rad, self._moving_steps))
            self._known = self.known_failures()
            self._new_walk()
        elif self.mode == "driving":
            self.walk.go_home()
            self._pose(LEVEL)

    def sit(self) -> None:
        """Come to a stand, step the feet to their places, lower the body and stay down."""
        self._sit_asked = True
        self.walk.go_home()
        self._pose(LEVEL)

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, (18,)."""
        self.decision = self._arbiter.decide()
        if self.decision.freezes:
            self._freeze(step)
            return self._sent_rad
        step = self._step = step - self._frozen_steps
        self._take_pace(state, step)
        self._follow_pose()
        if self.mode == "driving":
            self._asked = self._corrected(step, state)
            targets_rad = self._monitored.targets_rad(step - self._began, state)
            if (why := self._monitored.why_stopped()) is not None:
                self._arbiter.stop(why, stands=True)
            if self._sit_asked and self.walk.at_rest and self.walk.home:
                end_rad = sitting_angles_rad(self._robot)
                self._be("sitting down", Stand(self._robot, targets_rad, self._moving_steps, end_rad=end_rad))
        else:
            targets_rad = self._motion.targets_rad(step - self._began, state)
            if step - self._began >= self._moving_steps:
                self._arrive()
        self._sent_rad = targets_rad
        return targets_rad

    def _freeze(self, step: int) -> None:
        """Let no time pass for walk and motions at this step of the clock."""
        self._frozen_steps = step - self._step
        self._follow_pose()
        self.walk.velocity_body = np.zeros(3)  # the next step puts down feet that are in the air
        if self._hold is not None:
            self._hold.forget()

    def _follow_pose(self) -> None:
        """Move to a new pose, once it stands; a stop also stops the body."""
        if self.decision.stopped is not None:
            self._asked_pose = None
            self.walk.poser.give_up_goal()
        elif self._sit_asked:
            self._asked_pose = None
        elif self.decision.pose is not None:
            self._asked_pose = self.decision.pose
        if self.mode == "driving" and self._asked_pose is not None:
            self._pose(self._asked_pose)

    def _pose(self, pose: BodyPose) -> None:
        self._asked_pose = None
        self.walk.pose_body(pose)
        if self.pose_share < 1:
            self._news = (*self._news, f"body pose: the legs reach {self.pose_share:.0%} of it")

    def _corrected(self, step: int, state: RobotState) -> FloatArray:
        desired = self._desired()
        dt_s = (step - self._updated_step) * self._period_s
        self._updated_step = step
        if self._hold is None:
            return desired
        yaw_rad = float(self.walk.poser.poses[2])
        most = np.array(self.most)
        return self._hold.update(dt_s, state, desired, self.walk.velocity_body, most, body_yaw_rad=yaw_rad)

    def _desired(self) -> FloatArray:
        if self._sit_asked or self.decision.stopped is not None:
            return np.zeros(3)
        if self._policy is not None:
            asked = self.decision.velocity.array
            return np.minimum(np.maximum(self._pace * asked, self._ranges[:, 0]), self._ranges[:, 1])
        legs = [one.leg for one in self.known_failures()]
        share = self.walk.poser.stroke_share
        return self._pace * share * self._limits.limited(self.decision.velocity.array / share, legs)

    def _take_pace(self, state: RobotState, step: int) -> None:
        """Walk slower with warm servos, and report it once."""
        if state.servos is None:
            return
        temperatures_c = self._temperatures.take(state.servos.temperatures_c, step * self._period_s)
        before, self._pace = self._pace, pace(temperatures_c)
        if before == 1.0 > self._pace and not self._warm_said:
            self._warm_said = True
            warm = f"{np.nanmax(temperatures_c):.0f} C"
            self._news = (*self._news, f"servos are warm, {warm}: the robot walks slower until they cool")

    def _arrive(self) -> None:
        if self.mode == "standing up":
            self.mode, self._began = "driving", self._step
        elif self.mode == "sitting down":
            self.mode = "sitting"

    def _be(self, mode: str, motion: Controller) -> None:
        self.mode, self._motion, self._began = mode, motion, self._step + 1

    def _new_walk(self) -> None:
        """A walk that begins at rest in the stance; it changes to the posture once it stands."""
        gait = self._suited(self._gait)
        plain = replace(gait, posture=STANCE)
        plan = TrialPlan(gait=plain, failures=self._known, level=self._level, feet=self._feet)
        start = WalkStart(robot=self._robot, plans=(plan,), period_s=self._period_s)
        self.walk = self._made_walk(start)
        self._monitored = MonitoredWalk(start, self.walk, self._recovery)
        if gait != plain:
            self.walk.change_gait(gait)

    def _made_walk(self, start: WalkStart) -> DriveWalk:
        if self._policy is None:
            return DriveWalk(start, lambda: self._asked)
        return PolicyWalk(start, lambda: self._asked, self._policy, limit_s=self._inference_limit_s)

    @property
    def _ranges(self) -> FloatArray:
        """Ranges of the policy's command, (3, 2); one without a command goes ahead at any speed."""
        ranges = None if self._policy is None else self._policy.contract.command_ranges
        return np.array([[0.0, 1.0], [0.0, 0.0], [0.0, 0.0]]) if ranges is None else ranges

    @property
    def own_columns(self) -> tuple[Column, ...]:  # type: ignore[override]  # of the policy
        """Columns of the policy's observation and actions."""
        return self.walk.own_columns

    @property
    def own_values(self) -> Mapping[str, FloatArray]:  # type: ignore[override]  # of the policy
        """Observation and actions of the last step."""
        return self.walk.own_values if self.mode == "driving" else {}

    def _suited(self, gait: Gait) -> Gait:
        """The recovery's gait for the legs without a known failure."""
        if not self._known:
            return gait
        response = self._recovery.respond(self._robot, TrialPlan(gait=gait), 0.0, self._known)
        return gait if response.gait is None else response.gait
