"""Real worker processes on this machine, on ports that the system picks."""

import os
import signal
from collections.abc import Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from threading import Event

import pytest
from distributed import Client, LocalCluster

from hexctl.errors import InputError
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.evaluate import (
    as_finished,
    dask_executor,
    fill,
    simulate_here,
    simulate_on,
    simulating,
)
from hexctl.study.landscapes.landscape import Landscape
from hexctl.waiting import comes_true
from tests.study.made_up import same, spec
from tests.study.watching import Remembering

CODES = (1, 20, 40, 60, 80, 100)
SPECS = [spec(leg, rotation, 1.0, CODES) for leg in (2, 5) for rotation in ("none", "rear")]


class KillsAWorker(Remembering):
    """Kills a worker process once the first chunk is done."""

    def __init__(self, pid: int) -> None:
        super().__init__()
        self.pid: int | None = pid

    def advance(self, landscape: Landscape, gaits: int) -> None:
        super().advance(landscape, gaits)
        if self.pid is not None:
            os.kill(self.pid, signal.SIGKILL)
            self.pid = None


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Landscape]:
    return fill(SPECS, LandscapeCache(tmp_path_factory.mktemp("local")), simulate_here(1), Remembering())


@pytest.fixture(scope="module")
def cluster() -> Iterator[LocalCluster]:
    with LocalCluster(
        processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        yield cluster


def test_a_worker_killed_in_mid_study_changes_nothing(
    cluster: LocalCluster, local: Sequence[Landscape], tmp_path: Path
) -> None:
    address = cluster.scheduler_address
    with Client(address, set_as_default=False) as client:
        pids = list(client.run(os.getpid).values())
    assert len(set(pids)) == 2
    assert os.getpid() not in pids
    watcher = KillsAWorker(pids[0])
    with dask_executor(address) as executor:
        far = fill(SPECS, LandscapeCache(tmp_path), simulate_on(executor), watcher, chunk_size=2)
    assert watcher.pid is None
    assert sum(watcher.gaits) == len(SPECS) * len(CODES)
    assert all(same(one, other) for one, other in zip(far, local, strict=True))


def test_any_executor_will_do(local: Sequence[Landscape], tmp_path: Path) -> None:
    with ThreadPoolExecutor(2) as executor:
        far = fill(SPECS[:2], LandscapeCache(tmp_path), simulate_on(executor), Remembering(), chunk_size=4)
    assert all(same(one, other) for one, other in zip(far, local[:2], strict=True))


@pytest.mark.parametrize("address", ["nonsense", "tcp://127.0.0.1:1"])
def test_a_scheduler_that_is_not_there_is_named(address: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.study.landscapes.evaluate.CONNECT_S", 0.5)
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
