"""Gaits at the highest pace that the servos of a robot can follow, for `--fast`.

A body walks at the speed A f / (1 - s) at an amplitude A, a pace f and a swing share s. The servos limit f
by the path of the joints (`JointPath`), and the path depends on A and on s: in a longer swing the foot
returns more slowly. So the fastest gait is the one with the largest

    A f_most(A, s) / (1 - s) / OVERDRIVE

of a few amplitudes A, with the swing share of the gait, and on five legs also with that of `two_up`.
Steering lengthens strokes by up to `OVERDRIVE`, and turns them: f_most is the least along `COURSES_RAD`.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache

from hexctl.control.assessment.crawl import two_up
from hexctl.control.assessment.joint_path import JointPath
from hexctl.control.assessment.static_stability import DIRECTION_STEP_RAD
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.gait.encoding import Slots
from hexctl.gait.gait import PACE_HZ, SWING_SHARE, Gait, Motion, ideal_speed_m_s
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS

#: Courses relative to the heading. With only the first one, a limp leg that dragged `pexod` aside cost 130
#: clipped commands in 12 s: its knees move three times as fast to the side.
COURSES_RAD = (0.0, math.radians(30.0), math.radians(-30.0))

#: Tried amplitudes, as multiples of the gait's.
AMPLITUDES = (0.8, 1.0, 1.2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Stride:
    """Pace, amplitude and swing share of a gait, as in `Gait`."""

    pace_hz: float
    amplitude: float
    swing_share: float

    @classmethod
    def of(cls, gait: Gait) -> "Stride":
        """Stride of a gait."""
        return cls(pace_hz=gait.pace_hz, amplitude=gait.amplitude, swing_share=gait.swing_share)

    def applied(self, gait: Gait, lost: tuple[int, ...] = ()) -> Gait:
        """A gait with this stride; the swings of the other legs are evenly spread if they last long."""
        order = self.order(gait.slots, lost)
        phases = [0.0] * N_LEGS
        for place, leg in enumerate(order):
            phases[leg - 1] = place / len(order)
        return replace(
            gait,
            pace_hz=self.pace_hz,
            amplitude=self.amplitude,
            swing_share=self.swing_share,
            phases=tuple(phases) if self.spread else None,
        )

    @property
    def spread(self) -> bool:
        """Whether swings last too long for the slots of a code."""
        return self.swing_share > SWING_SHARE

    @staticmethod
    def order(slots: Slots, lost: tuple[int, ...]) -> list[int]:
        """The other legs in the order of their slots, from the first leg on."""
        walking = [leg for leg in range(1, N_LEGS + 1) if leg not in lost]
        ordered = sorted(walking, key=lambda leg: slots[leg - 1])
        first = ordered.index(walking[0])
        return ordered[first:] + ordered[:first]


#: Names of the numbers of a stride, which are options of a walk.
STRIDE = tuple(field.name for field in fields(Stride))


def fast_gaits(
    robot: Robot, gait: Gait, *, heading_rad: float, lost: tuple[int, ...] = (), reorder: bool = False
) -> tuple[Gait, ...]:
    """Variants of a gait at the pace that the servos hold without some legs, the fastest first.

    Args:
        heading_rad: direction of travel in the body frame.
        lost: legs that do not carry.
        reorder: whether the order of five legs may change.

    Empty if the servos cannot carry the robot, or a foot is out of reach.
    """
    direction = round(heading_rad / DIRECTION_STEP_RAD)
    return _fast_gaits(robot, gait, direction, tuple(sorted(lost)), reorder)


@lru_cache(maxsize=256)
def _fast_gaits(
    robot: Robot, gait: Gait, direction: int, lost: tuple[int, ...], reorder: bool
) -> tuple[Gait, ...]:
    heading_rad = DIRECTION_STEP_RAD * direction
    found = []
    for share in AMPLITUDES:
        longer = replace(gait, amplitude=min(1.0, share * gait.amplitude))
        tucked = _without(longer, lost)
        shapes = [longer]
        if reorder and len(tucked.posture.tucked_legs) == 1:
            spread = two_up(robot, tucked, heading_rad=heading_rad)
            shapes.append(replace(spread, posture=gait.posture))
        for shape in shapes:
            pace_hz = round(_pace_hz(robot, _without(shape, lost), heading_rad), 3)
            found += [replace(shape, pace_hz=pace_hz)] if pace_hz > 0 else []
    return tuple(sorted(found, key=lambda one: -ideal_speed_m_s(robot, one, Motion())))


def _pace_hz(robot: Robot, gait: Gait, heading_rad: float) -> float:
    """Pace that the servos hold on all courses; 0 if there is none."""
    least_hz = PACE_HZ.high
    for course_rad in COURSES_RAD:
        path = JointPath.of(robot, gait, Motion(heading_rad=heading_rad + course_rad))
        if path is None:
            return 0.0
        least_hz = min(least_hz, path.most_pace_hz / OVERDRIVE)
    return least_hz


def _without(gait: Gait, lost: tuple[int, ...]) -> Gait:
    tucked = tuple({*gait.posture.tucked_legs, *lost})
    return replace(gait, posture=replace(gait.posture, tucked_legs=tucked))
