"""The load of a gait: static torques and sag under the robot's weight over its cycle, and legs that touch."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import Gait, Motion
from hexctl.ik.clearance import PARTS, leg_clearance
from hexctl.ik.legs import solve_legs
from hexctl.ik.load_capacity import load_capacity
from hexctl.ik.statics import static_load
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES, N_LEGS, ArrayFields, FloatArray

#: Points of one gait cycle at which the weight is distributed, and at which legs are compared.
LOAD_POINTS = 60
CLEARANCE_POINTS = 120

#: Share of its torque above which a servo overheats unless it can rest.
CONTINUOUS_SHARE = 0.35

#: Share of the cycle above that torque from which a servo has too little rest.
MOST_DUTY = 0.6

#: A robot that carries less than this multiple of its weight sinks. In simulation robots walked, badly, down
#: to 0.76, as the median over the cycle leaves out the best poses and the feet in the air that it sinks onto.
LEAST_CAPACITY = 0.7

#: Multiple of its weight from which torque was not what made a robot slow.
GOOD_CAPACITY = 1.25

#: Share of the cycle in which a robot may tip over all its feet and still walk.
MOST_TIPPING = 0.5

#: Share of the step height below which a foot drags.
LEAST_LIFT = 0.02

#: A body that sinks by this multiple of the step height lifts no foot; robots walked, badly, up to 1.1.
MOST_SAG = 1.25

#: Share of the step height that is left to each foot on servos that are stiff enough.
GOOD_LIFT = 1 / 3

#: Depth of an overlap, as a share of both radii, from which the axes meet: the legs would cross.
CROSSING_DEPTH = 0.9

#: Robots with legs that cross, simulated with solid legs: up to a share of the cycle in which they cross, how
#: many made half of their way, of how many that do with legs that pass through one another.
CROSSING_WALKS = ((0.25, 23, 26), (1.0, 19, 30))

#: Robots whose sag leaves a foot less than a third of its step, simulated for 30 s: how many made half of
#: their way, of how many, where all feet drag, where some do, and where none does.
DRAGGING_WALKS, PARTLY_DRAGGING_WALKS, SOFT_WALKS = (3, 42), (22, 32), (31, 35)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class GaitLoad(ArrayFields):
    """The load of a gait at full stride, quasi-static, the worst over its motions.

    Attributes:
        torques_nm: greatest static torque of each joint over the cycle, (18,).
        max_torques_nm: what its servos have, (18,).
        duties: share of the cycle in which a joint needs more than `CONTINUOUS_SHARE` of its torque, (18,).
        deflections_rad: greatest static deflection of each joint, (18,).
        most_sag_m: how far the body frame sinks at most.
        typical_sag_m: how far it sinks at the median over the cycle.
        step_height_m: how high the gait lifts a foot.
        lift_left: least share of the step height that a foot still rises over the floor; 0 where it drags.
        dragging_legs: legs 1..6 whose feet do not leave the floor in some motion.
        capacity: multiple of its weight that the robot carries at the median over the cycle, with forces
            between the feet as helpful as friction allows.
        tipping: share of the cycle in which its centre of mass lies outside all feet; torques and sag are
            those of the rest.
        least_clearance_m: least gap between two neighbouring legs, negative where they overlap.
        nearest_legs: the two legs with the least gap.
        nearest_parts: their parts, of `hexctl.ik.clearance.PARTS`.
        overlap: deepest overlap as a share of both radii, 1 where their axes meet.
        crossing_share: share of the cycle in which the axes of two legs meet.
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
    def possible(self) -> bool:
        """Whether the robot carries its weight and lifts a foot."""
        return not self.obstacles

    @property
    def doubtful(self) -> bool:
        """Whether a warning names what kept some robots from walking in the simulation."""
        soft = self.lift_left < GOOD_LIFT
        return self.possible and (soft or self.crossing or self.tipping > 0 or self.capacity < GOOD_CAPACITY)

    @property
    def crossing(self) -> bool:
        """Whether two legs would have to pass through one another."""
        return self.overlap >= CROSSING_DEPTH

    @property
    def _too_soft(self) -> bool:
        return self.typical_sag_m >= MOST_SAG * self.step_height_m

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Why the robot does not walk this gait, one sentence each; empty where nothing is known."""
        found = []
        if self.tipping > MOST_TIPPING:
            found.append(
                f"it tips over: its centre of mass is outside its feet for {100 * self.tipping:.0f} % of the "
                "cycle"
            )
        elif self.capacity < LEAST_CAPACITY:
            found.append(f"too weak: its servos carry {self.capacity:.2f} of its weight while it walks")
        if self._too_soft:
            found.append(
                f"too soft: its body sinks {1000 * self.typical_sag_m:.0f} mm where a step is "
                f"{1000 * self.step_height_m:.0f} mm high, so no foot leaves the floor"
            )
        return tuple(found)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What may keep the robot from walking well, one sentence each."""
        found = []
        if 0 < self.tipping <= MOST_TIPPING:
            found.append(f"unsteady: it tips over its feet for {100 * self.tipping:.0f} % of the cycle")
        if LEAST_CAPACITY <= self.capacity < GOOD_CAPACITY:
            found.append(
                f"weak: its servos carry {self.capacity:.2f} times its weight while it walks; "
                f"{GOOD_CAPACITY:g} or more is safe"
            )
        if self.lift_left < GOOD_LIFT and not self._too_soft:
            found.append(self._soft())
        if self.crossing:
            found.append(self._cross())
        elif self.least_clearance_m <= 0:
            found.append(f"{self._nearest()} touch")
        hot = int(self.duties.argmax())
        if self.duties[hot] > MOST_DUTY:
            found.append(
                f"hot: {JOINT_NAMES[hot]} holds more than {100 * CONTINUOUS_SHARE:.0f} % of its torque for "
                f"{100 * self.duties[hot]:.0f} % of the cycle; servos overheat above that continuously"
            )
        return tuple(found)

    def _soft(self) -> str:
        """Warning of a robot whose sag takes most of its step height."""
        count, legs = len(self.dragging_legs), ", ".join(str(leg) for leg in self.dragging_legs)
        if self.all_drag:
            (walked, of), left = DRAGGING_WALKS, "no foot leaves the floor"
        elif self.dragging_legs:
            (walked, of) = PARTLY_DRAGGING_WALKS
            left = f"leg{'s' * (count > 1)} {legs} {'do' if count > 1 else 'does'} not leave the floor"
        else:
            (walked, of), left = SOFT_WALKS, f"a foot keeps {100 * self.lift_left:.0f} % of its step height"
        return (
            f"soft: joints give way by up to {self._sag_deg:.1f} deg under the weight; {left}; of {of} such "
            f"robots that were simulated, {walked} made half of their way"
        )

    @property
    def _sag_deg(self) -> float:
        return float(np.degrees(self.deflections_rad.max()))

    def _cross(self) -> str:
        """Warning of legs that would have to pass through one another."""
        walked, of = next((walked, of) for most, walked, of in CROSSING_WALKS if self.crossing_share <= most)
        return (
            f"{self._nearest()} cross for {100 * self.crossing_share:.0f} % of the cycle: of {of} such "
            f"robots that were simulated with solid legs, {walked} made half of their way"
        )

    def _nearest(self) -> str:
        (one, other), (part, other_part) = self.nearest_legs, self.nearest_parts
        return f"legs {one} ({part}) and {other} ({other_part})"

    def to_dict(self) -> dict[str, Any]:
        """Figures of the whole robot as plain values; those of its joints are not among them."""
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
            "doubtful": self.doubtful,
            "legs_cross_share": round(self.crossing_share, 3),
        }


