"""Self-rotation: turn in place until the failed leg points where it disturbs least."""

import math
from collections.abc import Callable

from hexctl.control.controller import Walk
from hexctl.control.plan import TrialPlan
from hexctl.gait.gait import Gait, Motion, half_amplitude_turn_rate_rad_s
from hexctl.gait.named import make_gait
from hexctl.gait.ramp import RAMP_DURATION_S
from hexctl.robot.messages import RobotState
from hexctl.robot.model import Robot
from hexctl.robot.rotation import wrapped_rad, yaw_rad

#: Not worth turning for; the walk's heading makes up for what is left.
CLOSE_ENOUGH_RAD = math.radians(2.0)

#: A failed leg slows the turn; after this many times the ideal time the robot walks from where it is.
PATIENCE = 4.0


def turn_gait(robot: Robot) -> Gait:
    """Return the one gait that every self-rotation uses, so that all codes start from one state."""
    return make_gait(robot, "demo")


def turn_needed_rad(robot: Robot, plan: TrialPlan) -> float:
    """Return how far to turn, counter-clockwise positive, before the walk of a plan."""
    if plan.failure is None or plan.self_rotation == "none":
        return 0.0
    wanted_rad = plan.heading_rad + (math.pi if plan.self_rotation == "rear" else 0.0)
    turn_rad = wrapped_rad(wanted_rad - float(robot.leg_azimuths_rad[plan.failure.leg - 1]))
    # Half a turn goes either way; rounding must not choose.
    return abs(turn_rad) if abs(turn_rad) > math.pi - 1e-6 else turn_rad


class Turn:
    """A turn in place by an angle, measured on the robot's own yaw.

    It begins its soft stop when what is left is what the stop will still turn: half of what the last gait
    cycle's mean rate makes in the time of the ramp.
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
        gait = turn_gait(robot)
        rate_rad_s = math.copysign(half_amplitude_turn_rate_rad_s(robot, gait), turn_rad)
        motion = Motion(travel=0.0, turn_rate_rad_s=rate_rad_s)
        self.controller = Walk(robot, gait, motion, period_s=period_s, held_legs=plan.held_legs)
        self._turn_rad = turn_rad
        self._stop_requested = stop_requested
        self._cycle_ticks = round(1 / (gait.pace_hz * period_s))
        self._period_s = period_s
        self._last_yaw_rad = start_yaw_rad
        self._turned_rad = [0.0]
        self._patience_ticks = round(PATIENCE * (RAMP_DURATION_S + turn_rad / rate_rad_s) / period_s)
        self._stopped_at: int | None = None

    def until(self, step: int, state: RobotState) -> bool:
        """Watch the yaw, begin the stop in time, and return True when the robot stands again."""
        if state.base_quaternion_world is not None:
            yaw = float(yaw_rad(state.base_quaternion_world))
            self._turned_rad.append(self._turned_rad[-1] + wrapped_rad(yaw - self._last_yaw_rad))
            self._last_yaw_rad = yaw
        enough = self._near() or step >= self._patience_ticks or self._stop_requested()
        if self._stopped_at is None and enough:
            self._stopped_at = step
            self.controller.stop(step)
        return self._stopped_at is not None and step >= self._stopped_at + self.controller.stopping_ticks

    def _near(self) -> bool:
        turned = self._turned_rad
        back = min(self._cycle_ticks, len(turned) - 1)
        rate_rad_s = (turned[-1] - turned[-1 - back]) / max(1, back) / self._period_s
        left_rad = self._turn_rad - turned[-1] - rate_rad_s * RAMP_DURATION_S / 2
        return left_rad * math.copysign(1.0, self._turn_rad) <= 0
