"""For all tests: no display, one thread for matrices, hypothesis without deadlines or luck, no priority."""

import os

import pytest
from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")
# As the command line has it; read when NumPy is imported, which is later.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("hexctl", deadline=None, derandomize=True)
settings.load_profile("hexctl")


@pytest.fixture(autouse=True)
def _ordinary_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse realtime priority: a walk in the tests' own process must not keep it for all that follows."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
