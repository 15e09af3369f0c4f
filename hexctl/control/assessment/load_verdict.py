"""Verdict on the load of a gait: obstacles and warnings.

Thresholds are from surveys of random simulated robots: which of them made half of their distance.
"""

from dataclasses import dataclass

import numpy as np

from hexctl.control.assessment.gait_load import CONTINUOUS_SHARE, GaitLoad
from hexctl.types import JOINT_NAMES

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

#: Robots with crossing legs, simulated with solid legs: up to a share of the cycle with crossing legs, how
#: many made half of the distance, of how many that did with legs that pass through one another.
CROSSING_WALKS = ((0.25, 18, 20), (1.0, 16, 20))

#: Robots whose sag leaves a foot less than a third of its step, simulated for 30 s: how many made half of the
#: distance, of how many, if all feet drag, some do, or none does.
DRAGGING_WALKS, PARTLY_DRAGGING_WALKS, SOFT_WALKS = (2, 20), (12, 20), (17, 20)

#: The same for robots that carry between `LEAST_CAPACITY` and `GOOD_CAPACITY` of their weight.
WEAK_WALKS = (6, 20)


@dataclass(frozen=True, slots=True)
class LoadVerdict:
    """Verdict on a load; obstacles forbid the gait, doubtful is what stopped some simulated robots."""

    obstacles: tuple[str, ...]
    warnings: tuple[str, ...]
    doubtful: bool

    @property
    def possible(self) -> bool:
        """Whether the robot carries its weight and lifts a foot."""
        return not self.obstacles


def load_verdict(load: GaitLoad) -> LoadVerdict:
    """Verdict on the load of a gait."""
    obstacles = tuple(filter(None, (_tips_over(load) or _too_weak(load), _too_soft(load))))
    telling = tuple(
        filter(None, (_unsteady(load), _weak(load) or _overloaded(load), _soft(load), _cross(load)))
    )
    return LoadVerdict(
        obstacles=obstacles,
        warnings=(*telling, *filter(None, (_touch(load), _hot(load)))),
        doubtful=bool(telling) and not obstacles,
    )


def _tips_over(load: GaitLoad) -> str:
    if load.tipping <= MOST_TIPPING:
        return ""
    return f"it tips over: its centre of mass is outside its feet for {100 * load.tipping:.0f} % of the cycle"


def _too_weak(load: GaitLoad) -> str:
    if load.capacity >= LEAST_CAPACITY:
        return ""
    return f"too weak: its servos carry {load.capacity:.2f} of its weight while it walks"


def _too_soft(load: GaitLoad) -> str:
    if load.typical_sag_m < MOST_SAG * load.step_height_m:
        return ""
    return (
        f"too soft: its body sinks {1000 * load.typical_sag_m:.0f} mm and a step is "
        f"{1000 * load.step_height_m:.0f} mm high, so no foot leaves the floor"
    )


def _unsteady(load: GaitLoad) -> str:
    if not 0 < load.tipping <= MOST_TIPPING:
        return ""
    return f"unsteady: it tips over its feet for {100 * load.tipping:.0f} % of the cycle"


def _weak(load: GaitLoad) -> str:
    if not LEAST_CAPACITY <= load.capacity < GOOD_CAPACITY:
        return ""
    return (
        f"weak: its servos carry {load.capacity:.2f} times its weight while it walks; "
        f"of {WEAK_WALKS[1]} robots below {GOOD_CAPACITY:g} that were simulated, "
        f"{WEAK_WALKS[0]} walked half of the distance"
    )


def _overloaded(load: GaitLoad) -> str:
    shares = load.torques_nm / load.max_torques_nm
    if shares.max() <= 1 or not _carries(load):
        return ""
    names = ", ".join(JOINT_NAMES[joint] for joint in np.flatnonzero(shares > 1))
    return f"overloaded: {names} would need up to {100 * shares.max():.0f} % of their torque"


def _carries(load: GaitLoad) -> bool:
    return not (_tips_over(load) or _too_weak(load))


def _soft(load: GaitLoad) -> str:
    if load.lift_left >= GOOD_LIFT or _tips_over(load) or _too_soft(load):
        return ""
    count, legs = len(load.dragging_legs), ", ".join(str(leg) for leg in load.dragging_legs)
    if load.all_drag:
        (walked, of), left = DRAGGING_WALKS, "no foot leaves the floor"
    elif load.dragging_legs:
        (walked, of) = PARTLY_DRAGGING_WALKS
        left = f"leg{'s' * (count > 1)} {legs} {'do' if count > 1 else 'does'} not leave the floor"
    else:
        (walked, of), left = SOFT_WALKS, f"a foot keeps {100 * load.lift_left:.0f} % of its step height"
    sag_deg = float(np.degrees(load.deflections_rad.max()))
    return (
        f"soft: joints give way by up to {sag_deg:.1f} deg under the weight; {left}; of {of} such "
        f"robots that were simulated, {walked} walked half of the distance"
    )


def _cross(load: GaitLoad) -> str:
    if not load.crossing:
        return ""
    walked, of = next((walked, of) for most, walked, of in CROSSING_WALKS if load.crossing_share <= most)
    return (
        f"{_nearest(load)} cross for {100 * load.crossing_share:.0f} % of the cycle: of {of} such "
        f"robots that were simulated with solid legs, {walked} walked half of the distance"
    )


def _touch(load: GaitLoad) -> str:
    return f"{_nearest(load)} touch" if load.least_clearance_m <= 0 and not load.crossing else ""


def _nearest(load: GaitLoad) -> str:
    (one, other), (part, other_part) = load.nearest_legs, load.nearest_parts
    return f"legs {one} ({part}) and {other} ({other_part})"


def _hot(load: GaitLoad) -> str:
    hot = int(load.duties.argmax())
    if load.duties[hot] <= MOST_DUTY:
        return ""
    return (
        f"hot: {JOINT_NAMES[hot]} holds more than {100 * CONTINUOUS_SHARE:.0f} % of its torque for "
        f"{100 * load.duties[hot]:.0f} % of the cycle; servos overheat above that continuously"
    )
