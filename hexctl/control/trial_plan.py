"""The plan of a trial, a plain, picklable value; and the walk options that several commands share."""

import math
from dataclasses import dataclass
from typing import Annotated, ClassVar, Final, Literal, get_args

from hexctl.errors import InputError, argument, check_type
from hexctl.gait.gait import FINITE, PACE_HZ, STEP, TRAVEL, Gait, Motion
from hexctl.options import RARE, Range, Typed, check_fields
from hexctl.robot.failure import UNKNOWN, Failure, checked_failures

SelfRotation = Literal["rear", "front", "none"]

#: What a walk holds by feedback; `auto` is the best that the robot allows.
Hold = Literal["auto", "line", "heading", "none"]
HOLDS = get_args(Hold)

#: Whether feet follow the trajectory of the gait, or search for the ground below it.
Feet = Literal["planned", "adaptive"]
FEET = get_args(Feet)

DURATION_S = Range(low=0, high=86_400, above=True, unit="s")

CHANGE_S = Range(low=0, high=DURATION_S.high, unit="s")

HEADING_DEG = Range(low=-360, high=360, unit="deg", degrees=True)

TURN_DEG_S = Range(low=-360, high=360, unit="deg/s", degrees=True)

#: `TrialPlan.in_words` of a walk straight ahead at the pace of the robot.
PLAIN_TASK = "walk ahead"

#: Asks for the self-rotation that suits a walk.
AUTO_ROTATION: Final = "auto"
AskedRotation = Literal["auto", "rear", "front", "none"]

#: A larger course error is not trimmed: the robot is not walking ahead.
TRIM_DEG = Range(low=-45, high=45, unit="deg", degrees=True)
MAX_TRIM_RAD = math.radians(TRIM_DEG.high)

#: A larger curve, 120 degrees in 30 s, is not trimmed either.
TURN_TRIM_DEG_S = Range(low=-4, high=4, unit="deg/s", degrees=True)
MAX_TURN_TRIM_RAD_S = math.radians(TURN_TRIM_DEG_S.high)


