"""Which sets of legs a robot can lose and still walk, by the static margin, before anything moves."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from hexctl.control.assessment.crawl import CODE_LEAN, gait_without, least_margin_m
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import N_LEGS

#: A crawl leans out of its support by no more than this, as a share of the radius of the stance, where it is
#: expected to walk: up to 0.40 (`ant`) limp and missing pairs did so at 0.6 of the speed, from 0.43
#: (`phantomx`) and 0.57 (`pexod`) on at 0.4 and 0.3 (docs/gait.md).
CRAWL_LEAN = 0.42

#: Limp neighbours, whose directions have a mean at least as long as this, drag where that is nearer to the
#: direction of travel than this: pairs of `ant` then made 0.1 to 0.3 of the speed, and 0.6 otherwise.
TOGETHER, AHEAD_RAD = 0.75, math.radians(45.0)

#: Verdicts on a set of legs, from the safest on.
VERDICTS = ("walks", "crawls", "doubtful", "no gait")
WALKS, CRAWLS, DOUBTFUL, NO_GAIT = VERDICTS

#: Directions of travel in which sets are judged where none is asked for.
DIRECTIONS_RAD = tuple(math.radians(degrees) for degrees in (0, 90, 180, 270))

#: Sets are judged up to this number of lost legs; without four, two feet are left.
MOST_JUDGED = 3

#: Legs that may carry nothing: of the others three carry while one swings.
MOST_LOST = N_LEGS - 4


@dataclass(frozen=True, slots=True, kw_only=True)
class LegSet:
    """Verdict on a set of legs that carry nothing.

    Attributes:
        legs: ascending.
        margin: smallest static stability margin over the cycle of the safest gait, as a share of the radius
            of the stance, in the worst direction of travel; negative where the robot tips for a moment, -inf
            where fewer than two feet stand at some time.
        crawl: whether that gait is a crawl; in other directions it may be a code, or the other way round.
        verdict: on that gait, one of `VERDICTS`. `walks`: a code that leans by `CODE_LEAN` at most.
            `crawls`: a crawl that leans by `CRAWL_LEAN` at most. `doubtful`: a gait that leans by more.
            `no gait`: fewer than four legs, so that two feet or fewer carry while one swings.
    """

    legs: tuple[int, ...]
    margin: float
    crawl: bool
    verdict: str

    def to_dict(self) -> dict[str, Any]:
        """JSON values; the margin is null where there is none."""
        margin = round(self.margin, 3) if math.isfinite(self.margin) else None
        return {"legs": list(self.legs), "margin": margin, "crawl": self.crawl, "verdict": self.verdict}


def leg_set(
    robot: Robot, gait: Gait, legs: Sequence[int], directions_rad: Sequence[float] = DIRECTIONS_RAD
) -> LegSet:
    """Verdict on a set of legs, in the worst direction.

    Args:
        robot: who walks.
        gait: its pace, amplitude, height and body raise, the body a little up without one.
        legs: that carry nothing.
        directions_rad: of travel in the body frame.
    """
    posture = replace(gait.posture, body_raise=gait.posture.body_raise or STAND_UP)
    raised, lost = replace(gait, posture=posture), tuple(sorted(set(legs)))
    worst, crawl = math.inf, False
    for heading_rad in directions_rad:
        found = gait_without(robot, raised, heading_rad=heading_rad, legs=lost)
        margin = least_margin_m(robot, found, heading_rad=heading_rad) / robot.stance_radius_m
        if margin < worst:
            worst, crawl = margin, found.phases is not None
    return LegSet(legs=lost, margin=worst, crawl=crawl, verdict=_verdict(len(lost), worst, crawl))


def doubt(found: LegSet) -> str | None:
    """Why a robot that has lost a set of legs may not walk, in a sentence; None where it is expected to."""
    if found.verdict in (WALKS, CRAWLS):
        return None
    without = f"without leg{'s' * (len(found.legs) > 1)} {', '.join(map(str, found.legs))}"
    if found.verdict == NO_GAIT:
        return f"{without} no gait keeps the robot up: only {N_LEGS - len(found.legs)} carry, and one swings"
    beyond = f"beyond {CRAWL_LEAN:g} most fail" if found.crawl else f"only up to {CODE_LEAN:g} was tried"
    return (
        f"whether the robot walks {without} is doubtful: the safest gait leans out of its support by "
        f"{-found.margin:.2f} of the radius of the stance, and {beyond}; see hexctl check --leg-sets"
    )


def drag(robot: Robot, failures: Sequence[Failure], heading_rad: float) -> str | None:
    """That limp neighbours ahead drag on the floor, in a sentence; None where there are none.

    Args:
        robot: geometry.
        failures: of all failed legs.
        heading_rad: direction of travel in the body frame.
    """
    limp = [one.leg for one in failures if one.kind == "limp" and one.joint is None]
    if len(limp) < 2:
        return None
    azimuths_rad = robot.leg_azimuths_rad[[leg - 1 for leg in limp]]
    forward, left = np.cos(azimuths_rad).mean(), np.sin(azimuths_rad).mean()
    off_rad = abs(wrapped_rad(math.atan2(left, forward) - heading_rad))
    if math.hypot(forward, left) < TOGETHER or off_rad > AHEAD_RAD:
        return None
    return (
        f"limp legs {' and '.join(map(str, limp))} are ahead and drag on the floor, which takes half of the "
        "speed or more; in another direction they drag less"
    )


def _verdict(lost: int, margin: float, crawl: bool) -> str:
    if lost > MOST_LOST:
        return NO_GAIT
    if margin < -_most_lean(crawl):
        return DOUBTFUL
    return CRAWLS if crawl else WALKS


def _most_lean(crawl: bool) -> float:
    """By how much a crawl or a code may lean, as a share of the radius of the stance."""
    return CRAWL_LEAN if crawl else CODE_LEAN


def leg_sets(
    robot: Robot, gait: Gait, directions_rad: Sequence[float] = DIRECTIONS_RAD, most: int = 2
) -> list[LegSet]:
    """Verdicts on all sets of one leg up to `most`, `MOST_JUDGED` at most."""
    legs = range(1, N_LEGS + 1)
    counts = range(1, min(most, MOST_JUDGED) + 1)
    return [
        leg_set(robot, gait, lost, directions_rad) for count in counts for lost in combinations(legs, count)
    ]
