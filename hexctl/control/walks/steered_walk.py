"""A walk steered along the line of its trial."""

from collections.abc import Sequence

from hexctl.control.preparation import WalkStart
from hexctl.control.walks.dead_reckoning import DeadReckoning
from hexctl.control.walks.steering import Course, CourseHold
from hexctl.control.walks.velocity_walk import VelocityWalk
from hexctl.errors import InputError
from hexctl.gait.gait import Gait, half_amplitude_turn_rate_rad_s, ideal_speed_m_s
from hexctl.types import BoolArray, FloatArray, RobotState


class SteeredWalk(VelocityWalk):
    """Walks along the line of the trial, its course corrected at every tick; `heading` ignores positions."""

    def __init__(self, start: WalkStart, *, hold: str = "line") -> None:
        frame = start.frame
        if frame is None:
            raise InputError("steering: got a robot without a pose; allowed: one that knows position and yaw")
        super().__init__(start)
        self.hold, self._plans = hold, start.plans
        self._law = CourseHold(
            Course(
                origin_world=frame.origin_world[..., :2], heading_rad=frame.heading_rad, yaw_rad=frame.yaw_rad
            ),
            **self._pace_of([plan.gait for plan in start.plans]),
            hold=hold,
            trim_rad=self._each([plan.trim_rad for plan in start.plans]),
            dead_reckoning=(
                DeadReckoning(start.robot, self._shape, start.period_s) if hold == "heading" else None
            ),
        )
        self.velocity_body = self._law.velocity_body

    def follow(self, course: Course) -> None:
        """Follow another line from the next step on; the velocity turns as fast as it may change."""
        self._law.follow(course)

    def desired(self, dt_s: float, step: int, state: RobotState) -> FloatArray:
        """Velocity of the steering law, leading shape + (3,)."""
        return self._law.update(dt_s, state)

    def glide_to(self, gaits: Gait | Sequence[Gait], which: BoolArray | None = None) -> None:
        """Change to other gaits in stride; the course stays."""
        super().glide_to(gaits, which)
        self._law.retune(**self._pace_of(self.gaits), which=which)

    def _pace_of(self, gaits: Sequence[Gait]) -> dict[str, FloatArray]:
        robot, each = self._robot, self._each
        ways = [plan.motion(0.0) for plan in self._plans]
        return {
            "speed_m_s": each([ideal_speed_m_s(robot, *one) for one in zip(gaits, ways, strict=True)]),
            "cycle_s": each([1 / gait.pace_hz for gait in gaits]),
            "stride_m": each([gait.strokes_per_cycle * gait.amplitude * robot.size_m for gait in gaits]),
            "most_turn_rad_s": each([half_amplitude_turn_rate_rad_s(robot, gait) for gait in gaits]),
        }
