"""Named gaits, and reading a gait from a name, a code or a list of slots."""

from collections.abc import Iterable

from hexctl.errors import InputError
from hexctl.gait.encoding import Slots, check_permutation, code_count, slots_from_code
from hexctl.gait.gait import Gait
from hexctl.robot.model import Robot

#: A leg swings when u = 1/3, so swings follow one another in descending slot order.
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
    text: str,
    *,
    pace_hz: float | None = None,
    amplitude: float | None = None,
    height: float | None = None,
    failed_legs: Iterable[int] = (),
) -> Gait:
    """Return a gait from the text that `parse_slots` takes, with the robot's own values where none is given.

    Args:
        robot: whose defaults hold.
        text: name, code or slots.
        pace_hz: gait cycles per second.
        amplitude: step amplitude as a fraction of the robot's size.
        height: step height as a fraction of the robot's size.
        failed_legs: a code counts among the arrangements of the other legs.
    """
    default = robot.gait
    return Gait(
        slots=parse_slots(text, failed_legs),
        pace_hz=default.pace_hz if pace_hz is None else pace_hz,
        amplitude=default.amplitude if amplitude is None else amplitude,
        height=default.height if height is None else height,
    )


def parse_slots(text: str, failed_legs: Iterable[int] = ()) -> Slots:
    """Return slots from a name (`tripod`), a code (`57`) or a list (`5,1,2,4,3,6`).

    A code counts among the arrangements of the legs that still walk. Raises InputError for anything else.
    """
    cleaned = text.strip()
    if cleaned in NAMED_SLOTS:
        return NAMED_SLOTS[cleaned]
    if "," in cleaned:
        return _listed(cleaned)
    try:
        code = int(cleaned)
    except ValueError:
        raise InputError(f"gait: got {text!r}; allowed: {_allowed(failed_legs)}") from None
    return slots_from_code(code, failed_legs)


def _listed(text: str) -> Slots:
    try:
        slots = tuple(int(part) for part in text.split(","))
    except ValueError:
        raise InputError(f"slots: got {text!r}; allowed: six whole numbers such as 5,1,2,4,3,6") from None
    check_permutation(slots)
    return slots


def _allowed(failed_legs: Iterable[int]) -> str:
    names = ", ".join(NAMED_SLOTS)
    return f"{names}, a code 1..{code_count(failed_legs)}, or slots such as 5,1,2,4,3,6"
