"""Gaits (slots, pace, amplitude, height), motions (heading and turn), and gaits by name, code or slots."""

import operator
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Annotated

from hexctl.errors import InputError, argument, check_type
from hexctl.gait.encoding import (
    Slots,
    as_slots,
    check_permutation,
    code_count,
    code_from_slots,
    slots_from_code,
)
from hexctl.gait.posture import STANCE, Posture
from hexctl.options import Range, check_fields
from hexctl.robot.model import Robot
from hexctl.typed_names import known_name, nearest
from hexctl.types import N_LEGS

_GAIT = argument("gait")

#: Amplitudes per cycle at the stance speed: a stance foot covers one in two thirds of a cycle.
STROKES_PER_CYCLE = 1.5

PACE_HZ = Range(low=0, high=10, above=True, unit="Hz")

#: Amplitude and height of a step, as fractions of the robot's size.
STEP = Range(low=0, high=1, above=True, unit="of the robot's size")

#: The paper's share of a cycle that a foot is in the air.
SWING_SHARE = 1 / 3

SWING = Range(low=0.1, high=0.5)

#: Share of the full amplitude with which a body travels.
TRAVEL = Range(low=0, high=1)

FINITE = Range()


@dataclass(frozen=True, slots=True, kw_only=True)
class Gait:
    """A gait: the order of the legs, the pace, the amplitude and the step height.

    Attributes:
        slots: phase slot of legs 1..6, each 1..6; `tripod` shares slots, an encoded gait is a permutation.
        pace_hz: gait cycles per second, above 0 up to 10.
        amplitude: length A of a stroke as a fraction of the robot's size E.
        height: step height H as a fraction of the robot's size E.
        swing_share: share of a cycle that a foot is in the air, 0.1 to 0.5; a third in the paper.
        phases: lead of each leg in cycles, 0..1 without 1; None is (g_i - 1) / 6 of its slot, as in the
            paper. A crawl on four legs has quarter phases.
    """

    slots: Slots
    pace_hz: Annotated[float, PACE_HZ]
    amplitude: Annotated[float, STEP]
    height: Annotated[float, STEP]
    posture: Posture = STANCE
    swing_share: Annotated[float, SWING] = SWING_SHARE
    phases: tuple[float, ...] | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "slots", as_slots(self.slots))
        if len(self.slots) != N_LEGS or not all(1 <= slot <= N_LEGS for slot in self.slots):
            raise InputError(f"{_GAIT}: got {self.slots}; allowed: six numbers, each 1..6")
        check_fields(self)
        if self.phases is None:
            return
        allowed = f"{N_LEGS} parts of a cycle, each 0 up to 1 without 1, or None"
        check_type(self.phases, (tuple, list), "phases", allowed)
        for phase in self.phases:
            check_type(phase, float, "phases", allowed)
        if len(self.phases) != N_LEGS or not all(0 <= phase < 1 for phase in self.phases):
            raise InputError(f"phases: got {self.phases}; allowed: {allowed}")
        object.__setattr__(self, "phases", tuple(map(float, self.phases)))

    @property
    def leg_phases(self) -> tuple[float, ...]:
        """Lead of each leg in cycles, (6,): the phases, or (g_i - 1) / 6 of Eq. 5."""
        return tuple((slot - 1) / N_LEGS for slot in self.slots) if self.phases is None else self.phases

    @property
    def strokes_per_cycle(self) -> float:
        """Amplitudes per cycle at the speed of the stance: 3/2 in the paper."""
        return STROKES_PER_CYCLE if self.swing_share == SWING_SHARE else 1 / (1 - self.swing_share)

    def code(self, failed_legs: tuple[int, ...] = ()) -> int | None:
        """Gait code, or None for shared slots, phases between slots, and failed legs not in their slots."""
        if self.phases is not None:
            return None
        try:
            check_permutation(self.slots)
            return code_from_slots(self.slots, failed_legs)
        except InputError:
            return None


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Commanded motion in the body frame: travel along a heading, a turn, or both blended.

    Attributes:
        heading_rad: direction of travel, counter-clockwise from forward.
        travel: 1 to travel with the full amplitude, 0 to stay on the spot.
        turn_rate_rad_s: commanded yaw rate, counter-clockwise positive.
    """

    heading_rad: Annotated[float, FINITE] = 0.0
    travel: Annotated[float, TRAVEL] = 1.0
    turn_rate_rad_s: Annotated[float, FINITE] = 0.0

    def __post_init__(self) -> None:
        check_fields(self)


def is_crawl(phases: Sequence[float] | None, swing_share: float) -> bool:
    """Whether one leg swings at a time in a gait."""
    return phases is not None and swing_share < SWING_SHARE


def ideal_speed_m_s(robot: Robot, gait: Gait, motion: Motion) -> float:
    """Travel speed without slip (Eq. 3): (3/2) A f, with a swing share s A f / (1 - s)."""
    return gait.strokes_per_cycle * gait.amplitude * robot.size_m * gait.pace_hz * motion.travel


def turn_amplitude_m(robot: Robot, gait: Gait, turn_rate_rad_s: float) -> float:
    """Stroke of the farthest foot that turns the body at a rate without slip, omega r / ((3/2) f)."""
    return turn_rate_rad_s * robot.stance_radius_m / (gait.strokes_per_cycle * gait.pace_hz)


def half_amplitude_turn_rate_rad_s(robot: Robot, gait: Gait) -> float:
    """Rate of a turn in place with half the amplitude, as in the demo of the paper's robot model."""
    return gait.strokes_per_cycle * gait.pace_hz * 0.5 * gait.amplitude * robot.size_m / robot.stance_radius_m


