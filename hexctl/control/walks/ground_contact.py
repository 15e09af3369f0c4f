"""Feet that search for the ground below where their gait has it.

Each foot has a height d over the trajectory of its gait:

    rising    d falls to 0 at the top, so that the next step is as high as the others
    falling   d = 0; after a rise that was stopped, d moves to 0 at the speed V
    standing  d moves to g at the speed V

The goal g is as deep as the leg reaches, at most `DEPTH`, until the foot meets the ground; then it is
min(d + G, 0). By the gap G a foot hangs over an even floor, too, until the robot leans on it: there d stays
near 0.

A foot that searched in its last `MISSES` stances and met nothing may have a dead sensor: its d moves to 0 at
the speed V and stays there, until its contact closes.
"""

import numpy as np

from hexctl.errors import argument
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, BoolArray, FloatArray, RobotState

#: Gap G of an even floor, and deepest search, in standing heights.
GAP, DEPTH = 0.04, 0.4

#: Speed V of a search, in standing heights per second.
SPEED_PER_S = 1.0

#: A search begins this long after the swing, if the foot is no more than this above its target, in standing
#: heights: servos are late.
WAIT_S, ARRIVED = 0.08, 0.03

#: Stances of a foot in a row with a search but no contact, after which it searches no more.
MISSES = 3

#: Share of its length to which a leg stretches.
STRETCH = 0.97

#: Minimum step height on uneven ground, as a fraction of the robot's size.
UNEVEN_HEIGHT = 0.04

_UNKNOWN = -np.inf

#: Steps lower than this do not count as a rise.
_LEAST_TOP_M = 1e-6


def step_height(robot: Robot, feet: str) -> float:
    """Step height of a walk with `planned` or `adaptive` feet, as a fraction of the robot's size."""
    return max(robot.gait.height, UNEVEN_HEIGHT) if feet == "adaptive" else robot.gait.height


def contact_notes(feet: str, state: RobotState) -> list[str]:
    """A note if `adaptive` feet have no effect, because the robot reports no contacts."""
    if feet != "adaptive" or state.foot_contacts is not None:
        return []
    return [f"{argument('feet')} adaptive changes only the step height: the robot reports no foot contacts"]


class GroundContact:
    """Heights of the feet of a walk, or of n of them, tick by tick; legs have the leading shape + (6,).

    Attributes:
        height_m: d of each foot.
    """

    def __init__(self, robot: Robot, shape: tuple[int, ...]) -> None:
        legs = (*shape, N_LEGS)
        self._robot, self._standing_m = robot, robot.standing_height_m
        self.height_m: FloatArray = np.zeros(legs)
        self._goal_m: FloatArray = np.full(legs, _UNKNOWN)
        self._lift_m: FloatArray = np.zeros(legs)
        self._risen: FloatArray = np.zeros(legs)
        self._stood_s: FloatArray = np.zeros(legs)
        self._searched: BoolArray = np.zeros(legs, dtype=bool)
        self._misses = np.zeros(legs, dtype=int)

    def update(
        self,
        dt_s: float,
        feet_body: FloatArray,
        lift_m: FloatArray,
        top_m: FloatArray,
        state: RobotState,
        stepping: FloatArray,
    ) -> FloatArray:
        """Heights d after a tick; without foot contacts they stay.

        Args:
            feet_body: feet of the gait, leading shape + (6, 3).
            lift_m: their lift.
            top_m: lift at the top of a step, in a shape that broadcasts.
            stepping: 1 for legs that step and 0 for tucked ones.
        """
        if state.foot_contacts is None:
            return self.height_m
        stands = (lift_m == 0) & (stepping > 0)
        self._stood_s = (self._stood_s + dt_s) * stands
        meets = state.foot_contacts & (self._goal_m == _UNKNOWN)
        found_m = np.minimum(self.height_m + GAP * self._standing_m, 0.0)
        self._goal_m = np.where(stands, np.where(meets, found_m, self._goal_m), _UNKNOWN)
        known = self._goal_m > _UNKNOWN
        searches = (self._stood_s > WAIT_S) & self._arrived(feet_body[..., 2] - lift_m, state)
        given_up = self._gives_up(stands, searches & ~known, state.foot_contacts)
        goal_m = np.where(given_up & ~known, 0.0, np.maximum(self._goal_m, self._deepest_m(feet_body)))
        most_m = SPEED_PER_S * self._standing_m * dt_s
        way_m = (goal_m - self.height_m) * (searches | known | given_up)
        moved_m = self.height_m + np.minimum(np.maximum(way_m, -most_m), most_m)
        # A soft stop lowers the top, too: the share still rises as in any other step.
        risen = lift_m / np.maximum(top_m, _LEAST_TOP_M)
        self.height_m = np.where(stands, moved_m, self._in_air_m(risen, most_m))
        self._lift_m, self._risen = lift_m, risen
        return self.height_m

    def _gives_up(self, stands: BoolArray, searches: BoolArray, contacts: BoolArray) -> BoolArray:
        """Whether feet no longer search, because their contacts may be dead, leading shape + (6,)."""
        self._misses = np.where(contacts, 0, self._misses + (self._searched & ~stands))
        given_up = np.asarray(self._misses >= MISSES)
        self._searched = stands & (self._searched | (searches & ~given_up)) & ~contacts
        return given_up

    def _in_air_m(self, risen: FloatArray, most_m: float) -> FloatArray:
        """Heights d of feet in the air, in m: 0 at the top; once they fall, `most_m` nearer to 0."""
        share = (1.0 - risen) / np.maximum(1.0 - self._risen, 1e-9)
        falling_m = np.minimum(self.height_m + most_m, 0.0)
        return np.where(risen > self._risen, np.clip(share, 0.0, 1.0) * self.height_m, falling_m)

    def _arrived(self, level_m: FloatArray, state: RobotState) -> BoolArray:
        """Whether the feet are at their targets of the last tick, leading shape + (6,)."""
        height_m = foot_positions_body(self._robot, state.joint_positions_rad)[..., 2] - level_m
        above_m = height_m - self._lift_m - self.height_m
        return np.asarray(above_m < ARRIVED * self._standing_m)

    def _deepest_m(self, feet_body: FloatArray) -> FloatArray:
        """Lowest heights d that the legs reach, leading shape + (6,), -`DEPTH` to 0."""
        leg, from_mount = self._robot.leg_triangle, feet_body - self._robot.mount_positions_body
        x, y, z = from_mount[..., 0], from_mount[..., 1], from_mount[..., 2]
        outward = np.sqrt(x * x + y * y) - leg.coxa_outward_m
        most = STRETCH * leg.most_m
        down = np.sqrt(np.maximum(most * most - outward * outward, 0.0))
        reached_m = np.minimum(leg.coxa_up_m - down - z, 0.0)
        return np.asarray(np.maximum(reached_m, -DEPTH * self._standing_m))
