"""What a policy does with a robot: from the stance to its default pose, its walk, and back."""

import math
import time
from array import array
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal

import numpy as np

from hexctl.columns import Column
from hexctl.control.policy.observation import Observer
from hexctl.control.policy.policy import Policy
from hexctl.errors import InputError
from hexctl.robot.model import Robot
from hexctl.robot.plugins import show_traceback
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray, RobotState, joint_in_words

#: Least time from the stance to the default pose, and back.
BLEND_S = 1.0

#: Share of the joints' speed limits in that time.
BLEND_SPEED = 0.25

#: How long a command takes from zero to the end of its range, and a policy walks with the command zero before
#: it returns to the stance.
COMMAND_S, HALT_S = 1.0, 0.6

#: An inference longer than this twice in a row stops a paced walk: it leaves half a period for the servos.
SLOW_S = 0.01

#: Ticks in a row in which an action is at a limit before it is reported.
SATURATED_TICKS = 50

#: Largest difference of a target at a limit.
AT_LIMIT_RAD = 1e-6

Mode = Literal["resting", "starting", "walking", "returning"]


class PolicyMotion:
    """Moves from the stance to the default pose, walks by a policy, and returns to the stance.

    A policy that raises, returns other than 18 finite numbers, misses a measurement or is too slow twice in a
    row gets no further say: the joints return evenly to the stance.

    Attributes:
        mode: what it does now.
        command: velocity that the policy observes, forward, left and turn, (3,).
        trouble: why the policy was stopped, or None.
        inference_s: duration of each inference.
        saturated: ticks in which each joint's action was at a limit, (18,), in hexctl's order.
        values: raw observation and action of the last step, by column; empty while it does not walk.
    """

    def __init__(
        self,
        robot: Robot,
        policy: Policy,
        period_s: float,
        *,
        limit_s: float | None = None,
        now_s: Callable[[], float] = time.perf_counter,
    ) -> None:
        """Prepare a policy for a robot that stands.

        Args:
            limit_s: longest inference; None for a simulation that waits for it.
            now_s: time by which inferences are measured.

        Raises InputError for a policy that observes what the robot does not measure.
        """
        contract = policy.contract
        for term in contract.terms:
            term.check(robot)
        self._robot, self._policy, self._contract = robot, policy, contract
        self._period_s, self._limit_s, self._now_s = period_s, limit_s, now_s
        self._observer = Observer(contract, period_s)
        self.default_rad = default_pose_rad(policy, robot)
        self.mode: Mode = "resting"
        self.command: FloatArray = np.zeros(3)
        self.trouble: str | None = None
        self.inference_s = array("d")
        self.saturated = np.zeros(N_JOINTS, dtype=np.int64)
        self.values: Mapping[str, FloatArray] = {}
        self.columns = policy_columns(policy)
        self._sent_rad = self._blend_rad = robot.stance_angles_rad
        self._last_action: FloatArray = np.zeros(N_JOINTS)
        self._since_step, self._blend_steps, self._halt_steps, self._slow = 0, 1, 0, 0
        self._in_a_row = np.zeros(N_JOINTS, dtype=np.int64)
        self._news: tuple[str, ...] = ()
        self._interrupted = False

    @property
    def return_steps(self) -> int:
        """Maximum number of steps from now until the stance is reached."""
        halt = 0 if self.trouble is not None or not self._can_halt else self._steps(HALT_S)
        return halt + self._blend_length(self._robot.joint_lower_rad, self._robot.joint_upper_rad) + 2

    def news(self) -> Sequence[str]:
        """Events since the last call."""
        news, self._news = self._news, ()
        return news

    def restart(self) -> None:
        """Begin from the last targets again: time has passed without a step."""
        self._interrupted = True

    def targets_rad(self, step: int, state: RobotState, command: FloatArray, *, goes: bool) -> FloatArray:
        """Joint angles at this step, (18,), for a commanded velocity, (3,); unless it goes, to the stance."""
        self._observer.sees(step, state)
        goes = goes and self.trouble is None
        self.values = {}
        if self._interrupted and self.mode != "resting":
            self._return(step)
        self._interrupted = False
        if goes and self.mode in ("resting", "returning"):
            self._blend("starting", step, self.default_rad)
        if self.mode in ("starting", "returning"):
            self._move(step, self.default_rad if self.mode == "starting" else self._robot.stance_angles_rad)
            if not goes and self.mode == "starting":
                self._return(step)
        elif self.mode == "walking":
            self._walk(step, state, command if goes else np.zeros(3), goes=goes)
        return self._sent_rad

    def _walk(self, step: int, state: RobotState, command: FloatArray, *, goes: bool) -> None:
        self._halt_steps = 0 if goes else self._halt_steps + 1
        if not goes and (not self._can_halt or self._halt_steps > self._steps(HALT_S)):
            self._return(step)
            return
        self._follow(command)
        observation = self._observer.observation(
            step, state, command=self.command, last_action=self._last_action, sent_rad=self._sent_rad
        )
        action = self._action(observation)
        if action is None:
            self._news = (*self._news, f"policy stopped: {self.trouble}")
            self._return(step)
            return
        self.values = {"policy_observation": observation, "policy_action": action}
        self._sent_rad = self._targets(action)

    def _action(self, observation: FloatArray) -> FloatArray | None:
        """Checked action of an observation, clipped; None once there is trouble."""
        if self._observer.missing is not None:
            self.trouble = f"{self._observer.missing} is no longer measured"
            return None
        began_s = self._now_s()
        try:
            action = np.asarray(self._policy(observation), dtype=float).reshape(-1)
        except Exception as error:  # noqa: BLE001  whatever it is, the robot is still walking
            show_traceback(error)
            self.trouble = f"{type(error).__name__}: {' '.join(str(error).split())[:160]}".removesuffix(": ")
            return None
        took_s = self._now_s() - began_s
        self.inference_s.append(took_s)
        self.trouble = self._wrong(action) or self._too_slow(took_s)
        if self.trouble is not None:
            return None
        if (clip := self._contract.action_clip) is not None:
            action = np.minimum(np.maximum(action, clip[:, 0]), clip[:, 1])
        self._last_action = action
        return action

    def _wrong(self, action: FloatArray) -> str | None:
        if action.shape != (N_JOINTS,):
            return f"{action.size} actions, not {N_JOINTS}"
        if not np.isfinite(action).all():
            place = int(np.argmin(np.isfinite(action)))
            return f"action {action[place]} for {joint_in_words(self._contract.joints[place])}"
        return None

    def _too_slow(self, took_s: float) -> str | None:
        self._slow = self._slow + 1 if self._limit_s is not None and took_s > self._limit_s else 0
        if self._slow < 2:
            return None
        return f"two inferences in a row took more than {1000 * (self._limit_s or 0):g} ms"

    def _targets(self, action: FloatArray) -> FloatArray:
        contract, robot = self._contract, self._robot
        own_rad = contract.action_scale * action + contract.action_offset_rad
        bounded_rad, at_limit = own_rad, np.zeros(N_JOINTS, dtype=bool)
        if (clip := contract.action_clip) is not None:
            at_limit |= (action <= clip[:, 0]) | (action >= clip[:, 1])
        if (bounds := contract.target_clip_rad) is not None:
            bounded_rad = np.minimum(np.maximum(own_rad, bounds[:, 0]), bounds[:, 1])
            at_limit |= bounded_rad != own_rad
        targets_rad = contract.joints_rad(bounded_rad)
        saturated = np.zeros(N_JOINTS, dtype=bool)
        saturated[list(contract.joints)] = at_limit
        saturated |= targets_rad > robot.joint_upper_rad + AT_LIMIT_RAD
        saturated |= targets_rad < robot.joint_lower_rad - AT_LIMIT_RAD
        self._watch(saturated)
        return targets_rad

    def _watch(self, saturated: Any) -> None:
        self.saturated += saturated
        self._in_a_row = (self._in_a_row + 1) * saturated
        for joint in np.flatnonzero(self._in_a_row == SATURATED_TICKS).tolist():
            lasted = SATURATED_TICKS * self._period_s
            self._news = (*self._news, f"policy: {joint_in_words(joint)} at its limit for {lasted:g} s")

    def _follow(self, command: FloatArray) -> None:
        """Let the command move towards the requested one, within its ranges."""
        ranges = self._contract.command_ranges
        if ranges is None:
            return
        wanted = np.minimum(np.maximum(command, ranges[:, 0]), ranges[:, 1])
        most = np.abs(ranges).max(axis=1) * self._period_s / COMMAND_S
        self.command = self.command + np.minimum(np.maximum(wanted - self.command, -most), most)

    @property
    def _can_halt(self) -> bool:
        ranges = self._contract.command_ranges
        return ranges is not None and bool(((ranges[:, 0] <= 0) & (ranges[:, 1] >= 0)).all())

    def _return(self, step: int) -> None:
        self.command = np.zeros(3)
        self._blend("returning", step, self._robot.stance_angles_rad)

    def _blend(self, mode: Mode, step: int, end_rad: FloatArray) -> None:
        self.mode, self._since_step, self._blend_rad = mode, step, self._sent_rad
        self._blend_steps = self._blend_length(self._sent_rad, end_rad)

    def _move(self, step: int, end_rad: FloatArray) -> None:
        share = min(1.0, (step - self._since_step) / self._blend_steps)
        self._sent_rad = (1 - share) * self._blend_rad + share * end_rad
        if share < 1:
            return
        if self.mode == "returning":
            self.mode = "resting"
            return
        self.mode, self.command = "walking", np.zeros(3)
        self._last_action = np.zeros(N_JOINTS)
        self._observer.begin(step + 1)

    def _blend_length(self, start_rad: FloatArray, end_rad: FloatArray) -> int:
        speed = BLEND_SPEED * self._robot.joint_max_speed_rad_s
        return self._steps(max(BLEND_S, float((np.abs(end_rad - start_rad) / speed).max())))

    def _steps(self, duration_s: float) -> int:
        return max(1, math.ceil(duration_s / self._period_s - 1e-9))


