"""Self-rotation: turn in place until the failed leg points where it disturbs least."""

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

#: A self-rotation ends within this of its goal, or the noise of the measured yaw. One degree of miss moves
#: the end of a 30 s walk by 8 to 14 cm; the walk's heading makes up for what is left.
TURN_WITHIN_RAD = math.radians(0.03)

#: Turns up to this are made of small steps alone.
SMALL_TURN_RAD = math.radians(4.0)

#: Small steps that a self-rotation may take to its goal.
MAX_TURN_STEPS = 6

#: A failed leg slows the turn; after this many times the ideal time the robot walks from where it is.
TIMEOUT_FACTOR = 4.0

#: Share of the commanded rate that robots make, until this one has shown its own.
USUAL_SHARE = 0.85

#: Share of a small step's angle that robots make, and angle that they turn besides; how these differ between
#: robots, and from step to step.
USUAL_STEP = np.array([0.65, 0.0])
STEP_SPREAD = np.array([0.15, math.radians(0.1)])
STEP_NOISE_RAD = math.radians(0.02)
LEAST_SHARE = 0.2

#: Where more than this is expected of a step and less than this share of it comes, friction that the robot
#: file does not have swallowed this part of the step.
SMALLEST_STEP_RAD = math.radians(0.1)
LOST_SHARE = 0.15
LOST_PART = 0.9

#: Commanded angle that dry friction swallows, as a multiple of the joint angle at which a servo overcomes it.
#: Measured on `phantomx`: of 3.8 degrees, at a joint angle of 1.6, less than 0.1 degree comes.
FRICTION_FACTOR = 2.4

#: A self-rotation is expected to end this near to its goal.
TURN_TOLERANCE_RAD = math.radians(5.0)


def turn_gait(robot: Robot) -> Gait:
    """The gait of every self-rotation; there is one, so that all codes start from one state."""
    return make_gait(robot, "demo")


def turn_needed_rad(robot: Robot, plan: TrialPlan) -> float:
    """Angle to turn before the walk of a plan, counter-clockwise positive."""
    if plan.turn_rad is not None:
        return plan.turn_rad
    if plan.belief is None or plan.further_failures or plan.self_rotation == "none":
        return 0.0
    wanted_rad = plan.heading_rad + (math.pi if plan.self_rotation == "rear" else 0.0)
    turn_rad = wrapped_rad(wanted_rad - failed_foot_azimuth_rad(robot, plan.belief))
    # Half a turn goes either way; rounding must not choose.
    return abs(turn_rad) if abs(turn_rad) > math.pi - 1e-6 else turn_rad


def failed_foot_azimuth_rad(robot: Robot, failure: Failure) -> float:
    """Direction of the foot of a failed leg from the body's vertical axis.

    That of its stance; of a leg with a jammed joint, the one in which the jam puts the foot while the other
    two joints are in the stance.
    """
    if failure.kind != "stuck":
        return float(robot.leg_azimuths_rad[failure.leg - 1])
    joints_rad = robot.stance_angles_rad.copy()
    joints_rad[failure.joint_index] = failure.angle_rad
    x, y, _ = foot_positions_body(robot, joints_rad)[failure.leg - 1].tolist()
    return math.atan2(y, x)


def turn_motion(robot: Robot, turn_rad: float) -> Motion:
    """Motion of a self-rotation: in place, at the rate of half the step amplitude."""
    rate_rad_s = math.copysign(half_amplitude_turn_rate_rad_s(robot, turn_gait(robot)), turn_rad)
    return Motion(travel=0.0, turn_rate_rad_s=rate_rad_s)


def check_plan(robot: Robot, plan: TrialPlan) -> None:
    """Raise ReachError or LimitError, naming leg and joint, for a plan that the legs cannot carry out.

    A self-rotation ends near its goal, not on it, so the walk is checked a little to both sides.
    """
    turn_rad = turn_needed_rad(robot, plan)
    gaits = (plan.gait, *(change.gait for change in plan.changes))
    for gait in gaits:
        check_walk(robot, gait, plan.motion(turn_rad))
    if turn_rad:
        for way_rad in (-turn_rad, turn_rad):  # the small steps at its end go either way
            check_walk(robot, turn_gait(robot), turn_motion(robot, way_rad))
        for off_rad in (-TURN_TOLERANCE_RAD, TURN_TOLERANCE_RAD):
            for gait in gaits:
                check_walk(robot, gait, plan.motion(turn_rad + off_rad))


