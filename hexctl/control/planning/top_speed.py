"""Gaits at the highest pace that the servos of a robot can follow, for `--fast`.

A motor holds the static torque tau of its joint, overcomes its dry friction and its back-EMF b w at the joint
speed w, and needs the share of its stall torque

    u = |tau + tau_dry sign(w) + b w| / tau_stall

of its drive. The path of the joints over a cycle does not depend on the pace f: a joint that changes by q'
per cycle turns at w = f q'. It follows while w stays below its maximum speed and u below 1, which both limit
the pace.

A body walks at the speed A f / (1 - s) at an amplitude A, a pace f and a swing share s. The servos limit f
by that path (`JointPath`), which depends on A and on s: in a longer swing the foot returns more slowly. So
the fastest gait is the one with the largest

    A f_most(A, s) / (1 - s) / OVERDRIVE

of a few amplitudes A, with the swing share of the gait, and on five legs also with that of `two_up`.
Steering lengthens strokes by up to `OVERDRIVE`, and turns them: f_most is the least along `COURSES_RAD`.
"""

import math
from dataclasses import dataclass, fields, replace
from functools import lru_cache

import numpy as np

from hexctl.control.planning.crawl import two_up
from hexctl.control.planning.static_stability import DIRECTION_STEP_RAD
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import body_heading_rad
from hexctl.control.walks.velocity_walk import OVERDRIVE
from hexctl.errors import InputError, argument
from hexctl.gait.encoding import Slots
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import PACE_HZ, SWING_SHARE, Gait, Motion, ideal_speed_m_s
from hexctl.ik.legs import legs_that_reach, solve_legs
from hexctl.ik.statics import static_load
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, FloatArray

#: Courses relative to the heading. With only the first one, a limp leg that dragged `pexod` aside cost 130
#: clipped commands in 12 s: its knees move three times as fast to the side.
COURSES_RAD = (0.0, math.radians(30.0), math.radians(-30.0))

#: Tried amplitudes, as multiples of the gait's.
AMPLITUDES = (0.8, 1.0, 1.2)

#: Points of a gait cycle: a change between two of them is what a servo can follow at all.
POINTS = 36

#: A joint that changes by less per cycle does not turn.
STILL_RAD = 1e-9


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class JointPath(ArrayFields):
    """Joints at full stride over a cycle.

    Attributes:
        changes_rad: of the joints per cycle, (points, 18).
        torques_nm: that hold the robot, (points, 18).
    """

    robot: Robot
    changes_rad: FloatArray
    torques_nm: FloatArray

    @classmethod
    def of(cls, robot: Robot, gait: Gait, motion: Motion) -> "JointPath | None":
        """Path of a gait.

        None if feet are out of reach, their joints out of their ranges, two feet touch, or the robot tips.
        """
        # From the begin of a cycle on: the points are the same at any pace.
        cycles = math.ceil(RAMP_DURATION_S * gait.pace_hz) + (np.arange(POINTS) + 0.5) / POINTS
        time_s = cycles / gait.pace_hz
        feet = gait_feet_body(robot, gait, motion, time_s)
        spacing_m = np.linalg.norm(feet - np.roll(feet, -1, axis=-2), axis=-1)
        if spacing_m.min() < 2 * robot.foot_radius_m or not legs_that_reach(robot, feet).all():
            return None
        joints = solve_legs(robot, feet).joint_positions_rad
        load = static_load(robot, joints)
        if not load.balanced.all():
            return None
        return cls(
            robot=robot,
            changes_rad=POINTS * (np.roll(joints, -1, axis=0) - np.roll(joints, 1, axis=0)) / 2,
            torques_nm=load.torques_nm,
        )

    def drive(self, pace_hz: float) -> float:
        """Largest share of a servo's drive at a pace: at 1 all that it has."""
        robot, speed_rad_s = self.robot, pace_hz * self.changes_rad
        moving_nm = robot.dry_friction_nm * np.sign(speed_rad_s) + robot.back_emf_nm_s_per_rad * speed_rad_s
        shares = np.abs(self.torques_nm + moving_nm) / robot.joint_max_torque_nm
        return float(shares.max())

    @property
    def most_pace_hz(self) -> float:
        """Pace up to which every joint follows; 0 if a servo cannot even hold its torque."""
        robot, turning_rad = self.robot, np.maximum(np.abs(self.changes_rad), STILL_RAD)
        by_speed_hz = float((robot.joint_max_speed_rad_s / turning_rad).min())
        against_nm = robot.dry_friction_nm + self.torques_nm * np.sign(self.changes_rad)
        left_nm = robot.joint_max_torque_nm - against_nm
        if left_nm.min() <= 0 or (np.abs(self.torques_nm) >= robot.joint_max_torque_nm).any():
            return 0.0
        lost_nm_s = robot.back_emf_nm_s_per_rad * turning_rad
        by_torque_hz = np.divide(left_nm, lost_nm_s, out=np.full_like(left_nm, np.inf), where=lost_nm_s > 0)
        return min(by_speed_hz, float(by_torque_hz.min()))


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


def fastest_gait(robot: Robot, plan: TrialPlan, *, reorder: bool) -> Gait:
    """The fastest of `fast_gaits` for a plan; raises InputError if the servos carry none."""
    heading_rad = body_heading_rad(robot, plan)
    gaits = fast_gaits(robot, plan.gait, heading_rad=heading_rad, lost=plan.failed_legs, reorder=reorder)
    if not gaits:
        raise InputError(
            f"{argument('fast')}: the servos of {robot.name} do not carry this gait at any pace; "
            "allowed: without; hexctl check says which joint is too weak"
        )
    return gaits[0]


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
