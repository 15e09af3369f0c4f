"""Sets of legs that a robot can lose and still walk, by the static margin."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np

from hexctl.control.planning.crawl import CODE_LEAN, gait_without, least_margin_m
from hexctl.control.planning.static_stability import STAND_UP
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import N_LEGS

#: A crawl is expected to walk if it leans out of its support by at most this share of the stance radius. Limp
#: and missing pairs made 0.6 of the speed up to 0.40 (`ant`), and 0.4 and 0.3 at 0.43 (`phantomx`) and 0.57
#: (`pexod`), see docs/explanation/gaits.md.
CRAWL_LEAN = 0.42

#: Limp neighbours drag if the mean of their unit vectors is at least this long, and this near to the
#: direction of travel: such pairs of `ant` made 0.1 to 0.3 of the speed, other pairs 0.6.
TOGETHER, AHEAD_RAD = 0.75, math.radians(45.0)

#: Verdicts on a set of legs, best first.
VERDICTS = ("walks", "crawls", "doubtful", "no gait")
WALKS, CRAWLS, DOUBTFUL, NO_GAIT = VERDICTS

#: Default directions of travel.
DIRECTIONS_RAD = tuple(math.radians(degrees) for degrees in (0, 90, 180, 270))

#: Maximum number of lost legs: with four, two feet are left.
MOST_JUDGED = 3

#: Maximum number of legs that may carry nothing: of the others three carry while one swings.
MOST_LOST = N_LEGS - 4


@dataclass(frozen=True, slots=True, kw_only=True)
class LegSet:
    """Verdict on a set of legs that carry nothing.

    Attributes:
        margin: smallest static margin in the worst direction, as a share of the stance radius; may be -inf.
        crawl: whether the most stable gait is a crawl.
        verdict: `walks`, a code that leans by `CODE_LEAN` at most; `crawls`, a crawl that leans by
            `CRAWL_LEAN` at most; `doubtful`, one that leans by more; `no gait`, fewer than four legs.
    """

    legs: tuple[int, ...]
    margin: float
    crawl: bool
    verdict: str

    def to_dict(self) -> dict[str, Any]:
        """JSON values; a margin of -inf is null."""
        margin = round(self.margin, 3) if math.isfinite(self.margin) else None
        return {"legs": list(self.legs), "margin": margin, "crawl": self.crawl, "verdict": self.verdict}


def leg_set(
    robot: Robot, gait: Gait, legs: Sequence[int], directions_rad: Sequence[float] = DIRECTIONS_RAD
) -> LegSet:
    """Verdict on lost legs 1..6 in the worst direction; a level body is raised by `STAND_UP`."""
    posture = replace(gait.posture, body_raise=gait.posture.body_raise or STAND_UP)
    raised, lost = replace(gait, posture=posture), tuple(sorted(set(legs)))
    worst, crawl = math.inf, False
    for heading_rad in directions_rad:
        judged = gait_without(robot, raised, heading_rad=heading_rad, legs=lost)
        margin = least_margin_m(robot, judged, heading_rad=heading_rad) / robot.stance_radius_m
        if margin < worst:
            worst, crawl = margin, judged.phases is not None
    return LegSet(legs=lost, margin=worst, crawl=crawl, verdict=_verdict(len(lost), worst, crawl))


def doubt(judged: LegSet) -> str | None:
    """Why a robot may not walk without a set of legs, in a sentence; None if it is expected to walk."""
    if judged.verdict in (WALKS, CRAWLS):
        return None
    without = f"without leg{'s' * (len(judged.legs) > 1)} {', '.join(map(str, judged.legs))}"
    if judged.verdict == NO_GAIT:
        return f"{without} no gait keeps the robot up: only {N_LEGS - len(judged.legs)} carry, and one swings"
    beyond = f"beyond {CRAWL_LEAN:g} most fail" if judged.crawl else f"only up to {CODE_LEAN:g} was tried"
    return (
        f"whether the robot walks {without} is doubtful: the safest gait leans out of its support by "
        f"{-judged.margin:.2f} of the radius of the stance, and {beyond}; see hexctl check --leg-sets"
    )


def drag(robot: Robot, failures: Sequence[Failure], heading_rad: float) -> str | None:
    """Warning of limp neighbours ahead that drag on the floor, in a sentence, or None."""
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
    most_lean, verdict = (CRAWL_LEAN, CRAWLS) if crawl else (CODE_LEAN, WALKS)
    return DOUBTFUL if margin < -most_lean else verdict


def leg_sets(robot: Robot, gait: Gait, directions_rad: Sequence[float]) -> list[LegSet]:
    """Verdicts on all sets of one leg up to `MOST_JUDGED`."""
    legs, counts = range(1, N_LEGS + 1), range(1, MOST_JUDGED + 1)
    return [
        leg_set(robot, gait, lost, directions_rad) for count in counts for lost in combinations(legs, count)
    ]