def gait_load(robot: Robot, gait: Gait, motions: Sequence[Motion]) -> GaitLoad:
    """Load of a gait, the worst over the motions."""
    feet, joints = _cycle(robot, gait, motions, LOAD_POINTS)
    load = static_load(robot, joints)
    # A robot that tips over its standing feet comes down on one in the air, and often walks all the same.
    standing = (feet[..., 2] <= robot.stance_feet_body[:, 2] + 1e-9) | (load.foot_forces_n > 0)
    capacity = load_capacity(robot, joints, standing)
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
    """Fields of a load on the two legs with the deepest overlap, or else the least gap."""
    near = leg_clearance(robot, joints)
    worst = near.depths.argmax() if near.depths.any() else near.gaps_m.argmin()
    place = np.unravel_index(int(worst), near.gaps_m.shape)
    leg = int(place[-1])
    part, other_part = (PARTS[int(index)] for index in near.nearest[place])
    return {
        "least_clearance_m": float(near.gaps_m.min()),
        "nearest_legs": (leg + 1, (leg + 1) % N_LEGS + 1),
        "nearest_parts": (part, other_part),
        "overlap": float(near.depths.max()),
        "crossing_share": float((near.depths >= CROSSING_DEPTH).any(axis=-1).mean(axis=-1).max()),
    }


def _cycle(robot: Robot, gait: Gait, motions: Sequence[Motion], count: int) -> tuple[FloatArray, FloatArray]:
    """Feet (motions, count, 6, 3) and joints (motions, count, 18) in the middles of parts of a cycle."""
    time_s = RAMP_DURATION_S + (np.arange(count) + 0.5) / (count * gait.pace_hz)
    feet = np.stack([gait_feet_body(robot, gait, motion, time_s) for motion in motions])
    return feet, solve_legs(robot, feet).joint_positions_rad
