"""Self-rotation: turn in place until the failed leg disturbs least."""

import math
from collections.abc import Callable

import numpy as np

from hexctl.control.controllers import Controller, Walk, check_walk, soft_stop_steps
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.gait.gait import Gait, Motion, half_amplitude_turn_rate_rad_s, make_gait
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.types import JOINTS_PER_LEG, FloatArray, RobotState

#: Tolerance of a self-rotation, or the noise of the measured yaw. A miss of one degree moves the end of a 30
#: s walk by 8 to 14 cm; the walk's heading compensates the rest.
TURN_WITHIN_RAD = math.radians(0.03)

#: Turns up to this are made of only small steps.
SMALL_TURN_RAD = math.radians(4.0)

MAX_TURN_STEPS = 6

#: A failed leg slows the turn; after this multiple of the ideal time the robot starts to walk.
TIMEOUT_FACTOR = 4.0

#: Initial estimate of the made share of the commanded rate.
USUAL_SHARE = 0.85

#: Prior for small steps: made share and additional turn, their spread between robots, and the noise of a
#: step.
USUAL_STEP = np.array([0.65, 0.0])
STEP_SPREAD = np.array([0.15, math.radians(0.1)])
STEP_NOISE_RAD = math.radians(0.02)
LEAST_SHARE = 0.2

#: If a step over this angle turns less than `LOST_SHARE` of it, friction swallowed `LOST_PART`.
SMALLEST_STEP_RAD = math.radians(0.1)
LOST_SHARE = 0.15
LOST_PART = 0.9

#: Commanded angle that dry friction swallows, as a multiple of the joint angle at which a servo overcomes it.
#: Measured on `phantomx`: of 3.8 degrees, at a joint angle of 1.6, less than 0.1 degree is turned.
FRICTION_FACTOR = 2.4

#: A self-rotation is expected to end this near to its goal.
TURN_TOLERANCE_RAD = math.radians(5.0)


def turn_gait(robot: Robot) -> Gait:
    """The gait of every self-rotation: a single one, for a common start of all codes."""
    return make_gait(robot, "demo")


def turn_needed_rad(robot: Robot, plan: TrialPlan) -> float:
    """Angle to turn before the walk of a plan, counter-clockwise positive."""
    if plan.turn_rad is not None:
        return plan.turn_rad
    if len(plan.failures) != 1 or plan.self_rotation == "none":
        return 0.0
    requested_rad = plan.heading_rad + (math.pi if plan.self_rotation == "rear" else 0.0)
    turn_rad = wrapped_rad(requested_rad - failed_foot_azimuth_rad(robot, plan.failures[0]))
    # Half a turn may go either way; rounding must not decide.
    return abs(turn_rad) if abs(turn_rad) > math.pi - 1e-6 else turn_rad


def body_heading_rad(robot: Robot, plan: TrialPlan) -> float:
    """Direction of travel in the body frame after the self-rotation of a plan."""
    return plan.heading_rad - turn_needed_rad(robot, plan)


def failed_foot_azimuth_rad(robot: Robot, failure: Failure) -> float:
    """Direction of the foot of a failed leg in the stance, with the angle of a jammed joint."""
    if failure.kind != "stuck":
        return float(robot.leg_azimuths_rad[failure.leg - 1])
    joints_rad = robot.stance_angles_rad.copy()
    joints_rad[failure.joint_index] = failure.angle_rad
    x, y, _ = foot_positions_body(robot, joints_rad)[failure.leg - 1].tolist()
    return math.atan2(y, x)


def turn_motion(robot: Robot, turn_rad: float) -> Motion:
    """Motion of a self-rotation: in place, at the rate of half the amplitude."""
    rate_rad_s = math.copysign(half_amplitude_turn_rate_rad_s(robot, turn_gait(robot)), turn_rad)
    return Motion(travel=0.0, turn_rate_rad_s=rate_rad_s)


def check_plan(robot: Robot, plan: TrialPlan) -> None:
    """Raise ReachError or LimitError, naming leg and joint, for a plan that the legs cannot carry out.

    A self-rotation ends near its goal: the walk is checked a little to both sides.
    """
    turn_rad = turn_needed_rad(robot, plan)
    gaits = (plan.gait, *(change.gait for change in plan.changes))
    for gait in gaits:
        check_walk(robot, gait, plan.motion(turn_rad))
    if turn_rad:
        for way_rad in (-turn_rad, turn_rad):  # the small steps at its end turn either way
            check_walk(robot, turn_gait(robot), turn_motion(robot, way_rad))
        for off_rad in (-TURN_TOLERANCE_RAD, TURN_TOLERANCE_RAD):
            for gait in gaits:
                check_walk(robot, gait, plan.motion(turn_rad + off_rad))


