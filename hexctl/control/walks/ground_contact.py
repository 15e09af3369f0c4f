"""Feet that stop on the ground where they meet it, and search for it below where it should be.

Each foot has a height d over the trajectory of its gait, with the lift l: its foot is at z = l + d. In a swing
with the top at u = 1/2, the end at u_e, and in the stance,

    rising    d' = -d / (time to the top)             the next step is as high as the others
    falling   z' = l', but z >= g                     g: where the foot stops
    stance    d' = -v until z = g                     the search, at the speed v = 4 H f

The goal is g = -D while the foot has not met the ground, D what the leg reaches and at most `DEPTH`. A contact
at the height z sets g = z - P, at most the level of the stance: a foot presses by P beyond it, as servos
yield under the weight. On an even floor the contact comes less than P before the end of the swing, and d
stays 0. Feet in the stance sink or rise by their common height, so that the body keeps its own:

    d_i' = -mean(d of the stance) / T
"""

import numpy as np

from hexctl.gait.foot_trajectory import SWING_TOP, StepPattern, lift_offset
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.model import Robot
from hexctl.types import BoolArray, FloatArray, RobotState

#: Depth to which a foot presses beyond a contact, and most depth of a search, in standing heights.
PRESS, DEPTH, ARRIVED = 0.06, 0.4, 0.03
STOP, SEARCH, LEVEL, RELEARN = True, True, 0.5, False
SPEED = 4.0
WAIT = 0.08
FOLLOW = True
GAP = 0.04


class GroundContact:
    """Heights of the feet of one walk, or of n of them, tick by tick; legs have the leading shape + (6,).

    Attributes:
        height_m: d of each foot.
        goal_m: g of each foot.
    """

    def __init__(self, robot: Robot, shape: tuple[int, ...], ends_at: float = 2 / 3) -> None:
        legs = (*shape, len(robot.stance_feet_body))
        self._robot = robot
        self._press_m = PRESS * robot.standing_height_m
        self._depth_m = DEPTH * robot.standing_height_m
        self._arrived_m = ARRIVED * robot.standing_height_m
        self.height_m: FloatArray = np.zeros(legs)
        self.goal_m: FloatArray = np.full(legs, -self._depth_m)
        self._u: FloatArray | None = None
        self._z: FloatArray = np.zeros(legs)

    def update(
        self,
        dt_s: float,
        feet_body: FloatArray,
        lift_m: FloatArray,
        u: FloatArray,
        pattern: StepPattern,
        state: RobotState,
    ) -> FloatArray:
        """Heights d after a tick.

        Args:
            feet_body: feet of the gait, leading shape + (6, 3).
            lift_m: l of them.
            u: normalised times.
            contacts: feet on the ground; None if unknown: then feet return to their gait.
        """
        contacts = state.foot_contacts
        if contacts is None:
            contacts = np.ones(u.shape, dtype=bool)
        half = 1 / 6 if pattern.swing_share is None else pattern.swing_share / 2
        swings = np.abs(u - SWING_TOP) < half
        if pattern.stepping is not None:
            swings = swings & (pattern.stepping > 0)
        rising = swings & (u < SWING_TOP)
        falling = swings & ~rising
        d = self.height_m
        level = feet_body[..., 2] - lift_m
        z = foot_positions_body(self._robot, state.joint_positions_rad)[..., 2] - level
        share = 0.0
        if self._u is not None:
            left_then, left = SWING_TOP - self._u, SWING_TOP - u
            share = np.where(rising & (left_then > 0), left / np.maximum(np.maximum(left_then, left), 1e-9), 0.0)
        d = np.where(rising, share * d, d)
        unknown = self.goal_m <= -self._depth_m
        stance = ~swings
        n = np.add.reduce(stance * 1.0, axis=-1, keepdims=True)
        mean = np.add.reduce(np.where(stance, d, 0.0), axis=-1, keepdims=True) / np.maximum(n, 1.0)
        meets = contacts & unknown
        goal = self.goal_m
        if STOP:
            goal = np.where(meets & falling, np.maximum(z - self._press_m, mean), goal)
        goal = np.where(meets & stance, np.where(d < 0, np.minimum(d + GAP * self._robot.standing_height_m, np.maximum(mean, d)), d), goal)
        goal = np.where(rising, -self._depth_m, goal)
        if RELEARN:
            goal = np.where(stance & ~contacts, -self._depth_m, goal)
        base = 0.0
        if FOLLOW:
            base = mean * np.clip((u - SWING_TOP) / half, 0.0, 1.0)
        d = np.where(falling, np.maximum(goal - lift_m, base) , d)
        speed = SPEED * np.asarray(pattern.pace_hz)[..., np.newaxis] * pattern.height_m
        stop = np.maximum(goal, self._lowest_m(feet_body))
        unknown = goal <= -self._depth_m
        if not SEARCH:
            stop = np.maximum(stop, 0.0)
        waited = u - SWING_TOP - half > WAIT * np.asarray(pattern.pace_hz)[..., np.newaxis]
        waited = waited | (u < SWING_TOP - half)
        moves = stance & (~unknown | (waited & (z - self._z < self._arrived_m)))
        d = np.where(moves, np.where(d > stop, np.maximum(d - speed * dt_s, stop), np.minimum(d + speed * dt_s, stop)), d)
        if LEVEL:
            shift = np.where(stance, np.minimum(dt_s / LEVEL, 1.0) * mean, 0.0)
            d = d - shift
            goal = np.where(goal > -self._depth_m, goal - shift, goal)
        self.height_m, self.goal_m, self._u, self._z = d, goal, u, lift_m + d
        return d

    def _lowest_m(self, feet_body: FloatArray) -> FloatArray:
        """How far below its place each leg can put its foot, stretched, (..., 6), at most 0."""
        leg = self._robot.leg_triangle
        from_mount = feet_body - self._robot.mount_positions_body
        x, y, z = from_mount[..., 0], from_mount[..., 1], from_mount[..., 2]
        outward = np.sqrt(x * x + y * y) - leg.coxa_outward_m
        most = 0.97 * leg.most_m
        down = np.sqrt(np.maximum(most * most - outward * outward, 0.0))
        return np.minimum(leg.coxa_up_m - down - z, 0.0)