#: Name of the most stable gait of a robot, direction and failure (`static_stability`).
AUTO = "auto"

#: Name of the best gait by a prior; with a colon and a session, of its best walk.
BEST = "best"

#: Names of gaits that are chosen for a walk.
CHOSEN_GAITS = (AUTO, BEST)

#: Default gait: the fastest that keeps three feet on the floor.
DEFAULT_GAIT = "tripod"

#: A leg swings when u = 1/3: swings follow each other in descending slot order.
NAMED_SLOTS: dict[str, Slots] = {
    # default of the paper's demo model
    "demo": (1, 4, 2, 6, 3, 5),
    # legs 1, 3, 5 against 2, 4, 6; shares slots and therefore has no code
    "tripod": (1, 4, 1, 4, 1, 4),
    # rear to front on the left (3, 2, 1), then on the right (4, 5, 6)
    "wave": (4, 5, 6, 3, 2, 1),
    # rear to front on both sides, half a cycle apart: 3, 6, 2, 4, 1, 5
    "ripple": (2, 4, 6, 3, 1, 5),
}


def make_gait(
    robot: Robot,
    gait: str | int | Sequence[int],
    *,
    pace_hz: float | None = None,
    amplitude: float | None = None,
    height: float | None = None,
    failed_legs: Iterable[int] = (),
    others: Sequence[str] = (),
) -> Gait:
    """A gait by name, code or slots, with the robot's pace, amplitude and height by default.

        gait = hexctl.make_gait(hexctl.load_robot("ant"), "tripod", pace_hz=0.5)

    Args:
        gait: name (`"tripod"`), code (`57`, `"57"`) or slots (`(5, 1, 2, 4, 3, 6)`, `"5,1,2,4,3,6"`).
        amplitude: as a fraction of the robot's size, as is the height.
        failed_legs: a code counts among the arrangements of the other legs.
        others: further names that the caller allows, such as `auto`, for the message.

    Raises InputError for anything else, and for a gait that `Gait` refuses.
    """
    check_type(robot, Robot, "make_gait: robot", "a Robot, as load_robot('ant') gives")
    default = robot.gait
    return Gait(
        slots=parse_slots(gait, failed_legs, others),
        pace_hz=default.pace_hz if pace_hz is None else pace_hz,
        amplitude=default.amplitude if amplitude is None else amplitude,
        height=default.height if height is None else height,
    )


def gait_text(text: str) -> str:
    """Canonical text of a gait; slots of a named gait become its name."""
    if "," in text:
        slots = "".join(text.split())
        named = [name for name, one in NAMED_SLOTS.items() if ",".join(map(str, one)) == slots]
        return named[0] if named else text
    return text if ":" in text else text.strip().lower() or text


def names_best(gait: object) -> bool:
    """Whether a gait is `best` or `best:SESSION`, which stands for another gait."""
    return isinstance(gait, str) and gait.partition(":")[0].strip() == BEST


def parse_slots(
    gait: str | int | Sequence[int], failed_legs: Iterable[int] = (), others: Sequence[str] = ()
) -> Slots:
    """Slots of a name (`tripod`), a code (`57`) or a list (`5,1,2,4,3,6`), as text or as numbers.

    A code counts among the arrangements of the walking legs. Raises InputError for anything else.
    """
    if isinstance(gait, str):
        return _slots_of_text(gait, failed_legs, others)
    if isinstance(gait, Iterable):
        check_permutation(gait)
        return as_slots(gait)
    check_type(gait, int, _GAIT, _allowed(failed_legs, others))
    return slots_from_code(operator.index(gait), failed_legs)


def _slots_of_text(text: str, failed_legs: Iterable[int], others: Sequence[str]) -> Slots:
    cleaned = text.strip()
    if (name := known_name(cleaned, NAMED_SLOTS)) is not None:
        return NAMED_SLOTS[name]
    if "," in cleaned:
        return _listed(cleaned)
    try:
        code = int(cleaned)
    except ValueError:
        near = nearest(cleaned, (*NAMED_SLOTS, *others))
        raise InputError(f"{_GAIT}: got {text!r}; allowed: {_allowed(failed_legs, others)}{near}") from None
    return slots_from_code(code, failed_legs)


def _listed(text: str) -> Slots:
    try:
        slots = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"{_GAIT}: got {text!r}; allowed: six whole numbers such as 5,1,2,4,3,6") from None
    check_permutation(slots)
    return slots


def _allowed(failed_legs: Iterable[int], others: Sequence[str]) -> str:
    names = ", ".join([*NAMED_SLOTS, *others])
    return f"{names}, a code 1..{code_count(failed_legs)}, or slots such as 5,1,2,4,3,6"
