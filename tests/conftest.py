"""For all tests: no display, one thread for matrices, hypothesis without deadlines or luck, no priority."""

import gc
import os
import re
import signal
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import entry_points
from itertools import chain, combinations
from pathlib import Path

import pytest
from _pytest.mark.expression import Expression
from hypothesis import settings

os.environ.setdefault("MUJOCO_GL", "disable")
# As the command line has it; read when NumPy is imported, which is later.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

MARKS = re.compile(r"\bpytest\.mark\.(\w+)\b")

# Programs ignore what their parent ignores: hangups under nohup, Ctrl-C in the background of a script.
signal.signal(signal.SIGHUP, signal.SIG_DFL)
signal.signal(signal.SIGQUIT, signal.SIG_DFL)
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# Where the scheduler shares the cores among sessions, all else that the machine does counts as one of them.
if "PYTEST_XDIST_WORKER" in os.environ:
    os.setsid()

settings.register_profile("local", deadline=None, derandomize=True, max_examples=25)
settings.register_profile("thorough", deadline=None, derandomize=True, max_examples=100)
settings.load_profile(os.environ.get("HYPOTHESIS_PROFILE", "local"))


@pytest.fixture(autouse=True)
def _no_custom_objects_yet() -> Iterator[None]:
    """Objects of packages that an earlier test loaded have their short names again."""
    yield
    if (plugins := sys.modules.get("hexctl.robot.plugins")) is not None:
        plugins._CUSTOM.clear()


def pytest_sessionstart() -> None:
    """An editable installation keeps the entry points of the day it was made."""
    text = (Path(__file__).parents[1] / "pyproject.toml").read_text(encoding="utf-8")
    for group, wanted in tomllib.loads(text)["project"]["entry-points"].items():
        found = {one.name: one.value for one in entry_points(group=group)}
        if not wanted.items() <= found.items():
            refresh = "python -c 'from setuptools import setup; setup(packages=[])' -q egg_info"
            pytest.exit(
                f"{group}: installed are the entry points of another pyproject.toml: make setup, or {refresh}"
            )


@pytest.hookimpl(wrapper=True)
def pytest_collection() -> Iterator[None]:
    """What collection makes lives until the end: the search for garbage leaves it out, now and later."""
    gc.disable()
    yield
    gc.freeze()
    gc.enable()


def pytest_ignore_collect(collection_path: Path, config: pytest.Config) -> bool | None:
    """A file whose marks leave nothing for this lane is not imported."""
    if not collection_path.name.startswith("test_") or not config.option.markexpr:
        return None
    text = collection_path.read_text(encoding="utf-8")
    of_all = {mark for line in re.findall(r"^pytestmark = .*$", text, re.M) for mark in MARKS.findall(line)}
    of_some = sorted(set(MARKS.findall(text)) - of_all)
    subsets = chain.from_iterable(combinations(of_some, count) for count in range(len(of_some) + 1))
    lane = Expression.compile(config.option.markexpr)
    marked = [of_all.union(more) for more in subsets]
    wanted = any(lane.evaluate(lambda name, /, _of=marks, **_: name in _of) for marks in marked)
    return None if wanted else True


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
