"""The cache of walks, and walks on worker processes: what is kept, refused, and simulated again."""

import gzip
import math
import os
import signal
from collections.abc import Callable, Hashable, Iterator, Sequence
from concurrent.futures import Executor, ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from threading import Event
from typing import Any, ClassVar

import pytest

from hexctl.backends.sim.world import World
from hexctl.control.batch import SimTrial
from hexctl.errors import RobotFaultError
from hexctl.study import walk_cache, walking
from hexctl.study.landscape import Landscape
from hexctl.study.versions import code_versions, source_digest
from hexctl.study.walk_cache import CacheError, Place, WalkCache
from hexctl.study.walking import Work, as_finished
from hexctl.threads import simulating
from hexctl.waiting import comes_true
from tests.robots import shipped
from tests.study.made_up import Remembering, spec
from tests.study.test_holds import PLACE as HOLD_PLACE
from tests.study.test_recovery import ROUGH


@dataclass(frozen=True, slots=True)
class Case:
    """A case that is walked together with those of its group."""

    legs: tuple[int, ...]
    group: int = 0


@dataclass(frozen=True, slots=True)
class Stroll:
    """A walk as far as its case says."""

    case: Case
    distance_m: float


@dataclass(frozen=True, kw_only=True)
class Park(Place[Case, Stroll]):
    """A place whose walks take no time."""

    WALK: ClassVar[type] = Stroll

    name: str = "park"
    broken: bool = False

    @property
    def title(self) -> str:
        return self.name

    @property
    def stem(self) -> str:
        return "park"

    def settings(self) -> dict[str, Any]:
        return {"name": self.name}

    def chunk_of(self, case: Case) -> Hashable:
        return case.group

    def trial(self, case: Case) -> SimTrial:
        raise NotImplementedError

    def walk(self, cases: Sequence[Case], threads: int = 1) -> list[Stroll]:
        assert not self.broken
        return [Stroll(case, math.nan if len(case.legs) > 1 else 0.1 * case.legs[0]) for case in cases]


PARK = Park(robot=shipped(), world=World())

CASES = [Case((leg,), group=leg % 2) for leg in (1, 2, 3, 4)] + [Case((1, 2), group=2)]

WALKED = [(PARK, CASES), (replace(PARK, name="wood"), CASES[:2])]


def test_walks_are_simulated_once_and_come_back_as_they_were(tmp_path: Path) -> None:
    cache, first, again = WalkCache(tmp_path), Remembering(), Remembering()
    walks = Work(cache=cache, jobs=1, progress=first).walk(WALKED)
    assert [[walk.case for walk in some] for some in walks] == [cases for _, cases in WALKED]
    assert (first.walks, first.steps, first.notes) == (7, 7, ["park: 5 walks", "wood: 2 walks"])
    broken = [(replace(place, broken=True), cases) for place, cases in WALKED]
    assert repr(Work(cache=WalkCache(tmp_path), progress=again).walk(broken)) == repr(walks)
    assert (again.walks, again.notes) == (0, ["park: from the cache", "wood: from the cache"])
    assert cache.count(WALKED) == (7, 7)
    assert len(list(tmp_path.iterdir())) == 2


@pytest.mark.parametrize("jobs", [1, 3])
def test_what_was_interrupted_goes_on_from_what_has_finished(jobs: int, tmp_path: Path) -> None:
    cache, rest = WalkCache(tmp_path), Remembering()
    with pytest.raises(KeyboardInterrupt):
        Work(cache=cache, jobs=jobs, progress=Remembering(interrupt_after=2)).walk(WALKED)
    saved, total = cache.count(WALKED)
    assert 0 < saved < total == 7
    walks = Work(cache=cache, jobs=jobs, progress=rest).walk(WALKED)
    assert rest.steps == total - saved
    assert repr(walks) == repr(Work(cache=WalkCache(tmp_path / "new"), jobs=1).walk(WALKED))


@pytest.mark.parametrize(
    "content",
    [
        "",
        "[]x",
        '["PARK", [{"case": {"legs": [1]}, "distance_m": "far"}]]',
        '["another place", []]',
        pytest.param("[" * 100_000, id="deep"),
    ],
)
@pytest.mark.parametrize("pack", [gzip.compress, bytes])
def test_a_damaged_file_is_reported_and_its_walks_are_made_again(
    pack: Callable[[bytes], bytes], content: str, tmp_path: Path
) -> None:
    cache, progress = WalkCache(tmp_path), Remembering()
    cache.path_of(PARK).write_bytes(pack(content.replace("PARK", PARK.fingerprint).encode()))
    Work(cache=cache, progress=progress).walk([(PARK, CASES)])
    (note,) = cache.notes
    assert note.startswith(f"{cache.path_of(PARK)}: not usable")
    assert "\n" not in note
    assert (progress.notes[0], progress.steps) == (note, 5)
    assert WalkCache(tmp_path).count([(PARK, CASES)]) == (5, 5)


