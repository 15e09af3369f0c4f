"""Feet that stop where they meet the ground, and search for it below where it should be.

Each foot has a height d over the trajectory of its gait. With the lift l of that trajectory, H at its top,
and the mean c of the d of all feet that stand on the ground,

    rising    d falls to 0 at the top, so that the next step is as high as the others
    falling   d = max(g - l, c (1 - l / H))
    standing  d moves to g at the speed V

g is the goal of the foot: as deep as its leg reaches, at most `DEPTH`, until it meets the ground. If a
falling foot meets it at the measured height z, g = max(z - P, c): it presses on by P, because servos yield
under the weight. If a standing foot meets it, g = min(d + G, c): by G it hangs on an even floor as well,
until the robot leans on it. Therefore d stays near 0 on an even floor. The body returns to its height over
the feet:

    d' = g' = -c / T
"""

import numpy as np

from hexctl.ik.legs import foot_positions_body
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, FloatArray, RobotState

#: Depth P by which a foot presses, gap G of an even floor, and deepest search, in standing heights.
PRESS, GAP, DEPTH = 0.06, 0.04, 0.4

#: Speed V of a search in standing heights per second, and time constant T of the body's height.
SPEED_PER_S, LEVEL_S = 1.0, 0.5

#: A search begins this long after the swing, if the foot is no more than this above its target, in standing
#: heights: servos are late.
WAIT_S, ARRIVED = 0.08, 0.03

#: Share of its length to which a leg stretches.
STRETCH = 0.97

#: Minimum step height on uneven ground, as a fraction of the robot's size.
UNEVEN_HEIGHT = 0.04

_UNKNOWN = -np.inf


def step_height(robot: Robot, feet: str) -> float:
    """Step height of a walk with `planned` or `adaptive` feet, as a fraction of the robot's size."""
    return max(robot.gait.height, UNEVEN_HEIGHT) if feet == "adaptive" else robot.gait.height


def contact_notes(feet: str, state: RobotState) -> list[str]:
    """A note if `adaptive` feet have no effect, because the robot reports no contacts."""
    if feet != "adaptive" or state.foot_contacts is not None:
        return []
    return ["--feet adaptive changes only the step height: the robot reports no foot contacts"]


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
        self._stood_s: FloatArray = np.zeros(legs)

    def update(
        self,
        dt_s: float,
        feet_body: FloatArray,
        lift_m: FloatArray,
        top_m: FloatArray,
        state: RobotState,
        stepping: FloatArray | None = None,
    ) -> FloatArray:
        """Heights d after a tick; without foot contacts they stay.

        Args:
            feet_body: feet of the gait, leading shape + (6, 3).
            lift_m: l of them.
            top_m: H, in a shape that broadcasts.
            stepping: 1 for legs that step and 0 for tucked ones, None if all step.
        """
        contacts = state.foot_contacts
        if contacts is None:
            return self.height_m
        place_m = feet_body[..., 2] - lift_m
        measured_m = foot_positions_body(self._robot, state.joint_positions_rad)[..., 2] - place_m
        above_m = measured_m - self._lift_m - self.height_m
        stands = lift_m == 0 if stepping is None else (lift_m == 0) & (stepping > 0)
        rises = lift_m > self._lift_m
        falls = (lift_m > 0) & ~rises
        common_m = self._common_m(stands)
        d, met = self.height_m, contacts & (self._goal_m == _UNKNOWN)
        pressed = np.maximum(measured_m - PRESS * self._standing_m, common_m)
        found = np.where(d < common_m, np.minimum(d + GAP * self._standing_m, common_m), d)
        goal = np.where(met & falls, pressed, np.where(met & stands, found, self._goal_m))
        goal = np.where(rises, _UNKNOWN, goal)
        self._stood_s = (self._stood_s + dt_s) * stands
        arrived = (self._stood_s > WAIT_S) & (above_m < ARRIVED * self._standing_m)
        moves = stands & ((goal > _UNKNOWN) | arrived)
        step_m = SPEED_PER_S * self._standing_m * dt_s * moves
        way_m = np.maximum(goal, self._deepest_m(feet_body)) - d
        moved = d + np.minimum(np.maximum(way_m, -step_m), step_m)
        left = np.maximum(top_m - lift_m, 0.0) / np.maximum(top_m - self._lift_m, 1e-9)
        down = np.maximum(goal - lift_m, common_m * (1 - lift_m / np.maximum(top_m, 1e-9)))
        d = np.where(falls, down, np.where(rises, d * np.minimum(left, 1.0), moved))
        back_m = common_m * stands * min(dt_s / LEVEL_S, 1.0)
        self.height_m, self._goal_m, self._lift_m = d - back_m, goal - back_m, lift_m
        return self.height_m

    def _common_m(self, stands: FloatArray) -> FloatArray:
        """Mean height of the feet that stand on the ground, leading shape + (1,)."""
        supports = stands & (self._goal_m > _UNKNOWN)
        count = np.add.reduce(supports, axis=-1, keepdims=True, dtype=float)
        total_m = np.add.reduce(self.height_m * supports, axis=-1, keepdims=True)
        return np.asarray(total_m / np.maximum(count, 1.0))

    def _deepest_m(self, feet_body: FloatArray) -> FloatArray:
        """Lowest heights d that the legs reach, leading shape + (6,), -`DEPTH` to 0."""
        leg, from_mount = self._robot.leg_triangle, feet_body - self._robot.mount_positions_body
        x, y, z = from_mount[..., 0], from_mount[..., 1], from_mount[..., 2]
        outward = np.sqrt(x * x + y * y) - leg.coxa_outward_m
        most = STRETCH * leg.most_m
        down = np.sqrt(np.maximum(most * most - outward * outward, 0.0))
        reached_m = np.minimum(leg.coxa_up_m - down - z, 0.0)
        return np.asarray(np.maximum(reached_m, -DEPTH * self._standing_m))
