"""Walk-through: one leg after another moves, and the operator names it, before the robot walks."""

from collections.abc import Callable

from hexctl.backends.bus.bus_map import BusMap
from hexctl.backends.bus.tools import opened_line, the_servo
from hexctl.control.calibration.operator import EndedError, Operator
from hexctl.control.calibration.servo_assignment import operator_answer
from hexctl.control.calibration.servo_trial import WIGGLE_DEG, wiggle
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS

#: Shown before the first leg moves.
INTRODUCTION = (
    "Put the robot on a stand or on its belly. One leg after another goes limp, then moves "
    f"by {WIGGLE_DEG:g} degrees and back. Count legs counter-clockwise from above, the front left first."
)

#: Joint of a leg that moves: the one that lifts it.
FEMUR = JOINT_KINDS.index("femur")


def walk_through(
    servos: BusMap,
    path: str,
    baud: int,
    operator: Operator,
    *,
    consent: bool = False,
    stop_requested: Callable[[], bool] = lambda: False,
) -> dict[int, int]:
    """Move the femur of one leg after another, and ask which leg moved; the seen legs by that of the file.

    The port is closed between questions. With `consent` legs move without a question before. A stop ends a
    movement immediately. All servos end limp as before, or hold where the movement ended.

    Raises RobotFaultError for a port that cannot be opened, and for a servo that does not answer or move.
    """
    seen: dict[int, int] = {}
    operator.tell(INTRODUCTION)
    try:
        for leg in range(1, N_LEGS + 1):
            what = f"leg {leg} of the file, id {servos.ids[JOINTS_PER_LEG * (leg - 1) + FEMUR]}"
            if not consent:
                _wait_for_enter(operator, what, stop_requested)
            said = ""
            while not said:
                if stop_requested():
                    return seen
                _move(servos, path, baud, leg, stop_requested)
                said = _seen_leg(operator, what, stop_requested)
            seen[leg] = int(said)
    except EndedError:
        pass
    return seen


def _move(servos: BusMap, path: str, baud: int, leg: int, stop_requested: Callable[[], bool]) -> None:
    servo_id = int(servos.ids[JOINTS_PER_LEG * (leg - 1) + FEMUR])
    with opened_line(path, baud, servos.family) as line:
        wiggle(the_servo(line, servos.family.name, servo_id), stop_requested=stop_requested)


def _wait_for_enter(operator: Operator, what: str, stop_requested: Callable[[], bool]) -> None:
    question = f"{what}: Enter moves it, quit:"
    while (said := operator_answer(operator, question, stop_requested)) not in ("", "y", "yes", "enter"):
        question = f"got {said!r}; allowed: Enter or yes, which moves {what}; quit:"


def _seen_leg(operator: Operator, what: str, stop_requested: Callable[[], bool]) -> str:
    """Number of the leg that moved; empty to see it again."""
    question = f"{what}: which leg moved? 1 to {N_LEGS}, again, quit:"
    while True:
        said = operator_answer(operator, question, stop_requested).removeprefix("leg").strip()
        if said == "again":
            return ""
        if said.isdecimal() and 1 <= int(said) <= N_LEGS:
            return said
        question = f"got {said!r}; allowed: the leg that moved, 1 to {N_LEGS}, again, quit:"


def exchanged_legs(seen: dict[int, int]) -> str:
    """Legs that are others than the file says, for a person; empty if all are right."""
    wrong = [f"leg {leg} of the file moves leg {real}" for leg, real in seen.items() if real != leg]
    return ", ".join(wrong)