class Turn(Controller):
    """A turn in place by an angle, measured on the robot's own yaw.

    Its soft stop begins when the remaining angle is what the stop itself will turn. That angle is predicted
    from the commanded rate and the share of it that the robot has made so far; the difference of two
    measurements would drown in noise.
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
        """Whether the robot stands again; follows the yaw and begins the stop in time."""
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
        # Time at full rate that is worth as much as the ramp so far, and as the ramp down from here.
        commanded_s = time_s - RAMP_DURATION_S * (envelope - envelope**2 / 2)
        stopping_s = RAMP_DURATION_S * envelope**2 / 2
        made = USUAL_SHARE
        if time_s > RAMP_DURATION_S + self._cycle_s:
            made = min(1.2, max(0.2, self._turned_rad / (self._rate_rad_s * commanded_s)))
        return self._turned_rad + made * self._rate_rad_s * stopping_s >= self._goal_rad


class TurnStep(Controller):
    """A small turn in place: one gait cycle, softly begun and ended, that sets every foot down anew.

    Args:
        robot: who turns.
        plan: its held legs stay in their stance pose.
        turn_rad: commanded angle, counter-clockwise positive; no more than the legs can turn in the time.
        period_s: control period.
    """

    def __init__(self, robot: Robot, plan: TrialPlan, turn_rad: float, period_s: float) -> None:
        gait = turn_gait(robot)
        self._stop_step = round(1 / (gait.pace_hz * period_s))
        walked_s = self._stop_step * period_s
        # The integral of the ramp up and down again.
        full_s = walked_s * min(1.0, walked_s / RAMP_DURATION_S)
        most_rad_s = half_amplitude_turn_rate_rad_s(robot, gait)
        rate_rad_s = min(most_rad_s, max(-most_rad_s, turn_rad / full_s))
        #: The angle commanded, where the legs cannot turn as far as wanted less.
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
    """Commanded angle of a small step of which nothing comes, by the dry friction of the robot's coxae."""
    off_rad = robot.dry_friction_nm[::JOINTS_PER_LEG] / robot.stiffness_nm_per_rad[::JOINTS_PER_LEG]
    return FRICTION_FACTOR * float(off_rad.max())


class TurnSteps:
    """How far to command each small step: a robot makes a share of an angle, and a dead leg turns it besides.

    turned = share * (commanded - swallowed) + besides. Dry friction swallows the beginning of every step: a
    servo of stiffness k turns its joint only when it is friction / k off. Share and besides are estimated by
    least squares over the steps so far, with what robots usually do as a prior.

    Args:
        swallowed_rad: commanded angle of which nothing comes, as `swallowed_rad` has it for a robot.
    """

    def __init__(self, swallowed_rad: float = 0.0) -> None:
        self._swallowed_rad = swallowed_rad
        self._precision = np.diag(1 / STEP_SPREAD**2)
        self._weighted = self._precision @ USUAL_STEP

    def command_rad(self, missing_rad: float) -> float:
        """The angle to command for one that is missing."""
        share, besides_rad = self._estimate()
        effective_rad = (missing_rad - besides_rad) / max(LEAST_SHARE, share)
        return float(effective_rad + math.copysign(self._swallowed_rad, effective_rad))

    def learn(self, commanded_rad: float, turned_rad: float) -> None:
        """Take in what a step made of its command."""
        effective_rad = math.copysign(max(0.0, abs(commanded_rad) - self._swallowed_rad), commanded_rad)
        sign = math.copysign(1.0, commanded_rad)
        share, besides_rad = self._estimate()
        expected_rad = share * abs(effective_rad) + sign * besides_rad
        if self._corrects_swallowed(abs(effective_rad), expected_rad, sign * turned_rad):
            return
        row = np.array([effective_rad, 1.0]) / STEP_NOISE_RAD
        self._precision += np.outer(row, row)
        self._weighted += row * (turned_rad / STEP_NOISE_RAD)

    def _estimate(self) -> list[float]:
        """Share and besides in rad, by the steps so far."""
        estimate: list[float] = np.linalg.solve(self._precision, self._weighted).tolist()
        return estimate

    def _corrects_swallowed(self, effective_rad: float, expected_rad: float, turned_rad: float) -> bool:
        """Whether a step shows that friction swallows more, or less, than believed; believe it then.

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
