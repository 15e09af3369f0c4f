"""For all tests: no display, one thread for matrices, hypothesis without deadlines or luck, no priority.

Tests in real time share one worker: they mostly wait, and would hold one another up.
"""

import os

import pytest
from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")
# As the command line has it; read when NumPy is imported, which is later.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

settings.register_profile("local", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("ci", deadline=None, derandomize=True, max_examples=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "local"))


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Give the tests in real time their group, before xdist reads it."""
    for item in items:
        if item.get_closest_marker("realtime"):
            item.add_marker(pytest.mark.xdist_group("realtime"))


@pytest.fixture(autouse=True)
def _ordinary_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse realtime priority: a walk in the tests' own process must not keep it for all that follows."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
