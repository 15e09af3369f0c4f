"""Faults of simulated boards and buses."""

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass

from hexctl.errors import InputError, argument
from hexctl.types import JOINT_KINDS, JOINTS_PER_LEG, N_LEGS

#: Highest numbers, by their names: of a share, and of a temperature that a servo can report.
MOST = {"SHARE": 1.0, "DEGREES_C": 200.0}

_NUMBER = r"[0-9]+(?:\.[0-9]+)?"
_FAULT = re.compile(rf"([a-z-]+)((?::[a-z0-9.]+)*)(?:@({_NUMBER}))?")


@dataclass(frozen=True, slots=True, kw_only=True)
class BoardFault:
    """One fault; it begins at `at_s` on the clock of the simulated robot.

    `joint`, 0..17, is None for faults of the board or the line, `value` the number after the word, or None.
    """

    kind: str
    at_s: float = 0.0
    joint: int | None = None
    value: float | None = None


def parse_fault(text: str, kinds: Mapping[str, str]) -> BoardFault:
    """Fault of a text such as `mute@10`, `garble:0.01` or `hot:2:femur:72@5`.

    `kinds` are the arguments of each word, such as `SHARE` or `LEG:JOINT:DEGREES_C`, optional ones in
    brackets, with maxima in `MOST`. Raises InputError for anything else.
    """
    error = InputError(f"{argument('fault')}: got {text!r}; allowed: {_allowed(kinds)}")
    found = _FAULT.fullmatch(text)
    takes = None if found is None else kinds.get(found[1])
    if found is None or takes is None:
        raise error
    names = takes.strip("[:]").split(":") if takes else []
    given = found[2].split(":")[1:]
    if len(given) != len(names) and (given or not takes.startswith("[")):
        raise error
    joint, value = None, None
    for name, word in zip(names, given, strict=False):
        if name == "LEG" and word in map(str, range(1, N_LEGS + 1)):
            joint = JOINTS_PER_LEG * (int(word) - 1)
        elif name == "JOINT" and word in JOINT_KINDS and joint is not None:
            joint += JOINT_KINDS.index(word)
        elif re.fullmatch(_NUMBER, word) and name not in ("LEG", "JOINT"):
            value = float(word)
            if value > MOST.get(name, math.inf):
                raise error
        else:
            raise error
    return BoardFault(kind=found[1], at_s=float(found[3] or 0), joint=joint, value=value)


def _allowed(kinds: Mapping[str, str]) -> str:
    words = [f"{kind}{takes if takes[:1] in ('', '[') else f':{takes}'}" for kind, takes in kinds.items()]
    limits = [f"; {name} up to {most:g}" for name, most in MOST.items() if name in "".join(words)]
    return f"{', '.join(words)}, each with @SECONDS or from the start{''.join(limits)}"


class DueFaults:
    """Scheduled faults, in their order."""

    def __init__(self, faults: tuple[BoardFault, ...]) -> None:
        self._to_come = sorted(faults, key=lambda fault: fault.at_s)

    def add(self, fault: BoardFault) -> None:
        """Add a fault, due immediately if its time is over."""
        self._to_come = sorted((*self._to_come, fault), key=lambda each: each.at_s)

    def begun(self, now_s: float) -> list[BoardFault]:
        """Faults due since the last call."""
        due = [fault for fault in self._to_come if fault.at_s <= now_s]
        self._to_come = self._to_come[len(due) :]
        return due
