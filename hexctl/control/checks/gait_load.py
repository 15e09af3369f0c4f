"""The load of a gait over its cycle: static torques, sag, clearance between legs, and a verdict on it.

Thresholds are from `python -m benchmarks --only check`, which counts random robots that made half of their
distance: `check.loads` for torque and sag, `check.legs` for crossing legs.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.backends.sim.world import World
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.clearance import PARTS, leg_clearance, nearness
from hexctl.ik.legs import solve_legs
from hexctl.ik.load_capacity import load_capacity
from hexctl.ik.statics import static_load
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES, N_LEGS, ArrayFields, FloatArray

#: Points of one gait cycle at which weight and clearance are evaluated.
LOAD_POINTS = 60
CLEARANCE_POINTS = 120

#: Share of its torque above which a servo needs pauses. Robotis rates 20 % of the stall torque as continuous.
CONTINUOUS_SHARE = 0.35

#: Share of the step height below which a foot drags, 0.4 to 0.6 mm on shipped robots; only for a warning.
LEAST_LIFT = 0.02

#: Overlap as a share of both radii above which two legs would cross.
CROSSING_DEPTH = 0.9

#: A servo is hot if it is above the continuous torque for more than this share of the cycle. Heat grows with
#: the square of torque: 35 % of the stall torque for 60 % of the time is 27 % RMS or more; Robotis rates the
#: continuous torque at 20 % (robotis.us/robotis-blog/torque-ratings).
MOST_DUTY = 0.6

#: A robot that carries less than this multiple of its weight sinks. Simulated robots walked badly down to
#: 0.76: the median over the cycle ignores the best poses, and the swing feet that it sinks onto.
LEAST_CAPACITY = 0.7

#: Multiple of its weight above which torque does not slow a robot.
GOOD_CAPACITY = 3.0

#: Maximum share of the cycle in which a robot may tip and still walk.
MOST_TIPPING = 0.5

#: A robot that sags by this multiple of the step height lifts no foot; robots walked badly up to 1.1.
MOST_SAG = 1.25

#: Share of the step height that remains for each foot on sufficiently stiff servos.
GOOD_LIFT = 1 / 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GaitLoad(ArrayFields):
    """The quasi-static load of a gait at full stride, the worst over its motions; joint arrays are (18,).

    Attributes:
        duties: share of the cycle of each joint above `CONTINUOUS_SHARE` of its torque.
        typical_sag_m: median sag of the body over the cycle.
        lift_left: minimum remaining share of the step height; 0 if a foot drags.
        capacity: multiple of its weight that the robot carries, the median over the cycle.
        tipping: share of the cycle with the centre of mass outside all feet; excluded from torques and sag.
        nearest_legs: the two neighbouring legs with the deepest overlap, or else the smallest gap.
        nearest_parts: their parts, of `hexctl.ik.clearance.PARTS`.
        least_clearance_m: gap between these parts, negative if they overlap.
        overlap: overlap of these parts as a share of both radii, 1 if their axes meet.
        crossing_share: share of the cycle in which the axes of two legs nearly meet.
        all_drag: whether in some motion no foot leaves the floor.
    """

    torques_nm: FloatArray
    max_torques_nm: FloatArray
    duties: FloatArray
    deflections_rad: FloatArray
    most_sag_m: float
    typical_sag_m: float
    step_height_m: float
    lift_left: float
    dragging_legs: tuple[int, ...]
    capacity: float
    tipping: float
    least_clearance_m: float
    nearest_legs: tuple[int, int]
    nearest_parts: tuple[str, str]
    overlap: float
    crossing_share: float = 0.0
    all_drag: bool = False

    @property
    def crossing(self) -> bool:
        """Whether two legs would have to pass through one another."""
        return self.overlap >= CROSSING_DEPTH

    @property
    def tips_over(self) -> bool:
        """Whether the robot falls before a swing foot lands."""
        return self.tipping > MOST_TIPPING

    @property
    def too_weak(self) -> bool:
        """Whether the servos do not carry the robot."""
        return self.capacity < LEAST_CAPACITY

    @property
    def too_soft(self) -> bool:
        """Whether the body sinks by so much that no foot leaves the floor."""
        return self.typical_sag_m >= MOST_SAG * self.step_height_m

    def to_dict(self) -> dict[str, Any]:
        """JSON values of the robot, without those of single joints."""
        shares = self.torques_nm / self.max_torques_nm
        return {
            "static_torque_share": round(float(shares.max()), 4),
            "load_capacity": round(self.capacity, 3),
            "tipping": round(self.tipping, 3),
            "sag_deg": round(float(np.degrees(self.deflections_rad.max())), 2),
            "sag_mm": round(1000 * self.most_sag_m, 2),
            "step_height_mm": round(1000 * self.step_height_m, 2),
            "lift_left": round(self.lift_left, 3),
            "dragging_legs": list(self.dragging_legs),
            "duty": round(float(self.duties.max()), 3),
            "least_leg_clearance_m": round(self.least_clearance_m, 4),
            "nearest_legs": list(self.nearest_legs),
            "nearest_parts": list(self.nearest_parts),
            "legs_touch": self.least_clearance_m <= 0,
            "legs_cross": self.crossing,
            "legs_cross_share": round(self.crossing_share, 3),
        }


def gait_load(robot: Robot, gait: Gait, motions: Sequence[Motion]) -> GaitLoad:
    """Load of a gait, the worst over the motions."""
    feet, joints = _cycle(robot, gait, motions, LOAD_POINTS)
    load = static_load(robot, joints)
    # When a robot tips, it lands on a foot in the air, and often still walks.
    standing = (feet[..., 2] <= robot.stance_feet_body[:, 2] + 1e-9) | (load.foot_forces_n > 0)
    capacity = load_capacity(robot, joints, standing, friction=World().friction)
    steady = load.balanced
    torques = np.where(steady[..., np.newaxis], np.abs(load.torques_nm), 0.0)
    sag_m = np.where(steady, load.sag_m, 0.0)
    height_m = gait.height * robot.size_m
    lifts = load.foot_heights_m.max(axis=1) / height_m  # (motions, 6)
    return GaitLoad(
        torques_nm=torques.max(axis=(0, 1)),
        max_torques_nm=robot.joint_max_torque_nm,
        duties=(torques > CONTINUOUS_SHARE * robot.joint_max_torque_nm).mean(axis=1).max(axis=0),
        deflections_rad=(torques / robot.stiffness_nm_per_rad).max(axis=(0, 1)),
        most_sag_m=float(sag_m.max()),
        typical_sag_m=float(np.median(sag_m, axis=-1).max()),
        step_height_m=height_m,
        lift_left=float(min(1.0, lifts.min())),
        dragging_legs=tuple(int(leg) + 1 for leg in np.flatnonzero((lifts <= LEAST_LIFT).any(axis=0))),
        capacity=float(np.median(capacity, axis=-1).min()),
        tipping=float((~steady).mean(axis=-1).max()),
        all_drag=bool((lifts <= LEAST_LIFT).all(axis=-1).any()),
        **_nearest(robot, _cycle(robot, gait, motions, CLEARANCE_POINTS)[1]),
    )


def _nearest(robot: Robot, joints: FloatArray) -> dict[str, Any]:
    near = leg_clearance(robot, joints)
    order = nearness(near.gaps_m, near.depths)
    place = np.unravel_index(int(order.argmin()), order.shape)
    leg = int(place[-1])
    part, other_part = (PARTS[int(index)] for index in near.nearest[place])
    return {
        "least_clearance_m": float(near.gaps_m[place]),
        "nearest_legs": (leg + 1, (leg + 1) % N_LEGS + 1),
        "nearest_parts": (part, other_part),
        "overlap": float(near.depths[place]),
        "crossing_share": float((near.depths >= CROSSING_DEPTH).any(axis=-1).mean(axis=-1).max()),
    }


def _cycle(robot: Robot, gait: Gait, motions: Sequence[Motion], count: int) -> tuple[FloatArray, FloatArray]:
    """Feet (motions, count, 6, 3) and joints (motions, count, 18) at the midpoints of `count` intervals."""
    time_s = RAMP_DURATION_S + (np.arange(count) + 0.5) / (count * gait.pace_hz)
    feet = np.stack([gait_feet_body(robot, gait, motion, time_s) for motion in motions])
    return feet, solve_legs(robot, feet).joint_positions_rad


@dataclass(frozen=True, slots=True)
class Verdict:
    """Verdict on a gait; obstacles forbid it, and doubts stopped some simulated robots."""

    obstacles: tuple[str, ...]
    doubts: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()

    @property
    def possible(self) -> bool:
        """Whether the robot can walk the gait."""
        return not self.obstacles

    @property
    def doubtful(self) -> bool:
        """Whether nothing forbids the gait, but something may stop the robot."""
        return self.possible and bool(self.doubts)

    @property
    def warnings(self) -> tuple[str, ...]:
        """Doubts and remarks, one sentence each."""
        return (*self.doubts, *self.remarks)


def load_verdict(load: GaitLoad) -> Verdict:
    """Verdict on the load of a gait."""
    return Verdict(tuple(_obstacles(load)), tuple(_doubts(load)), tuple(_remarks(load)))


def _obstacles(load: GaitLoad) -> Iterator[str]:
    if load.tips_over:
        share = f"{100 * load.tipping:.0f} % of the cycle"
        yield f"it tips over: its centre of mass is outside its feet for {share}"
    elif load.too_weak:
        yield f"too weak: its servos carry {load.capacity:.2f} of its weight while it walks"
    if load.too_soft:
        yield (
            f"too soft: its body sinks {1000 * load.typical_sag_m:.0f} mm and a step is "
            f"{1000 * load.step_height_m:.0f} mm high, so no foot leaves the floor"
        )


def _doubts(load: GaitLoad) -> Iterator[str]:
    shares = load.torques_nm / load.max_torques_nm
    if 0 < load.tipping <= MOST_TIPPING:
        yield f"unsteady: it tips over its feet for {100 * load.tipping:.0f} % of the cycle"
    if LEAST_CAPACITY <= load.capacity < GOOD_CAPACITY:
        yield f"weak: its servos carry {load.capacity:.2f} times its weight while it walks"
    elif shares.max() > 1 and not (load.tips_over or load.too_weak):
        names = ", ".join(JOINT_NAMES[joint] for joint in np.flatnonzero(shares > 1))
        yield f"overloaded: {names} would need up to {100 * shares.max():.0f} % of their torque"
    if load.lift_left < GOOD_LIFT and not (load.tips_over or load.too_soft):
        sag_deg = float(np.degrees(load.deflections_rad.max()))
        yield f"soft: joints give way by up to {sag_deg:.1f} deg under the weight; {_lift_in_words(load)}"
    if load.crossing:
        yield f"{_nearest_in_words(load)} cross for {100 * load.crossing_share:.0f} % of the cycle"


def _lift_in_words(load: GaitLoad) -> str:
    if load.all_drag:
        return "no foot leaves the floor"
    if not load.dragging_legs:
        return f"a foot keeps {100 * load.lift_left:.0f} % of its step height"
    several = len(load.dragging_legs) > 1
    legs = ", ".join(map(str, load.dragging_legs))
    return f"leg{'s' * several} {legs} {'do' if several else 'does'} not leave the floor"


def _remarks(load: GaitLoad) -> Iterator[str]:
    if load.least_clearance_m <= 0 and not load.crossing:
        yield f"{_nearest_in_words(load)} touch"
    hot = int(load.duties.argmax())
    if load.duties[hot] > MOST_DUTY:
        yield (
            f"hot: {JOINT_NAMES[hot]} holds more than {100 * CONTINUOUS_SHARE:.0f} % of its torque for "
            f"{100 * load.duties[hot]:.0f} % of the cycle; servos overheat above that continuously"
        )


def _nearest_in_words(load: GaitLoad) -> str:
    (one, other), (part, other_part) = load.nearest_legs, load.nearest_parts
    return f"legs {one} ({part}) and {other} ({other_part})"
