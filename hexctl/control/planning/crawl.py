"""Gaits with evenly spread swings: the crawl, with one foot in the air at a time, and `two_up`.

Most of the 24 codes for two lost legs tip the robot. A crawl on n legs has phases i/n and a swing share below
1/n. Leg order and body shift maximize the static stability margin.
"""

import math
from collections.abc import Sequence
from dataclasses import replace
from functools import lru_cache
from itertools import permutations

import numpy as np

from hexctl.control.planning.static_stability import (
    DIRECTION_STEP_RAD,
    SAME_MARGIN_M,
    STAND_UP,
    feet_over_cycle,
    most_stable_slots,
    stable_slots_of,
    stood_up,
)
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import body_heading_rad
from hexctl.gait.encoding import Slots
from hexctl.gait.foot_trajectory import StepPattern, feet_at_phases
from hexctl.gait.gait import SWING_SHARE, Gait
from hexctl.gait.posture import POSTURE, Posture
from hexctl.ik.legs import legs_that_reach
from hexctl.ik.support_polygon import centre_of_mass_body, margins_at_m
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, BoolArray, FloatArray

#: Part of a cycle that a foot is in the air on four legs; scaled by 4/n on n legs.
CRAWL_SWING = 0.22

#: Maximum lean of a code, as a share of the stance radius; codes for opposite lost legs lean by 0.03 to 0.06.
CODE_LEAN = 0.1

#: Candidate shifts of the body: lengths as shares of the stance radius, and the number of directions.
SHIFT_LENGTHS = tuple(0.05 * step for step in range(1, 9))
SHIFT_DIRECTIONS = 24

#: Points of a cycle at which feet must be in reach, in addition to the ends of their strokes.
REACH_POINTS = 24


def gait_without(robot: Robot, gait: Gait, *, heading_rad: float, legs: tuple[int, ...]) -> Gait:
    """The most stable gait with some legs tucked, otherwise as `gait`; the heading is in the body frame.

    It is a code for one lost leg, or if the code leans by at most `CODE_LEAN`; otherwise a crawl.
    """
    lost = tuple(sorted({*legs, *gait.posture.tucked_legs}))
    return _gait_without(robot, _plain(gait, lost), round(heading_rad / DIRECTION_STEP_RAD), lost)


def least_margin_m(robot: Robot, gait: Gait, *, heading_rad: float) -> float:
    """Smallest static stability margin over a gait cycle, in m; -inf with fewer than two standing feet."""
    feet, standing = feet_over_cycle(
        robot,
        np.array([gait.leg_phases]),
        heading_rad=heading_rad,
        stances=dict.fromkeys(gait.posture.tucked_legs, False),
        amplitude=gait.amplitude,
        swing_share=gait.swing_share,
    )
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    shifted = centre + robot.size_m * np.array(gait.posture.shift)
    return float(margins_at_m(feet, standing, shifted[np.newaxis]).min())


def auto_gait(robot: Robot, plan: TrialPlan, *, stand_up: bool = True) -> Gait:
    """The most stable gait of a plan after its self-rotation, or `gait_without` for several failed legs.

    `stand_up` raises a level body.
    """
    posture = plan.gait.posture
    if len(plan.failures) < 2:
        posture = stood_up(robot, plan) if stand_up else posture
        return replace(plan.gait, slots=stable_slots_of(robot, plan), posture=posture)
    if stand_up:
        posture = replace(posture, body_raise=posture.body_raise or STAND_UP)
    gait = replace(plan.gait, posture=posture)
    return gait_without(robot, gait, heading_rad=body_heading_rad(robot, plan), legs=plan.failed_legs)


def _plain(gait: Gait, lost: tuple[int, ...]) -> Gait:
    shift = gait.posture.shift if len(lost) < 2 else (0.0, 0.0)
    posture = Posture(body_raise=gait.posture.body_raise, shift=shift, tucked_legs=lost)
    return Gait(
        slots=tuple(range(1, N_LEGS + 1)),
        pace_hz=gait.pace_hz,
        amplitude=gait.amplitude,
        height=gait.height,
        posture=posture,
        swing_share=gait.swing_share if len(lost) < 2 else SWING_SHARE,
    )


@lru_cache(maxsize=4096)
def _gait_without(robot: Robot, gait: Gait, direction: int, lost: tuple[int, ...]) -> Gait:
    heading_rad = DIRECTION_STEP_RAD * direction
    failures = [Failure(leg=leg, kind="limp") for leg in lost]
    slots = most_stable_slots(robot, heading_rad=heading_rad, failure=failures)
    coded = replace(gait, slots=slots)
    if len(lost) < 2:
        return coded
    if least_margin_m(robot, coded, heading_rad=heading_rad) >= -CODE_LEAN * robot.stance_radius_m:
        return coded
    return crawl_on(robot, gait, heading_rad=heading_rad) or coded


def crawl_on(robot: Robot, gait: Gait, *, heading_rad: float) -> Gait | None:
    """The most stable crawl on the untucked legs, otherwise like `gait`; None if no shift is in reach."""
    share = CRAWL_SWING * 4 / max(4, len(_walking(gait)))
    shifts = _shifts(robot)
    shifts = shifts[_in_reach(robot, replace(gait, swing_share=share), heading_rad)]
    return _spread(robot, gait, heading_rad, share, shifts) if len(shifts) else None