def suited_rotation(self_rotation: AskedRotation, hold: str, *, chosen_gait: bool) -> SelfRotation:
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
        CHANGE_S.check(argument("then"), self.at_s)

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
        failures: those that the controller knows, by leg; `locked` and `unknown` legs stay in their stance
            pose. A simulation gets its own failures. With more than one, only `turn_rad` turns.
        self_rotation: where the failed leg points during the walk: `rear`, `front` or `none` (as it is).
        turn_rad: turn before the walk, instead of `self_rotation`; None to follow it.
        settle_s: time to reach the stance and come to rest; up to 1.5 s longer if the yaw is noisy.
        hold: one of `HOLDS`; `none` is open loop, as in the paper.
        changes: of the gait, in stride, ascending in time.
        trim_rad: counter-clockwise correction of the course from earlier walks, under the hold `heading` or,
            with a `turn_trim_rad_s`, in open loop.
        turn_trim_rad_s: in open loop, a counter-clockwise turn that removes the curve of earlier walks; None
            for a walk without a trim.
        level: whether the body is kept level by its measured roll and pitch.
        feet: one of `FEET`; `adaptive` ones search for the ground, with foot contacts.
    """

    gait: Gait
    heading_rad: Annotated[float, FINITE] = 0.0
    travel: Annotated[float, TRAVEL] = 1.0
    turn_rate_rad_s: Annotated[float, FINITE] = 0.0
    duration_s: Annotated[float, DURATION_S] = 30.0
    failures: tuple[Failure, ...] = ()
    self_rotation: SelfRotation = "rear"
    turn_rad: Annotated[float | None, FINITE] = None
    settle_s: Annotated[float, Range(low=0, above=True, unit="s")] = 1.0
    hold: Hold = "none"
    changes: tuple[GaitChange, ...] = ()
    trim_rad: Annotated[float, TRIM_DEG] = 0.0
    turn_trim_rad_s: Annotated[float | None, TURN_TRIM_DEG_S] = None
    level: bool = False
    feet: Feet = "planned"

    def __post_init__(self) -> None:
        check_fields(self)
        object.__setattr__(self, "failures", checked_failures(self.failures, "plan.failures"))
        if self.turn_trim_rad_s is not None and (self.hold != "none" or not self.straight):
            turned = "" if self.straight else " and a walk that is not straight"
            raise InputError(
                f"turn trim: used with hold {self.hold}{turned}; allowed: with hold none and a straight walk"
            )
        for change in self.changes:
            check_type(change, GaitChange, "plan.changes", "GaitChanges")
        times_s = [change.at_s for change in self.changes]
        if times_s != sorted(set(times_s)) or any(at_s >= self.duration_s for at_s in times_s):
            got = " and then ".join(f"{at_s:g} s" for at_s in times_s)
            raise InputError(
                f"{argument('then')}: got {got}; allowed: times that ascend, before the end at "
                f"{self.duration_s:g} s"
            )

    def motion(self, yaw_rad: float) -> Motion:
        """Motion in the frame of a body turned by a yaw since the start of the trial."""
        heading_rad, turn_rate_rad_s = self.heading_rad - yaw_rad, self.turn_rate_rad_s
        if self.turn_trim_rad_s is not None:
            heading_rad, turn_rate_rad_s = heading_rad + self.trim_rad, self.turn_trim_rad_s
        return Motion(heading_rad=heading_rad, travel=self.travel, turn_rate_rad_s=turn_rate_rad_s)

    def in_words(self, usual_pace_hz: float | None = None) -> str:
        """What is walked: `walk at 30 degrees and turn left at 5 degrees/s, at 0.5 Hz`.

        Angles are counter-clockwise. A pace of `usual_pace_hz`, that of the robot, is left out.
        """
        heading_deg = math.degrees(math.remainder(self.heading_rad, math.tau))
        turn_deg_s = math.degrees(self.turn_rate_rad_s)
        spot = "" if self.travel else " on the spot"
        turn = f"turn {'left' if turn_deg_s > 0 else 'right'}{spot} at {abs(turn_deg_s):g} degrees/s"
        towards = f"at {heading_deg:g} degrees" if round(heading_deg, 6) else "ahead"
        parts = [f"walk {towards}" if self.travel else "", turn if turn_deg_s else ""]
        text = " and ".join(filter(None, parts)) or "step on the spot"
        texts = [text, *([] if self.gait.pace_hz == usual_pace_hz else [f"at {self.gait.pace_hz:g} Hz"])]
        return ", ".join([*texts, *(f"then {change}" for change in self.changes)])

    @property
    def straight(self) -> bool:
        """Whether the walk is along a line."""
        return self.travel > 0 and self.turn_rate_rad_s == 0

    @property
    def failed_legs(self) -> tuple[int, ...]:
        """The failed legs, ascending."""
        return tuple(one.leg for one in self.failures)

    @property
    def held_legs(self) -> tuple[int, ...]:
        """Legs that the controller keeps in their stance pose."""
        return tuple(one.leg for one in self.failures if one.kind in ("locked", UNKNOWN))


@dataclass(frozen=True, kw_only=True)
class WalkOptions:
    """How a robot steps and turns; None takes the robot's value."""

    PANEL: ClassVar = "Walk"

    turn_rate_rad_s: Annotated[float | None, TURN_DEG_S, Typed(flag="turn")] = None
    """Turn rate in degrees per second, {}, counter-clockwise. Without --heading the robot turns in place.
    (default: 0)

    In Python in rad/s.
    """

    pace_hz: Annotated[float | None, PACE_HZ] = None
    """Gait cycles per second, {}. (default: the robot's)"""

    amplitude: Annotated[float | None, STEP, RARE] = None
    """Length of the stroke of a foot as a fraction of the robot's size, {}. (default: the robot's)"""

    height: Annotated[float | None, STEP, RARE] = None
    """Height of a step as a fraction of the robot's size, {}. (default: the robot's)"""


@dataclass(frozen=True, kw_only=True)
class GroundOptions:
    """How a robot walks over uneven ground."""

    PANEL: ClassVar = "Walk"

    level: Annotated[bool, RARE] = False
    """Keep the body level on slopes, with the roll and pitch that the robot measures."""

    feet: Feet = "planned"
    """How feet meet the ground: planned, as the gait has them, or adaptive, for uneven ground: they lift
    higher, by default at least 0.04 of the robot's size, and search the ground below until they touch it.

    The search needs foot contacts.
    """