class Turn(Controller):
    """A turn in place by an angle, measured by the robot's yaw.

    The soft stop begins when it will turn the remaining angle, as predicted from the made share of the rate.
    """

    def __init__(
        self,
        robot: Robot,
        plan: TrialPlan,
        turn_rad: float,
        start_yaw_rad: float,
        period_s: float,
        stop_requested: Callable[[], bool],
    ) -> None:
        gait, motion = turn_gait(robot), turn_motion(robot, turn_rad)
        self._walk = Walk(robot, gait, motion, period_s=period_s, held_legs=plan.held_legs)
        self._sign = math.copysign(1.0, turn_rad)
        self._goal_rad = abs(turn_rad)
        self._rate_rad_s = abs(motion.turn_rate_rad_s)
        self._stop_requested = stop_requested
        self._cycle_s = 1 / gait.pace_hz
        self._period_s = period_s
        self._last_yaw_rad = start_yaw_rad
        self._turned_rad = 0.0
        self._timeout_s = TIMEOUT_FACTOR * (RAMP_DURATION_S + self._goal_rad / self._rate_rad_s)
        self._stopped_at: int | None = None
        #: Whether the goal was not reached in time.
        self.timed_out = False

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles of the turning gait, (18,)."""
        return self._walk.targets_rad(step, state)

    def stop(self, step: int) -> int:
        """Begin the soft stop; the steps that it takes."""
        if self._stopped_at is None:
            self._stopped_at = step
        return self._walk.stop(step)

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the robot stands again; also updates the yaw and begins the stop."""
        if state.base_quaternion_world is not None:
            yaw = float(yaw_rad(state.base_quaternion_world))
            self._turned_rad += self._sign * wrapped_rad(yaw - self._last_yaw_rad)
            self._last_yaw_rad = yaw
        time_s = step * self._period_s
        if self._stopped_at is None and time_s >= self._timeout_s:
            self.timed_out = True
        if self._near(time_s) or self.timed_out or self._stop_requested():
            self.stop(step)
        return self._stopped_at is not None and step >= self._stopped_at + soft_stop_steps(self._period_s)

    def _near(self, time_s: float) -> bool:
        """Whether a stop that begins now ends at the goal or past it."""
        envelope = min(1.0, time_s / RAMP_DURATION_S)
        # Equivalent times at full rate of the ramp so far, and of the ramp down from here.
        commanded_s = time_s - RAMP_DURATION_S * (envelope - envelope**2 / 2)
        stopping_s = RAMP_DURATION_S * envelope**2 / 2
        made = USUAL_SHARE
        if time_s > RAMP_DURATION_S + self._cycle_s:
            made = min(1.2, max(0.2, self._turned_rad / (self._rate_rad_s * commanded_s)))
        return self._turned_rad + made * self._rate_rad_s * stopping_s >= self._goal_rad


class TurnStep(Controller):
    """A small turn in place: one gait cycle that places every foot again; positive is counter-clockwise."""

    def __init__(self, robot: Robot, plan: TrialPlan, turn_rad: float, period_s: float) -> None:
        gait = turn_gait(robot)
        self._stop_step = round(1 / (gait.pace_hz * period_s))
        walked_s = self._stop_step * period_s
        # The integral of the ramp up and down again.
        full_s = walked_s * min(1.0, walked_s / RAMP_DURATION_S)
        most_rad_s = half_amplitude_turn_rate_rad_s(robot, gait)
        rate_rad_s = min(most_rad_s, max(-most_rad_s, turn_rad / full_s))
        #: The commanded angle within the limits of the legs.
        self.commanded_rad = rate_rad_s * full_s
        motion = Motion(travel=0.0, turn_rate_rad_s=rate_rad_s)
        self._walk = Walk(robot, gait, motion, period_s=period_s, held_legs=plan.held_legs)
        self._walk.stop(self._stop_step)

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles of the turning gait, (18,)."""
        return self._walk.targets_rad(step, state)

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the robot stands again."""
        return self._walk.done(step, state)


def swallowed_rad(robot: Robot) -> float:
    """Commanded angle of a small step that the dry friction of the coxae swallows."""
    off_rad = robot.dry_friction_nm[::JOINTS_PER_LEG] / robot.stiffness_nm_per_rad[::JOINTS_PER_LEG]
    return FRICTION_FACTOR * float(off_rad.max())


class TurnSteps:
    """Commands for small steps: turned = share * (commanded - swallowed) + besides.

    Dry friction swallows the beginning: a servo of stiffness k turns its joint only when it is friction / k
    off. Share, and besides from a dead leg, are least-squares estimates with a prior.
    """

    def __init__(self, swallowed_rad: float = 0.0) -> None:
        self._swallowed_rad = swallowed_rad
        self._precision = np.diag(1 / STEP_SPREAD**2)
        self._weighted = self._precision @ USUAL_STEP

    def command_rad(self, missing_rad: float) -> float:
        """The angle to command for a missing one."""
        share, extra_rad = self._estimate()
        effective_rad = (missing_rad - extra_rad) / max(LEAST_SHARE, share)
        return float(effective_rad + math.copysign(self._swallowed_rad, effective_rad))

    def learn(self, commanded_rad: float, turned_rad: float) -> None:
        """Learn from a step."""
        effective_rad = math.copysign(max(0.0, abs(commanded_rad) - self._swallowed_rad), commanded_rad)
        sign = math.copysign(1.0, commanded_rad)
        share, extra_rad = self._estimate()
        expected_rad = share * abs(effective_rad) + sign * extra_rad
        if self._corrects_swallowed(abs(effective_rad), expected_rad, sign * turned_rad):
            return
        row = np.array([effective_rad, 1.0]) / STEP_NOISE_RAD
        self._precision += np.outer(row, row)
        self._weighted += row * (turned_rad / STEP_NOISE_RAD)

    def _estimate(self) -> list[float]:
        estimate: list[float] = np.linalg.solve(self._precision, self._weighted).tolist()
        return estimate

    def _corrects_swallowed(self, effective_rad: float, expected_rad: float, turned_rad: float) -> bool:
        """Whether a step shows another swallowed angle, which is then updated.

        All angles are positive in the direction of the command. No robot turns further than commanded.
        """
        if expected_rad > SMALLEST_STEP_RAD and turned_rad < LOST_SHARE * expected_rad:
            self._swallowed_rad += LOST_PART * effective_rad
            return True
        if self._swallowed_rad and turned_rad > effective_rad + SMALLEST_STEP_RAD:
            too_much_rad = turned_rad / float(USUAL_STEP[0]) - effective_rad
            self._swallowed_rad = max(0.0, self._swallowed_rad - too_much_rad)
            return True
        return False
