"""Results on disk: one line of JSON per injection, so that a run that was killed goes on."""

import json
import threading
from collections.abc import Iterable, Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from faults.measurement import Outcome

#: Where results are unless told otherwise, and what a run of the matrix adds to.
RESULTS = Path("faults/injections.jsonl")

#: Key of a line of a try that ended before its fault: why it did.
NOT_MEASURED = "not_measured"


class Results:
    """Outcomes in a file.

    Args:
        path: of the file; it and its folder are made.
    """

    def __init__(self, path: Path) -> None:
        self._path, self._lock = path, threading.Lock()
        path.parent.mkdir(parents=True, exist_ok=True)

    def read(self) -> list[Outcome]:
        """All outcomes; raises ValueError for a line of another version."""
        outcomes = []
        for number, values in self._lines():
            if NOT_MEASURED in values:
                continue
            try:
                outcomes.append(Outcome.from_json(values))
            except TypeError as error:
                raise ValueError(f"{self._path}, line {number}: {error}") from error
        return outcomes

    def not_measured(self) -> list[str]:
        """Why tries ended before their fault, one text each."""
        return [values[NOT_MEASURED] for _, values in self._lines() if NOT_MEASURED in values]

    def add(self, outcome: Outcome) -> None:
        """Append an outcome."""
        self._append(outcome.as_json())

    def add_not_measured(self, fault: str, backend: str, phase: str, reason: str) -> None:
        """Append that a try ended before its fault."""
        self._append({"fault": fault, "backend": backend, "phase": phase, NOT_MEASURED: reason})

    def _append(self, values: dict[str, Any]) -> None:
        with self._lock, self._path.open("a+b") as file:
            # Behind a line that a kill has cut off a new one begins.
            file.seek(max(0, file.tell() - 1))
            whole = file.read() in (b"", b"\n")
            file.write((b"" if whole else b"\n") + json.dumps(values).encode() + b"\n")

    def _lines(self) -> Iterator[tuple[int, dict[str, Any]]]:
        """Numbers and values of lines but those that a kill has cut off."""
        if not self._path.exists():
            return
        for number, line in enumerate(self._path.read_text(encoding="utf-8").splitlines(), 1):
            with suppress(json.JSONDecodeError):
                yield number, json.loads(line)


def done(outcomes: Iterable[Outcome]) -> set[tuple[str, str, str, int]]:
    """What need not be run again: those for which the machine had time."""
    return {outcome.key for outcome in outcomes if outcome.punctual}
