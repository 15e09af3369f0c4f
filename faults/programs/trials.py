"""Trials of a session over a link: `python -m faults.programs.trials ENDPOINT ROBOT FOLDER`.

An operator that is a program places the robot before each trial, which takes a while: the time between two
trials. Says `placing 2` then, `stored 1` once a trial is on the disk, and `ended: ...` for what ends them.
"""

import sys
import time
from dataclasses import dataclass, field
from pathlib import Path

from faults.programs.controller import Lines, say
from faults.programs.twin import jump_clock
from hexctl.adapt.adaptation import adapt
from hexctl.adapt.measurement import Answer
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.errors import HexctlError

#: How long placing the robot takes, and how long it walks.
PLACING_S, WALK_S = 2.5, 1.5

BUDGET = 3


@dataclass
class Program:
    """An operator who always takes as long, and measures the same; `jump` on stdin lets its clock jump."""

    lines: Lines = field(default_factory=Lines)

    def place(self, index: int, code: int) -> bool:
        """Take a while before a trial."""
        say(f"placing {index}")
        until_s = time.monotonic() + (PLACING_S if index > 1 else 0.0)
        while (left_s := until_s - time.monotonic()) > 0:
            if self.lines.next(left_s) == "jump":
                jump_clock()
        return True

    def measure(self, index: int, *, at_most_m: float) -> Answer:
        """Measure what can be walked."""
        return Answer(word="measured", distance_m=0.5 * at_most_m, signed_m=0.01 * index)


def main(endpoint: str, robot: str, folder: str) -> None:
    """Walk the trials."""
    try:
        adapt(
            5,
            budget=BUDGET,
            robot=robot,
            optimizer="random",
            prior="none",
            baseline=False,
            duration_s=WALK_S,
            backend="zenoh",
            connect=endpoint,
            operator=Program(),
            record=False,
            folder=Path(folder),
            note=lambda _: None,
            on_stored=_say_stored,
        )
        say("done")
    except HexctlError as error:
        say(f"ended: {type(error).__name__}: {error}")


def _say_stored(_: Session, walk: Walk) -> None:
    if isinstance(walk, TrialRecord):
        say(f"stored {walk.index}")


if __name__ == "__main__":
    main(*sys.argv[1:])
