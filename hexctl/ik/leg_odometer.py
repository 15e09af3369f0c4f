"""Leg odometry for incoming states, with detection of a leg that carries nothing."""

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from hexctl.ik.leg_odometry import leg_motions
from hexctl.ik.lost_leg import LostLegWatch
from hexctl.robot.model import Robot
from hexctl.types import ArrayFields, BoolArray, FloatArray

#: Maximum time between two states: a gait's cycle may have passed in a longer gap.
GAP_S = 0.5


@dataclass(frozen=True, slots=True, eq=False)
class LegStep(ArrayFields):
    """Motion of a body between two states, by its legs.

    Attributes:
        motion: in the first body frame, (3,): forward and left in m, counter-clockwise; None after a gap.
        height_m: of the body frame's origin above the floor, at the second state.
        up_body: the vertical at the second state, in the body frame, (3,).
    """

    from_s: float
    to_s: float
    motion: FloatArray | None
    height_m: float
    rise_m: float
    up_body: FloatArray


class LegOdometer:
    """Leg odometry for incoming joint angles, as `leg_motions`; `told` are known missing legs 1..6."""

    def __init__(self, robot: Robot) -> None:
        self._robot = robot
        self.told: Collection[int] = ()
        self._watch = LostLegWatch(robot)
        self._last: tuple[float, FloatArray, BoolArray | None] | None = None

    @property
    def lost_legs(self) -> tuple[int, ...]:
        """Legs 1..6 without load: the known ones and the detected one."""
        return tuple(sorted({*self.told, *self._watch.lost_legs}))

    def update(
        self, at_s: float, joint_positions_rad: FloatArray, foot_contacts: BoolArray | None = None
    ) -> LegStep | None:
        """Motion of the body since the state before; None for the first state, an old one, and NaN angles.

        Angles are (18,), contacts (6,) where they are known; `at_s` is the time of the measurement.
        """
        last = self._last
        late = last is not None and at_s <= last[0]
        if late or not np.isfinite(joint_positions_rad).all():
            return None
        joints_rad = joint_positions_rad.copy()
        self._last = (at_s, joints_rad, foot_contacts)
        near = last is not None and at_s - last[0] < GAP_S
        if not near:
            self._watch.restart()
        if foot_contacts is None:
            self._watch.listen(at_s, joints_rad)
        if last is None:
            return None
        before_s, before_rad, touched = last
        contacts = None if touched is None or foot_contacts is None else np.stack([touched, foot_contacts])
        times_s, joints = np.array([before_s, at_s]), np.stack([before_rad, joints_rad])
        moved = leg_motions(self._robot, times_s, joints, contacts, self.lost_legs)
        before_m, after_m = moved.height_m.tolist()
        motion = moved.motions[0] if near else None
        return LegStep(before_s, at_s, motion, after_m, after_m - before_m, moved.up_body[1])

    def see(self, at_s: float, pose: FloatArray) -> None:
        """Take a pose, (3,), to detect a leg that carries nothing: x, y in m and yaw in rad, any fixed frame.

        Its time is on the clock of the states, up to a second ago.
        """
        self._watch.see(at_s, pose, self.told)
