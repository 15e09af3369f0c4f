"""The most stable gait: the code with the largest static stability margin over its cycle."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import body_heading_rad, failed_foot_azimuth_rad
from hexctl.errors import InputError, argument
from hexctl.gait.encoding import Slots, code_count, slots_from_code
from hexctl.gait.foot_trajectory import Swing, in_stance, part_of_cycle, posture_offsets_m, stroke_offset
from hexctl.gait.posture import Posture
from hexctl.ik.support_polygon import centre_of_mass_body, support
from hexctl.robot.failure import Failures, each_failure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import N_LEGS, BoolArray, FloatArray

#: Phases of the cycle at which the margin is evaluated, twice per interval between foot events and at its
#: ends.
PHASES = 48

#: Rounding of directions: a robot that stands a little turned must choose the same gait.
DIRECTION_STEP_RAD = math.radians(15.0)

#: Body raise that lifts a locked, non-trailing foot off the floor, as a fraction of the robot's size. `ant`,
#: `phantomx` and `pexod` then made 0.86, 0.68 and 0.80 of the ideal speed, and 0.75, 0.55 and 0.69 without
#: it. A trailing leg carries well: raising the body costs 0.05.
STAND_UP = 0.012

#: A leg trails if its foot is within this angle of the direction opposite to travel.
TRAILING_RAD = math.radians(45.0)

#: Postures of the gaits of a search: as in the stance, or raised off a locked leg that does not trail.
POSTURES = ("stance", "auto")


def usual_posture(hold: str) -> str:
    """Posture of a search: `stance` in open loop, as in the paper, else `auto`.

    With `auto`, the fastest of 120 gaits of `ant` walked 4.0 to 4.5 m in 30 s; with `stance`, 3.2 to 4.1 m.
    """
    return "stance" if hold == "none" else "auto"


#: Margins within this are equal, such as those of mirrored gaits.
SAME_MARGIN_M = 1e-6


def static_margins_m(
    robot: Robot, slots: Sequence[Slots], *, heading_rad: float, failure: Failures = None
) -> FloatArray:
    """Smallest and mean static margin of gaits over their cycle, (gaits, 2) in m; limp legs do not carry.

    The heading is the direction of travel in the body frame.
    """
    phases = (np.array(slots) - 1) / N_LEGS
    stances = {one.leg: one.kind == "locked" for one in each_failure(failure)}
    feet, standing = feet_over_cycle(robot, phases, heading_rad=heading_rad, stances=stances)
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    margins_m = support(feet, standing, np.broadcast_to(centre, (*feet.shape[:-2], 2))).margin_m
    # Fewer than two feet have no margin: use the distance of the farthest foot.
    margins_m = np.maximum(margins_m, -float(np.linalg.norm(robot.stance_feet_body[:, :2], axis=-1).max()))
    return np.stack([margins_m.min(axis=-1), margins_m.mean(axis=-1)], axis=-1)


def feet_over_cycle(
    robot: Robot,
    phases: FloatArray,
    *,
    heading_rad: float,
    stances: Mapping[int, bool],
    amplitude: float | None = None,
    swing_share: float | None = None,
) -> tuple[FloatArray, BoolArray]:
    """Foot positions over a gait cycle, (gaits, P, 6, 2) in m, and stance flags, (gaits, P, 6).

    Args:
        phases: as `Gait.leg_phases`, (gaits, 6).
        stances: legs that stay in their stance, and whether they are on the floor there.
        swing_share: None is a third.
    """
    # Half a step off the corners of Eq. 3 and 4, at which a foot both stands and swings.
    cycles = (np.arange(PHASES) + 0.5) / PHASES
    u = part_of_cycle(cycles[:, np.newaxis] + phases[:, np.newaxis, :])  # (gaits, P, 6)
    swing = None if swing_share is None else Swing.of(np.array(swing_share))
    amplitude = robot.gait.amplitude if amplitude is None else amplitude
    stroke_m = amplitude * robot.size_m * stroke_offset(u, swing)
    direction = np.array([math.cos(heading_rad), math.sin(heading_rad)])
    offsets, standing = -stroke_m[..., np.newaxis] * direction, in_stance(u, swing)
    for leg, on_floor in stances.items():
        standing[..., leg - 1] = on_floor
        offsets[..., leg - 1, :] = 0.0
    return robot.stance_feet_body[:, :2] + offsets, standing


def legs_that_stand(plan: TrialPlan) -> tuple[int, ...]:
    """Legs expected to carry while none swings: not tucked, limp, missing, or held off the floor."""
    posture = plan.gait.posture
    lost = set(posture.tucked_legs)
    lost |= {one.leg for one in plan.failures if one.kind in ("limp", "missing") and one.joint is None}
    if posture.body_raise > 0:
        lost |= set(plan.held_legs)
    return tuple(leg for leg in range(1, N_LEGS + 1) if leg not in lost)


def standing_margin_m(robot: Robot, plan: TrialPlan) -> float:
    """Static stability margin of a plan's robot on `legs_that_stand`, in m; -inf with fewer than two."""
    standing = np.isin(np.arange(1, N_LEGS + 1), legs_that_stand(plan))
    offsets_m = posture_offsets_m(robot, plan.gait.posture)[:, :2]
    offsets_m[[leg - 1 for leg in plan.held_legs]] = 0.0
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    return float(support(robot.stance_feet_body[:, :2] + offsets_m, standing, centre).margin_m)


