"""A recorded walk with a failed leg, read back."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.sessions.store import SessionStore
from hexctl.recording.recorded_trial import RecordedTrial, read_trial
from hexctl.runs.run import run
from tests.adapt.walking import SPEC, record


@pytest.fixture(scope="session")
def recording(tmp_path_factory: Any) -> Path:
    path: Path = tmp_path_factory.mktemp("walk") / "walk.rrd"
    run(robot="phantomx", failed_leg=5, self_rotation="none", duration_s=3.0, record=path)
    return path


@pytest.fixture(scope="session")
def walk(recording: Path) -> RecordedTrial:
    return read_trial(recording)


def session_in(folder: Path, recording: Path, off_m: Sequence[float]) -> tuple[str, Path]:
    """Name and folder of a session whose trials end so far to the left and have the same recording."""
    store = SessionStore(folder)
    session = store.create(SPEC)
    kept = store.folder_of(session.name)
    for index, left_m in enumerate(off_m, start=1):
        name = f"trial-{index:03d}.rrd"
        (kept / name).hardlink_to(recording)
        # Where it was written does not matter: a copy of the folder is looked up in the folder.
        store.add(session, replace(record(index, left_m), recording=str(folder / "before" / name)), {})
    return session.name, kept
