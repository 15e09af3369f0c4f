"""Walks on real worker processes on this machine, on ports that the system picks."""

import os
import signal
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path
from threading import Event

import pytest
from distributed import Client, LocalCluster

from hexctl.errors import InputError, RobotFaultError
from hexctl.study import walking
from hexctl.study.landscape import Landscape
from hexctl.study.versions import code_versions
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import as_finished, dask_executor, evaluate, simulating
from hexctl.waiting import comes_true
from tests.study.made_up import spec
from tests.study.watching import Remembering

pytestmark = pytest.mark.slow

SPECS = [
    spec(leg, rotation, 1.0, (1, 20, 40, 60, 80, 100)) for leg in (2, 5) for rotation in ("none", "rear")
]


class KillsAWorker(Remembering):
    """Kills a worker process once the first chunk is done."""

    def __init__(self, pid: int) -> None:
        super().__init__()
        self.pid: int | None = pid

    def step(self, steps: int = 1) -> None:
        super().step(steps)
        if self.pid is not None:
            os.kill(self.pid, signal.SIGKILL)
            self.pid = None


@pytest.fixture
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.study.landscape.CHUNK_SIZE", 2)


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Landscape]:
    return evaluate(SPECS, WalkCache(tmp_path_factory.mktemp("local")), jobs=1)


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(
        processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        yield cluster


@pytest.mark.usefixtures("small_chunks")
def test_a_worker_killed_in_mid_study_changes_nothing(
    cluster: LocalCluster, local: Sequence[Landscape], tmp_path: Path
) -> None:
    address = cluster.scheduler_address
    with Client(address, set_as_default=False) as client:
        pids = list(client.run(os.getpid).values())
    assert len(set(pids)) == 2
    assert os.getpid() not in pids
    watcher = KillsAWorker(pids[0])
    far = evaluate(SPECS, WalkCache(tmp_path), dask=address, progress=watcher)
    assert watcher.pid is None
    assert watcher.steps == sum(len(one.codes) for one in SPECS)
    assert far == local


@pytest.mark.usefixtures("small_chunks")
@pytest.mark.parametrize("jobs", [2, 5])
def test_threads_and_chunks_change_no_number(jobs: int, local: Sequence[Landscape], tmp_path: Path) -> None:
    assert evaluate(SPECS[:2], WalkCache(tmp_path), jobs=jobs) == local[:2]


def test_a_worker_with_other_code_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def pool(_address: str) -> Iterator[Executor]:
        with ThreadPoolExecutor(1) as executor:
            yield executor

    def foreign(walk: Callable[[int], object], threads: int) -> tuple[dict[str, str], object]:
        return {**code_versions(), "mujoco": "1.0"}, walk(threads)

    monkeypatch.setattr(walking, "dask_executor", pool)
    monkeypatch.setattr(walking, "_walked_elsewhere", foreign)
    asked = [spec(1, "none", 0.1, (1,))]
    with pytest.raises(RobotFaultError, match=r"mujoco 1\.0"):
        evaluate(asked, WalkCache(tmp_path), dask="tcp://127.0.0.1:1")
    assert WalkCache(tmp_path).load(asked[0]) == {}


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1:1"])
def test_a_scheduler_that_is_not_there_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walking, "CONNECT_S", 0.5)
    with pytest.raises(InputError, match="dask: got"), dask_executor(address):
        pass


def test_walks_that_are_left_are_not_awaited() -> None:
    go_on = Event()

    def slow(_threads: int) -> str:
        go_on.wait(30)
        return "slow"

    walks = as_finished([lambda _: "fast", slow, slow], 2)
    assert next(walks) == "fast"
    walks.close()  # type: ignore[attr-defined]
    assert simulating()
    go_on.set()
    assert comes_true(lambda: not simulating(), 30)
