"""Results on disk: one line of JSON per injection, so that a run that was killed goes on."""

import json
import threading
from collections.abc import Iterable
from pathlib import Path

from faults.measurement import Outcome

#: Where results are unless told otherwise, and what a run of the matrix adds to.
RESULTS = Path("faults/injections.jsonl")


class Results:
    """Outcomes in a file.

    Args:
        path: of the file; it and its folder are made.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)

    def read(self) -> list[Outcome]:
        """All outcomes; a line that was cut off by a kill is left out."""
        if not self._path.exists():
            return []
        outcomes = []
        for line in self._path.read_text(encoding="utf-8").splitlines():
            try:
                outcomes.append(Outcome.from_json(json.loads(line)))
            except (ValueError, TypeError):
                continue
        return outcomes

    def add(self, outcome: Outcome) -> None:
        """Append an outcome."""
        with self._lock, self._path.open("a", encoding="utf-8") as file:
            file.write(json.dumps(outcome.as_json()) + "\n")


def done(outcomes: Iterable[Outcome]) -> set[tuple[str, str, str, int]]:
    """What need not be run again: those for which the machine had time."""
    return {outcome.key for outcome in outcomes if outcome.punctual}
