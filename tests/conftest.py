"""For all tests: no display, one thread for matrices, hypothesis without deadlines or luck, no priority."""

import os
import signal
from pathlib import Path
from typing import Any

import pytest
from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")
# As the command line has it; read when NumPy is imported, which is later.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

# Programs ignore what their parent ignores: hangups under nohup, Ctrl-C in the background of a script.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGQUIT, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

settings.register_profile("local", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("thorough", deadline=None, derandomize=True, max_examples=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "local"))


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """Several workers share the tests as `tests.schedule` says."""
    from tests.schedule import Schedule

    return Schedule(config, log)


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file of which a lane has no test is not imported."""
    from tests.schedule import may_select

    if not collection_path.name.startswith("test_") or not config.option.markexpr:
        return None
    file = collection_path.relative_to(config.rootpath).as_posix()
    return None if may_select(config.option.markexpr, file) else True


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Tests are marked by their place; on a worker, what takes long comes first."""
    from tests.schedule import markers_of, ordered

    for item in items:
        for marker in markers_of(item.nodeid):
            item.add_marker(marker)
    if hasattr(config, "workerinput"):
        items[:] = ordered(items)


@pytest.fixture(autouse=True)
def _own_state(monkeypatch: pytest.MonkeyPatch, tmp_path_factory: pytest.TempPathFactory) -> None:
    """Keep stops of served robots apart from those of other tests, and settings of this computer out."""
    monkeypatch.delenv("STATE_DIRECTORY", raising=False)
    for name in [name for name in os.environ if name.startswith("HEXCTL_") and "_TEST_" not in name]:
        if not name.startswith("HEXCTL_REQUIRE_"):
            monkeypatch.delenv(name)
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path_factory.getbasetemp() / "no-settings"))
    monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path_factory.getbasetemp() / f"state-{os.urandom(6).hex()}"))
    monkeypatch.setenv("XDG_CACHE_HOME", os.environ["XDG_STATE_HOME"])


@pytest.fixture(autouse=True)
def _ordinary_priority(monkeypatch: pytest.MonkeyPatch) -> None:
    """Refuse realtime priority: a walk in the tests' own process must not keep it for all that follows."""

    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse, raising=False)
