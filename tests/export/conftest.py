"""A recorded walk with a failed leg, read back."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.sessions.store import SessionStore
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.recording.recorded_trial import RecordedTrial, read_trial
from hexctl.runs.run import run
from tests.adapt.walking import SPEC, result_of


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
    space = GaitSpace((5,))
    kept = store.folder_of(session.name)
    for index, left_m in enumerate(off_m, start=1):
        result = result_of(left_m)
        name = f"trial-{index:03d}.rrd"
        (kept / name).hardlink_to(recording)
        trial = TrialRecord(
            index=index,
            code=index,
            slots=space.slots_of(index),
            score=abs(left_m),
            outcome=result.to_dict(),
            path_m=np.round(result.path_m[::10], 4).tolist(),
            # Where it was written does not matter: a copy of the folder is looked up in the folder.
            recording=str(folder / "before" / name),
        )
        store.add(session, trial, {})
    return session.name, kept