def two_up(robot: Robot, gait: Gait, *, heading_rad: float) -> Gait:
    """The most stable gait with two of the n untucked legs in the air at any time, otherwise like `gait`.

    Phases are i/n and the swing share is 2/n. With five legs, swings take a fifth longer than in a code, and
    three feet always stand; in a code with this swing share sometimes only two do.
    """
    return _two_up(robot, gait, round(heading_rad / DIRECTION_STEP_RAD))


@lru_cache(maxsize=1024)
def _two_up(robot: Robot, gait: Gait, direction: int) -> Gait:
    share, shift_m = 2 / len(_walking(gait)), np.array([gait.posture.shift]) * robot.size_m
    return _spread(robot, gait, DIRECTION_STEP_RAD * direction, share, shift_m)


def _walking(gait: Gait) -> list[int]:
    return [leg for leg in range(1, N_LEGS + 1) if leg not in gait.posture.tucked_legs]


def _spread(robot: Robot, gait: Gait, heading_rad: float, share: float, shifts: FloatArray) -> Gait:
    """The most stable order and shift with evenly spread phases; shifts are (n, 2) in m."""
    walking = _walking(gait)
    phases = _orders(walking)
    feet, standing = feet_over_cycle(
        robot,
        phases,
        heading_rad=heading_rad,
        stances=dict.fromkeys(gait.posture.tucked_legs, False),
        amplitude=gait.amplitude,
        swing_share=share,
    )
    centre = centre_of_mass_body(robot, robot.stance_angles_rad)[:2]
    margins_m = margins_at_m(feet, standing, centre + shifts)  # (shifts, orders, P)
    least_m, mean_m = margins_m.min(axis=-1), margins_m.mean(axis=-1)
    # Largest smallest margin first; ties by the largest mean, the shortest shift, the first order.
    rank = np.lexsort((-np.round(mean_m / SAME_MARGIN_M).ravel(), -np.round(least_m / SAME_MARGIN_M).ravel()))
    shift, order = np.unravel_index(rank[0], least_m.shape)
    forward, left = (np.round(shifts[shift] / robot.size_m, 6) + 0.0).tolist()
    return replace(
        gait,
        slots=_slots_of(phases[order], walking),
        phases=tuple(phases[order].tolist()),
        swing_share=share,
        posture=replace(gait.posture, shift=(forward, left)),
    )


def _orders(walking: Sequence[int]) -> FloatArray:
    """Phases of all crawls on the walking legs, i/n each, (orders, 6); 0 for other legs."""
    orders = [(walking[0], *rest) for rest in permutations(walking[1:])]
    phases = np.zeros((len(orders), N_LEGS))
    for row, order in zip(phases, orders, strict=True):
        row[[leg - 1 for leg in order]] = np.arange(len(order)) / len(order)
    return phases


def _slots_of(phases: FloatArray, walking: Sequence[int]) -> Slots:
    """Slots in which the walking legs swing in the order of their phases."""
    slots = list(range(1, N_LEGS + 1))
    for slot, leg in zip(walking, sorted(walking, key=lambda leg: phases[leg - 1]), strict=True):
        slots[leg - 1] = slot
    return tuple(slots)


def _shifts(robot: Robot) -> FloatArray:
    """Candidate shifts of the body, shortest first, (shifts, 2) in m."""
    angles = 2 * math.pi * np.arange(SHIFT_DIRECTIONS) / SHIFT_DIRECTIONS
    ways = np.stack([np.cos(angles), np.sin(angles)], axis=-1)
    lengths_m = robot.stance_radius_m * np.array(SHIFT_LENGTHS)
    longer = (lengths_m[:, np.newaxis, np.newaxis] * ways).reshape(-1, 2)
    allowed = (np.abs(longer) <= POSTURE.high * robot.size_m).all(axis=-1)
    return np.concatenate([np.zeros((1, 2)), longer[allowed]])


def _in_reach(robot: Robot, gait: Gait, heading_rad: float) -> BoolArray:
    """Which shifts allow full strokes of the walking legs, (shifts,)."""
    walking = [leg - 1 for leg in _walking(gait)]
    posture = replace(gait.posture, shift=(0.0, 0.0), tucked_legs=())
    return np.asarray(_reach(robot, replace(gait, posture=posture), heading_rad)[:, walking].all(axis=-1))


@lru_cache(maxsize=64)
def _reach(robot: Robot, gait: Gait, heading_rad: float) -> BoolArray:
    turning = [(1 - gait.swing_share) / 2, (1 + gait.swing_share) / 2]  # phases of the longest strokes
    points = np.concatenate([turning, np.arange(REACH_POINTS) / REACH_POINTS])
    u = np.broadcast_to(points[:, np.newaxis], (len(points), N_LEGS))
    stroke_m = -gait.amplitude * robot.size_m * np.array([math.cos(heading_rad), math.sin(heading_rad)])
    pattern = StepPattern.of(robot, gait, plain=False)
    feet = feet_at_phases(robot, pattern, u, np.broadcast_to(stroke_m, (N_LEGS, 2)), 1.0)  # (P, 6, 3)
    shifts = _shifts(robot)
    moved = np.zeros((len(shifts), 1, N_LEGS, 3))
    moved[..., :2] = -shifts[:, np.newaxis, np.newaxis]
    return np.asarray(legs_that_reach(robot, feet + moved).all(axis=1))
