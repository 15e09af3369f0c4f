"""Walk-through: one leg after another moves its joints, and the operator names it, before the robot walks."""

from collections.abc import Callable

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.tools import opened_line, the_servo
from hexctl.control.calibration.operator import EndedError, Operator
from hexctl.control.calibration.servo_assignment import operator_answer
from hexctl.control.calibration.servo_trial import WIGGLE_DEG, wiggle
from hexctl.types import JOINTS_PER_LEG, N_LEGS

#: Shown before the first leg moves.
INTRODUCTION = (
    "Put the robot on a stand or on its belly. One leg after another moves its coxa, femur and tibia: each "
    f"goes limp, then moves by {WIGGLE_DEG:g} degrees and back. A right leg goes first sideways, then up or "
    "down, then with its lower part alone in or out. Count legs counter-clockwise from above, the front left "
    "first."
)

#: Answer for joints that are not coxa, femur and tibia of one leg in this order, and the leg they stand for.
WRONG, NO_LEG = "no", 0


def walk_through(
    servos: BusMap,
    path: str,
    baud: int,
    operator: Operator,
    *,
    consent: bool = False,
    stop_requested: Callable[[], bool] = lambda: False,
) -> dict[int, int]:
    """Move one leg after another, and ask which it was; the seen legs by that of the file, or `NO_LEG`.

    Coxa, femur and tibia move one after the other, because ids may be exchanged within a leg too.
    The port is closed between questions. With `consent` legs move without a question before. A stop ends a
    movement immediately. All servos end limp as before, or hold where the movement ended.

    Raises RobotFaultError for a port that cannot be opened, and for a servo that does not answer or move.
    """
    seen: dict[int, int] = {}
    operator.tell(INTRODUCTION)
    try:
        for leg in range(1, N_LEGS + 1):
            what = f"leg {leg} of the file, ids {', '.join(map(str, _ids(servos, leg)))}"
            if not consent:
                _wait_for_enter(operator, what, stop_requested)
            said = ""
            while not said:
                if stop_requested():
                    return seen
                _move(servos, path, baud, leg, stop_requested)
                said = _seen_leg(operator, what, seen, stop_requested)
            seen[leg] = NO_LEG if said == WRONG else int(said)
    except EndedError:
        pass
    return seen


def _ids(servos: BusMap, leg: int) -> list[int]:
    ids: list[int] = servos.ids[JOINTS_PER_LEG * (leg - 1) : JOINTS_PER_LEG * leg].tolist()
    return ids


def _move(servos: BusMap, path: str, baud: int, leg: int, stop_requested: Callable[[], bool]) -> None:
    with opened_line(path, baud, servos.family) as line:
        for servo_id in _ids(servos, leg):
            wiggle(the_servo(line, servos.family.name, servo_id), stop_requested=stop_requested)


def _wait_for_enter(operator: Operator, what: str, stop_requested: Callable[[], bool]) -> None:
    question = f"{what}: Enter moves it, quit:"
    while (said := operator_answer(operator, question, stop_requested)) not in ("", "y", "yes", "enter"):
        question = f"got {said!r}; allowed: Enter or yes, which moves {what}; quit:"


def _seen_leg(operator: Operator, what: str, seen: dict[int, int], stop_requested: Callable[[], bool]) -> str:
    """Number of the leg that moved, not one of those `seen`; `WRONG`, or empty to see it again."""
    allowed = f"1 to {N_LEGS}, {WRONG}, again, quit:"
    question = (
        f"{what}: which leg moved, first sideways, then up or down, then its lower part? {WRONG} for other "
        f"joints or another order; {allowed}"
    )
    while True:
        said = operator_answer(operator, question, stop_requested).removeprefix("leg").strip()
        if said == "again":
            return ""
        is_leg = said.isdecimal() and 1 <= int(said) <= N_LEGS
        if said == WRONG or (is_leg and int(said) not in seen.values()):
            return said
        question = f"got {said!r}; allowed: the leg that moved, each once, {allowed}"
        if is_leg:
            question = f"leg {said} has moved before, by other ids; quit if that answer was wrong. {question}"


def exchanged_legs(seen: dict[int, int]) -> str:
    """Legs that are others than the file says, for a person; empty if all are right."""
    wrong = {leg: real for leg, real in seen.items() if real != leg}
    other = "no leg in the order of coxa, femur and tibia"
    return ", ".join(
        f"leg {leg} of the file moves {other if real == NO_LEG else f'leg {real}'}"
        for leg, real in wrong.items()
    )
