"""The plan of a trial: a plain, picklable value."""

import math
from dataclasses import dataclass
from itertools import pairwise
from typing import Final, Literal, get_args

from hexctl.errors import InputError, argument, check_type
from hexctl.gait.gait import Gait, Motion
from hexctl.options import Range
from hexctl.robot.failure import UNKNOWN, Failure, check_further, each_failure

SelfRotation = Literal["rear", "front", "none"]
SELF_ROTATIONS = get_args(SelfRotation)

_THEN = argument("then")

#: What a walk holds by feedback; `auto` is the best that the robot allows.
Hold = Literal["auto", "line", "heading", "none"]
HOLDS = get_args(Hold)

#: Whether feet follow the trajectory of the gait, or search for the ground below it.
Feet = Literal["planned", "adaptive"]
FEET = get_args(Feet)

DURATION_S = Range(low=0, high=86_400, above=True, unit="s")

HEADING_DEG = Range(low=-360, high=360, unit="deg", degrees=True)

TURN_DEG_S = Range(low=-360, high=360, unit="deg/s", degrees=True)

#: Asks for the self-rotation that suits a walk.
AUTO_ROTATION: Final = "auto"
AskedRotation = Literal["auto", "rear", "front", "none"]

#: A larger course error is not trimmed: the robot is not walking ahead.
TRIM_DEG = Range(low=-45, high=45, degrees=True)
MAX_TRIM_RAD = math.radians(TRIM_DEG.high)

#: A larger curve, 120 degrees in 30 s, is not trimmed either.
TURN_TRIM_DEG_S = Range(low=-4, high=4, unit="deg/s", degrees=True)
MAX_TURN_TRIM_RAD_S = math.radians(TURN_TRIM_DEG_S.high)


def suited_rotation(self_rotation: str, hold: str, *, chosen_gait: bool) -> str:
    """The self-rotation asked for, or for `auto` the one that suits a walk.

    A turn gains no speed with a held line and a gait chosen for the failed leg. Otherwise the leg turns to
    the rear, as in the paper: with only the yaw that halves the deviation, and gaits for six legs are faster.
    """
    if self_rotation != AUTO_ROTATION:
        return self_rotation
    return "none" if chosen_gait and hold in ("auto", "line") else "rear"


@dataclass(frozen=True, slots=True, kw_only=True)
class GaitChange:
    """A change of gait in stride, `at_s` after the walk began."""

    gait: Gait
    at_s: float

    def __post_init__(self) -> None:
        check_type(self.gait, Gait, "change.gait", "a Gait, as make_gait(robot, 'wave') gives")
        check_type(self.at_s, float, "change.at_s")
        if not (math.isfinite(self.at_s) and 0 <= self.at_s <= DURATION_S.high):
            raise InputError(f"{_THEN}: got {self.at_s:g} s; allowed: 0 up to {DURATION_S.high:g} s")

    def __str__(self) -> str:
        """Slots and time, as `--then` takes them."""
        return f"{','.join(map(str, self.gait.slots))}@{self.at_s:g}"