def default_pose_rad(policy: Policy, robot: Robot) -> FloatArray:
    """Default pose of a policy as joint angles of hexctl, (18,); raises InputError beyond a joint's range."""
    pose_rad = policy.contract.joints_rad(policy.contract.default_rad)
    outside = (pose_rad < robot.joint_lower_rad) | (pose_rad > robot.joint_upper_rad)
    if outside.any():
        joint = int(np.argmax(outside))
        low, high = (
            math.degrees(float(ends[joint])) for ends in (robot.joint_lower_rad, robot.joint_upper_rad)
        )
        raise InputError(
            f"policy: the default pose has {math.degrees(float(pose_rad[joint])):.1f} degrees for "
            f"{joint_in_words(joint)} of {robot.name}; allowed: {low:.1f} to {high:.1f}; check the order, "
            "the directions and the zeros of its joints"
        )
    return pose_rad


def policy_columns(policy: Policy) -> tuple[Column, ...]:
    """Columns of a log for the raw observation, and the raw actions of the joints in hexctl's names."""
    names = policy.contract.observation_names
    joints = tuple(JOINT_NAMES[joint] for joint in policy.contract.joints)
    return (
        Column(
            "policy_observation",
            (len(names),),
            parts=names,
            table="policy_observation_{}",
            entity="policy/observation",
            title="observation of the policy",
            bits=FINE,
        ),
        Column(
            "policy_action",
            (N_JOINTS,),
            parts=joints,
            table="policy_action_{}",
            entity="policy/action",
            title="raw actions of the policy",
            bits=FINE,
        ),
    )


#: Binary places of recorded observations and actions.
FINE = 20
