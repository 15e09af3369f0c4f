"""For all tests: no display, hypothesis without deadlines or luck, and no priority over other programs."""

import os

import pytest
from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")

settings.register_profile("hexctl", deadline=None, derandomize=True)
settings.load_profile("hexctl")


@pytest.fixture(autouse=True)
def _ordinary_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse realtime priority: a walk in the tests' own process must not keep it for all that follows."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