def test_the_cases_of_equal_places_are_simulated_together_and_once(tmp_path: Path) -> None:
    walked = [(PARK, CASES[:3]), (WALKED[1][0], CASES[:1] * 2), (replace(PARK), CASES[2:])]
    cache, progress = WalkCache(tmp_path), Remembering()
    walks = Work(cache=cache, progress=progress).walk(walked)
    assert [[walk.case for walk in some] for some in walks] == [cases for _, cases in walked]
    assert (progress.steps, sorted(progress.notes)) == (6, ["park: 5 walks", "wood: 1 walks"])
    assert cache.count(walked) == (6, 6)


def test_a_folder_that_cannot_be_written_is_named(tmp_path: Path) -> None:
    (tmp_path / "file").touch()
    cache = WalkCache(tmp_path / "file")
    with pytest.raises(CacheError, match="cannot be written"):
        cache.save(PARK, [])
    with pytest.raises(CacheError):
        cache.probe()


@pytest.mark.parametrize(
    ("place", "changes"),
    [
        (spec(), {"leg": 4, "self_rotation": "rear", "duration_s": 0.5, "seed": 1, "codes": (3, 40)}),
        (spec(), {"world": World(friction=0.5), "placed": True, "hold": "line"}),
        (replace(spec(), placed=True), {"miss_rad": 0.1}),
        (HOLD_PLACE, {"robot": shipped("pexod"), "number": 212, "world": World(), "duration_s": 20.0}),
        (HOLD_PLACE, {"self_rotation": "rear"}),
        (ROUGH, {"robot": shipped("pexod"), "number": 206, "world": World(), "duration_s": 60.0}),
    ],
    ids=["landscape", "its start", "its miss", "hold", "turned before", "recovery"],
)
def test_whatever_decides_a_walk_is_in_the_fingerprint(place: Any, changes: dict[str, Any]) -> None:
    prints = {replace(place, **{name: value}).fingerprint for name, value in changes.items()}
    assert len(prints | {place.fingerprint}) == len(changes) + 1
    assert replace(place).fingerprint == place.fingerprint


def test_the_name_of_a_family_is_not_in_the_fingerprint() -> None:
    assert replace(HOLD_PLACE, family="other", kind="plain").fingerprint == HOLD_PLACE.fingerprint


def test_other_code_has_other_files(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(walk_cache, "code_versions", lambda: {"source": "before"})
    before = spec().fingerprint
    assert spec().fingerprint == before
    monkeypatch.setattr(walk_cache, "code_versions", lambda: {"source": "after"})
    assert spec().fingerprint != before


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
    monkeypatch.setattr("hexctl.study.walk_cache.CHUNK_SIZE", 2)


@pytest.fixture(scope="module")
def local(tmp_path_factory: pytest.TempPathFactory) -> Sequence[Landscape]:
    return Work(cache=WalkCache(tmp_path_factory.mktemp("local")), jobs=1).evaluate(SPECS)


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_a_worker_killed_in_mid_study_changes_nothing(local: Sequence[Landscape], tmp_path: Path) -> None:
    from distributed import Client, LocalCluster

    with LocalCluster(
        processes=True, n_workers=2, threads_per_worker=1, dashboard_address=":0", host="127.0.0.1"
    ) as cluster:
        address = cluster.scheduler_address
        with Client(address, set_as_default=False) as client:
            pids = list(client.run(os.getpid).values())
        assert len(set(pids)) == 2
        assert os.getpid() not in pids
        watcher = KillsAWorker(pids[0])
        far = Work(cache=WalkCache(tmp_path), dask=address, progress=watcher).evaluate(SPECS)
    assert watcher.pid is None
    assert watcher.steps == sum(len(one.codes) for one in SPECS)
    assert far == local


@pytest.mark.slow
@pytest.mark.usefixtures("small_chunks")
def test_threads_and_chunks_change_no_number(local: Sequence[Landscape], tmp_path: Path) -> None:
    assert Work(cache=WalkCache(tmp_path), jobs=5).evaluate(SPECS[:2]) == local[:2]


@pytest.mark.slow
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
        Work(cache=WalkCache(tmp_path), dask="tcp://127.0.0.1:1").evaluate(asked)
    assert WalkCache(tmp_path).load(asked[0]) == {}


@pytest.mark.slow
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


def test_the_digest_changes_with_code_that_decides_a_walk_and_no_other(tmp_path: Path) -> None:
    package = tmp_path / "hexctl"
    for name in ("types", "cli/main", "server/server", "control/deep/guard", "study/landscape"):
        (package / name).parent.mkdir(parents=True, exist_ok=True)
        (package / f"{name}.py").write_text("x = 1\n")
    digests = [source_digest(package)]
    for name in ("types", "control/deep/guard", "study/landscape", "cli/main", "server/server"):
        (package / f"{name}.py").write_text("x = 2\n")
        digests.append(source_digest(package))
    assert len(set(digests[:4])) == 4
    assert set(digests[4:]) == {digests[3]}
