"""A square of four sides of 1 m with a dead leg, each side a line that the walk holds.

The body keeps its heading: a hexapod walks in any direction. Run it with `python examples/square.py`.
"""

import math

import numpy as np

from hexctl import Failure, Guard, RobotState, SimServos, TrialPlan, World, load_robot, make_gait, run_trial
from hexctl.control.planning.crawl import auto_gait
from hexctl.control.walks.steered_walk import SteeredWalk
from hexctl.control.walks.steering import Course
from hexctl.control.walks.velocity_walk import FULL_SPEED_S, RESPONSE_S
from hexctl.extension import WalkStart
from hexctl.gait.foot_trajectory import RAMP_DURATION_S

SIDE_M = 1.0

#: How long the velocity takes to turn a corner.
TURNING_S = RESPONSE_S + FULL_SPEED_S / 2


class Square(SteeredWalk):
    """Walks along the four sides of a square, to the left, and is done where it began."""

    def __init__(self, start: WalkStart) -> None:
        super().__init__(start)
        frame = start.frame
        assert frame is not None
        corner = frame.origin_world[:2]
        self._courses = []
        for side in range(4):
            heading_rad = frame.heading_rad + side * math.pi / 2
            self._courses.append(Course(origin_world=corner, heading_rad=heading_rad, yaw_rad=frame.yaw_rad))
            corner = corner + SIDE_M * np.array([math.cos(heading_rad), math.sin(heading_rad)])
        self._side = 0
        self._half_way: tuple[int, float] | None = None

    def done(self, step: int, state: RobotState) -> bool:
        """Whether the last side is walked; goes on to the next side before the end of each."""
        if state.base_position_world is not None and self._side < 4:
            course = self._courses[self._side]
            along = np.array([math.cos(course.heading_rad), math.sin(course.heading_rad)])
            left_m = SIDE_M - float((state.base_position_world[:2] - course.origin_world) @ along)
            if self._half_way is None and left_m <= SIDE_M / 2:
                self._half_way = step, left_m
            if self._half_way is not None and left_m <= self._lead_m(step, left_m):
                self._side, self._half_way = self._side + 1, None
                if self._side < 4:
                    self.follow(self._courses[self._side])
        return self._side == 4 or super().done(step, state)

    def _lead_m(self, step: int, left_m: float) -> float:
        """How far before its end a side is left, at the speed made since half way.

        The velocity takes about half a second to turn a corner, and the soft stop half of its duration.
        """
        assert self._half_way is not None
        since, before_m = self._half_way
        speed_m_s = (before_m - left_m) / max(1, step - since) / self._period_s
        return speed_m_s * (RAMP_DURATION_S / 2 if self._side == 3 else TURNING_S)


def walk_square(failure: Failure | None, *, robot_name: str = "ant", world: World | None = None) -> float:
    """Distance in m between the start of a square and where the robot stands when it is done."""
    robot = load_robot(robot_name)
    plan = TrialPlan(
        gait=make_gait(robot, "demo"),
        failures=() if failure is None else (failure,),
        self_rotation="none",
        hold="line",
        duration_s=120.0,
    )
    plan = TrialPlan(
        gait=auto_gait(robot, plan),
        failures=() if failure is None else (failure,),
        self_rotation="none",
        hold="line",
        duration_s=120.0,
    )
    with Guard(SimServos(robot, world=world, failures=failure)) as guard:
        run_trial(guard, plan, Square)
        position = guard.read().base_position_world
    assert position is not None
    return float(np.linalg.norm(position[:2]))


if __name__ == "__main__":
    for leg in (1, 3):
        print(f"leg {leg} locked: closes within {100 * walk_square(Failure(leg=leg)):.1f} cm")