@dataclass(frozen=True, slots=True, kw_only=True)
class TrialPlan:
    """Settle, turn a failed leg away, walk, stop.

    Attributes:
        heading_rad: direction of travel, from the initial direction of the body.
        travel: 1 to travel, 0 to stay on the spot.
        turn_rate_rad_s: commanded yaw rate during the walk.
        duration_s: of the walk, with the soft start, without the soft stop.
        belief: the failure that the controller knows, or None; `locked` and `unknown` legs are held in their
            stance pose. A simulation gets its own failures.
        self_rotation: where the failed leg points during the walk: `rear`, `front` or `none` (as it is).
        turn_rad: turn before the walk, instead of `self_rotation`; None to follow it.
        settle_s: time to reach the stance and come to rest; up to 1.5 s longer if the yaw is noisy.
        hold: one of `HOLDS`; `none` is open loop, as in the paper.
        changes: of the gait, in stride, ascending in time.
        trim_rad: counter-clockwise correction of the course from earlier walks, under the hold `heading` or,
            with a `turn_trim_rad_s`, in open loop.
        turn_trim_rad_s: in open loop, a counter-clockwise turn that removes the curve of earlier walks; None
            for a walk without a trim.
        further_failures: of other legs that the controller knows, by leg; only `turn_rad` turns then.
        level: whether the body is kept level by its measured roll and pitch.
        feet: one of `FEET`; `adaptive` ones search for the ground, with foot contacts.
    """

    gait: Gait
    heading_rad: float = 0.0
    travel: float = 1.0
    turn_rate_rad_s: float = 0.0
    duration_s: float = 30.0
    belief: Failure | None = None
    self_rotation: str = "rear"
    turn_rad: float | None = None
    settle_s: float = 1.0
    hold: str = "none"
    changes: tuple[GaitChange, ...] = ()
    trim_rad: float = 0.0
    turn_trim_rad_s: float | None = None
    further_failures: tuple[Failure, ...] = ()
    level: bool = False
    feet: str = "planned"

    def __post_init__(self) -> None:
        check_type(self.gait, Gait, "plan.gait", "a Gait, as make_gait(robot, 'tripod') gives")
        check_type(self.belief, (Failure, type(None)), "plan.belief", "a Failure, as Failure(leg=5), or None")
        check_further(self.belief, self.further_failures, "plan.further_failures")
        object.__setattr__(self, "further_failures", each_failure(self.further_failures))
        for name in ("heading_rad", "travel", "turn_rate_rad_s", "duration_s", "settle_s", "trim_rad"):
            check_type(getattr(self, name), float, f"plan.{name}")
        if not abs(self.trim_rad) <= MAX_TRIM_RAD:
            raise InputError(
                f"trim: got {math.degrees(self.trim_rad):g}; "
                f"allowed: up to {math.degrees(MAX_TRIM_RAD):g} degrees either way"
            )
        self._check_turn_trim()
        DURATION_S.check("duration", self.duration_s)
        if self.self_rotation not in SELF_ROTATIONS:
            raise InputError(f"self-rotation: got {self.self_rotation}; allowed: {', '.join(SELF_ROTATIONS)}")
        if self.hold not in HOLDS:
            raise InputError(f"hold: got {self.hold}; allowed: {', '.join(HOLDS)}")
        if self.feet not in FEET:
            raise InputError(f"{argument('feet')}: got {self.feet}; allowed: {', '.join(FEET)}")
        for change in self.changes:
            check_type(change, GaitChange, "plan.changes", "GaitChanges")
        if any(after.at_s <= before.at_s for before, after in pairwise(self.changes)):
            raise InputError(
                "plan.changes: got times that do not ascend; allowed: the first change first, one at a time"
            )
        if not (math.isfinite(self.settle_s) and self.settle_s > 0):
            raise InputError(f"settle time: got {self.settle_s:g}; allowed: above 0 s")
        check_type(self.turn_rad, (float, type(None)), "plan.turn_rad", "an angle in rad, or None")
        if self.turn_rad is not None and not math.isfinite(self.turn_rad):
            raise InputError(f"turn before the walk: got {self.turn_rad}; allowed: a finite angle")
        self.motion(0.0)

    def _check_turn_trim(self) -> None:
        """Raise InputError for a large trim, and for one of a walk other than straight and in open loop."""
        trim_rad_s = self.turn_trim_rad_s
        check_type(trim_rad_s, (float, type(None)), "plan.turn_trim_rad_s", "a rate in rad/s, or None")
        if trim_rad_s is None:
            return
        if self.hold != "none" or not self.straight:
            turned = "" if self.straight else " and a walk that is not straight"
            raise InputError(
                f"turn trim: used with hold {self.hold}{turned}; allowed: with hold none and a straight walk"
            )
        if not abs(trim_rad_s) <= MAX_TURN_TRIM_RAD_S:
            raise InputError(
                f"turn trim: got {math.degrees(trim_rad_s):g}; "
                f"allowed: up to {math.degrees(MAX_TURN_TRIM_RAD_S):g} deg/s either way"
            )

    def motion(self, yaw_rad: float) -> Motion:
        """Motion in the frame of a body turned by a yaw since the start of the trial."""
        heading_rad, turn_rate_rad_s = self.heading_rad - yaw_rad, self.turn_rate_rad_s
        if self.turn_trim_rad_s is not None:
            heading_rad, turn_rate_rad_s = heading_rad + self.trim_rad, self.turn_trim_rad_s
        return Motion(heading_rad=heading_rad, travel=self.travel, turn_rate_rad_s=turn_rate_rad_s)

    @property
    def straight(self) -> bool:
        """Whether the walk is along a line."""
        return self.travel > 0 and self.turn_rate_rad_s == 0

    @property
    def failures(self) -> tuple[Failure, ...]:
        """All failures that the controller knows, by leg."""
        return each_failure((*each_failure(self.belief), *self.further_failures))

    @property
    def failed_legs(self) -> tuple[int, ...]:
        """The failed legs, ascending."""
        return tuple(one.leg for one in self.failures)

    @property
    def held_legs(self) -> tuple[int, ...]:
        """Legs that the controller keeps in their stance pose."""
        return tuple(one.leg for one in self.failures if one.kind in ("locked", UNKNOWN))