def check_tucked(robot: Robot, plan: TrialPlan) -> None:
    """Raise InputError for a plan that tucks legs without which the robot cannot stand."""
    tucked = plan.gait.posture.tucked_legs
    if not tucked or (margin_m := standing_margin_m(robot, plan)) > SAME_MARGIN_M:
        return
    legs = legs_that_stand(plan)
    margin = f"a static margin of {1000 * margin_m + 0.0:.0f} mm" if len(legs) > 1 else "no static margin"
    raise InputError(
        f"{argument('tucked_legs')}: got {','.join(map(str, tucked))}; the other legs that carry "
        f"({', '.join(map(str, legs)) or 'none'}) have {margin}; allowed: legs without which it is above 0, "
        f"where {argument('stance_shift')} counts"
    )


def slots_by_stability(robot: Robot, *, heading_rad: float, failure: Failures = None) -> list[Slots]:
    """Slots of all gaits, largest margin first, then mean margin and code; intact leg 1 is pinned."""
    pinned = tuple(sorted(one.leg for one in each_failure(failure))) or (1,)
    slots = [slots_from_code(code, pinned) for code in range(1, code_count(pinned) + 1)]
    margins_m = static_margins_m(robot, slots, heading_rad=_rounded_rad(heading_rad), failure=failure)
    rounded = np.round(margins_m / SAME_MARGIN_M)
    order = np.lexsort((np.arange(len(slots)), -rounded[:, 1], -rounded[:, 0]))
    return [slots[place] for place in order.tolist()]


def _rounded_rad(heading_rad: float) -> float:
    return DIRECTION_STEP_RAD * round(heading_rad / DIRECTION_STEP_RAD)


def most_stable_slots(robot: Robot, *, heading_rad: float, failure: Failures = None) -> Slots:
    """The first slots of `slots_by_stability`."""
    return slots_by_stability(robot, heading_rad=heading_rad, failure=failure)[0]


def stood_up(robot: Robot, plan: TrialPlan) -> Posture:
    """Posture of a plan's gait; a level body stands up by `STAND_UP` off a locked leg that does not trail."""
    posture = plan.gait.posture
    if posture.body_raise or [one.kind for one in plan.failures] != ["locked"]:
        return posture
    heading_rad = body_heading_rad(robot, plan)
    off_rear_rad = wrapped_rad(failed_foot_azimuth_rad(robot, plan.failures[0]) - heading_rad - math.pi)
    return replace(posture, body_raise=STAND_UP) if abs(off_rear_rad) > TRAILING_RAD else posture


def in_posture(robot: Robot, plan: TrialPlan, posture: str) -> TrialPlan:
    """A plan whose gait stands in one of `POSTURES`; raises InputError for another."""
    if posture not in POSTURES:
        raise InputError(f"{argument('posture')}: got {posture}; allowed: {', '.join(POSTURES)}")
    if posture == "stance":
        return plan
    return replace(plan, gait=replace(plan.gait, posture=stood_up(robot, plan)))


def stable_slots_of(robot: Robot, plan: TrialPlan) -> Slots:
    """Slots of the most stable gait for the walk of a plan, after its self-rotation."""
    return most_stable_slots(robot, heading_rad=body_heading_rad(robot, plan), failure=plan.failures)


def margin_m_of(robot: Robot, plan: TrialPlan, slots: Slots) -> float:
    """Smallest static stability margin in m of a gait in the walk of a plan, after its self-rotation."""
    heading_rad = _rounded_rad(body_heading_rad(robot, plan))
    return float(static_margins_m(robot, [slots], heading_rad=heading_rad, failure=plan.failures)[0, 0])
