"""Sensing that stands still: a pose or joint angles that repeat themselves while the legs move."""

import numpy as np

from hexctl.ik.leg_odometer import LegOdometer
from hexctl.ik.standing_position import LegsPath, StandingPosition
from hexctl.robot.model import Robot
from hexctl.types import FloatArray, RobotState, by_leg

#: Period in which the legs are followed: less often a step would be missed.
FOLLOWED_S = 0.1

#: Joint angles that keep every bit for this long after the targets of so many legs moved by this are frozen.
REPEATED_S, MOVED_RAD, LEAST_LEGS = 0.5, 0.05, 3


def joined(position_world: FloatArray, quaternion_world: FloatArray | None) -> FloatArray:
    """Position (..., 3) and orientation (..., 4), 0 if unknown: rounded, one may repeat while one turns."""
    unknown = np.zeros((*position_world.shape[:-1], 4))
    quaternion = unknown if quaternion_world is None else np.nan_to_num(quaternion_world)
    return np.concatenate([position_world, quaternion], axis=-1)


class PoseAges:
    """How long ago each part of a pose was last measured.

    A value that keeps every bit is a measurement only if the legs rest: sensors have noise, and a simulated
    robot without noise moves with its legs.
    """

    def __init__(self) -> None:
        self._seen_at_s: dict[str, float] = {}
        self._looked_at_s: dict[str, float] = {}
        self._shown: dict[str, bytes] = {}

    def look(self, part: str, value: FloatArray | None, now_s: float, *, moving: bool) -> None:
        """Take the value of a part, or None if it is missing; `moving` is whether the legs are in motion."""
        if value is not None:
            shown = value.tobytes()
            if self._shown.get(part) != shown or part not in self._seen_at_s:
                self._shown[part], self._seen_at_s[part] = shown, now_s
            elif not moving:
                self._seen_at_s[part] += now_s - self._looked_at_s[part]
        self._looked_at_s[part] = now_s

    def oldest_s(self, now_s: float) -> float:
        """Age of the part that was measured least recently; 0 if none was ever measured."""
        return now_s - min(self._seen_at_s.values(), default=now_s)

    def shown(self, part: str) -> FloatArray | None:
        """Newest value of a part, or None."""
        return np.frombuffer(self._shown[part]) if part in self._seen_at_s else None

    def renew(self, now_s: float) -> None:
        """Let all ages count from now; known parts stay expected."""
        self._seen_at_s = dict.fromkeys(self._seen_at_s, now_s)
        self._looked_at_s = dict.fromkeys(self._looked_at_s, now_s)

    def forget(self, *parts: str) -> None:
        """Expect some parts no longer."""
        for part in parts:
            self._seen_at_s.pop(part, None)


class RepeatedAngles:
    """Whether measured joint angles repeat themselves although their targets move."""

    def __init__(self) -> None:
        self._shown = b""
        self._since_s = 0.0
        self._least_rad: FloatArray = np.empty(0)
        self._most_rad: FloatArray = np.empty(0)

    def look(self, state: RobotState, targets_rad: FloatArray | None, now_s: float) -> bool:
        """Take a state and the last targets, (18,), or None: whether the angles are frozen."""
        shown = state.joint_positions_rad.tobytes()
        if shown != self._shown or targets_rad is None or not state.measured:
            self._shown, self._since_s = shown, now_s
            self._least_rad = self._most_rad = np.empty(0) if targets_rad is None else targets_rad
            return False
        if not len(self._least_rad):
            self._least_rad = self._most_rad = targets_rad
        self._least_rad = np.minimum(self._least_rad, targets_rad)
        self._most_rad = np.maximum(self._most_rad, targets_rad)
        moved = (by_leg(self._most_rad - self._least_rad) > MOVED_RAD).any(axis=-1)
        if int(moved.sum()) < LEAST_LEGS:
            self._since_s = now_s  # honest angles lag behind the first targets after a rest
        return now_s - self._since_s > REPEATED_S


class WalkedPosition:
    """Whether the position of one robot follows its legs."""

    def __init__(self, robot: Robot) -> None:
        self._odometer = LegOdometer(robot)
        self.forget()

    def forget(self) -> None:
        """Begin with the next position."""
        self._legs, self._standing, self._begun = LegsPath(), StandingPosition(), False
        self._followed_s = -np.inf

    def walk(self, state: RobotState, now_s: float) -> None:
        """Follow the legs of a state, also of one without a position: positions may come and go."""
        if self._begun and now_s - self._followed_s >= FOLLOWED_S:
            self._followed_s = now_s
            step = self._odometer.update(now_s, state.joint_positions_rad, state.foot_contacts)
            if step is not None and step.motion is not None:
                self._legs.move(step.motion)

    def follows(self, position_world: FloatArray) -> bool:
        """Take a position (3,): False for one that stands while the legs walk."""
        self._begun = True
        x_m, y_m, _ = position_world.tolist()
        return not self._standing.stands(x_m, y_m, self._legs)
