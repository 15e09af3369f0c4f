"""A recorded walk with a failed leg, read back."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.recording.recorded_trial import RecordedTrial, read_trial
from hexctl.runs.run import run


@pytest.fixture(scope="session")
def recording(tmp_path_factory: Any) -> Path:
    path: Path = tmp_path_factory.mktemp("walk") / "walk.rrd"
    run(robot="phantomx", failed_leg=5, self_rotation="none", duration_s=3.0, record=path)
    return path


@pytest.fixture(scope="session")
def walk(recording: Path) -> RecordedTrial:
    return read_trial(recording)
