"""Recordings to export, given directly or by a session, and read lazily."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from hexctl.adapt.sessions.store import load_session
from hexctl.errors import InputError, check_type
from hexctl.files import OnDamage, log_damage
from hexctl.recording.recorded_trial import RecordedTrial, read_trial
from hexctl.robot.model import Robot

#: Takes the number of finished items of an export, and the total.
OnProgress = Callable[[int, int], object]


@dataclass(frozen=True, slots=True)
class Recordings:
    """Recordings, read lazily: those of a session need not fit in memory.

    Iteration skips unreadable files of sessions (`of_sessions`), and reports each to `on_damage`. `robot` is
    for recordings that lack theirs.
    """

    paths: tuple[Path, ...]
    robot: Robot | None = None
    of_sessions: frozenset[Path] = frozenset()
    on_damage: OnDamage = log_damage

    def __len__(self) -> int:
        return len(self.paths)

    def __iter__(self) -> Iterator[RecordedTrial]:
        """Readable trials; raises InputError for an unreadable file outside sessions, and without any."""
        readable = 0
        for path in self.paths:
            try:
                trial = read_trial(path, self.robot)
            except InputError as error:
                if path not in self.of_sessions or len(self.paths) == 1:
                    raise
                self.on_damage(error)
            else:
                readable += 1
                yield trial
        if not readable:
            count = len(self.paths)
            raise InputError(f"export: none of {count} recordings can be read; allowed: one or more that can")


#: Trials that can be counted and read one by one.
Trials = Recordings | Sequence[RecordedTrial]


def is_session(source: Any) -> bool:
    """Whether a source can only be the name of a session."""
    return not isinstance(source, Robot) and not Path(str(source)).suffix


def recordings_to_export(
    sources: Sequence[str | Path | Robot],
    runs: Path,
    robot: Robot | None = None,
    on_damage: OnDamage = log_damage,
) -> Recordings:
    """Recordings of files or of a session; raises InputError for anything else, and without any."""
    found: list[Path] = []
    given: set[Path] = set()
    for source in sources:
        check_type(source, (str, Path), "export", "recordings (.rrd) or the name of a session")
        if is_session(source):
            found += _of_session(str(source), runs, on_damage)
        else:
            found.append(Path(str(source)))
            given.add(found[-1])
    return Recordings(tuple(found), robot, frozenset(found) - given, on_damage)


def title_of(trial: RecordedTrial) -> str:
    """Robot, gait and announced failed legs of a trial, in a line."""
    told = trial.properties
    failed = {str(told["failed_leg"]): told.get("failure", "failed")} if "failed_leg" in told else {}
    failed |= json.loads(told.get("further_failures", "{}"))
    legs = [f"leg {leg} {how}" for leg, how in failed.items()]
    return ", ".join([str(told.get("title", trial.robot.name)), *legs])


def _of_session(name: str, runs: Path, on_damage: OnDamage) -> list[Path]:
    session = load_session(name, runs, on_damage=on_damage)
    named = [trial.recording_in(runs / name) for trial in session.trials]
    found = [path for path in named if path is not None]
    if not any(path.is_file() for path in found):
        raise InputError(f"session {name}: has no recordings to export")
    return found
