"""Recordings to export: those that are given, or those of a session, read when they are needed."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from hexctl.adapt.sessions.store import load_session
from hexctl.errors import InputError, check_type
from hexctl.record.recorded_trial import RecordedTrial, read_trial
from hexctl.robot.model import Robot

#: What is told while an export runs: how much is done, and how much there is.
OnProgress = Callable[[int, int], object]


class Trials(Protocol):
    """Trials that can be counted and read one by one."""

    def __len__(self) -> int:
        """How many there are."""

    def __getitem__(self, index: int, /) -> RecordedTrial:
        """One of them."""

    def __iter__(self) -> Iterator[RecordedTrial]:
        """Each of them."""


@dataclass(frozen=True, slots=True)
class Recordings:
    """Recordings that are read when they are needed: those of a session need not fit in memory.

    Attributes:
        paths: the files.
        robot: the robot of recordings that do not hold theirs.
    """

    paths: tuple[Path, ...]
    robot: Robot | None = None

    def __len__(self) -> int:
        return len(self.paths)

    def __getitem__(self, index: int, /) -> RecordedTrial:
        return read_trial(self.paths[index], self.robot)

    def __iter__(self) -> Iterator[RecordedTrial]:
        return (read_trial(path, self.robot) for path in self.paths)


def is_session(source: Any) -> bool:
    """Whether a source can only be the name of a session."""
    return not isinstance(source, Robot) and not Path(str(source)).suffix


def recordings_of(sources: Sequence[str | Path | Robot], runs: Path) -> tuple[Path, ...]:
    """Recordings that are given, or those of a session that is.

    Raises InputError for anything else, and for a session without recordings.
    """
    found: list[Path] = []
    for source in sources:
        check_type(source, (str, Path), "export", "recordings (.rrd) or the name of a session")
        found += _of_session(str(source), runs) if is_session(source) else [Path(str(source))]
    return tuple(found)


def title_of(trial: RecordedTrial) -> str:
    """Robot, gait and the failed legs that the walk was told of, in a line."""
    told = trial.properties
    failed = {str(told["failed_leg"]): told.get("failure", "failed")} if "failed_leg" in told else {}
    failed |= json.loads(told.get("further_failures", "{}"))
    legs = [f"leg {leg} {how}" for leg, how in failed.items()]
    return ", ".join([str(told.get("title", trial.robot.name)), *legs])


def _of_session(name: str, runs: Path) -> list[Path]:
    session = load_session(name, runs)
    told = [Path(trial.recording) for trial in session.trials if trial.recording is not None]
    # A folder of runs may have been moved or be used from elsewhere.
    there = [path if path.is_file() else runs / name / path.name for path in told]
    there = [path for path in there if path.is_file()]
    if not there:
        raise InputError(f"session {name}: has no recordings to export")
    return there
