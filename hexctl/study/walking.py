"""Simulate the walks that a cache lacks, in chunks: on this computer or on a Dask cluster."""

import math
import socket
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, as_completed
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass, field
from functools import partial
from os import cpu_count
from typing import Any, Protocol, TypeVar

from hexctl.errors import InputError, MissingExtraError, RobotFaultError, argument
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.study_options import JOBS
from hexctl.study.versions import code_versions
from hexctl.study.walk_cache import CaseT, Place, WalkCache, Walked, WalkT, distinct
from hexctl.threads import simulation_threads

#: Timeout for the answer of a Dask scheduler.
CONNECT_S = 15

#: How often a chunk whose worker died is given to another worker; after that the chunk counts as the cause.
RETRIES = 3

#: Above this number, places are counted instead of named.
MOST_NAMED = 12


class Progress(Protocol):
    """Observer of an experiment or of the building of a prior."""

    def stage(self, name: str, steps: int) -> None:
        """Take the name of the next part of the work and its number of steps."""

    def step(self, steps: int = 1) -> None:
        """Take that some steps of the current part are done."""

    def note(self, text: str) -> None:
        """Take a remark for the user, such as a damaged file in the cache."""


class Silent:
    """Progress that reports nothing."""

    def stage(self, name: str, steps: int) -> None:
        """Ignore the next part of the work."""

    def step(self, steps: int = 1) -> None:
        """Ignore steps."""

    def note(self, text: str) -> None:
        """Ignore a remark."""


@dataclass(kw_only=True)
class Work:
    """Where walks are simulated and saved, and who watches.

    Attributes:
        cache: gets each chunk as soon as it is done: the next work continues an interrupted one. The folder
            that contains it has the measured uncertainties.
        jobs: threads; None is all cores here, one for each chunk on a Dask worker.
        dask: address of a Dask scheduler whose workers simulate; None simulates here.

    Raises InputError for another number of threads than `JOBS`.
    """

    cache: WalkCache = field(default_factory=WalkCache)
    jobs: int | None = None
    dask: str | None = None
    progress: Progress = field(default_factory=Silent)

    def __post_init__(self) -> None:
        if self.jobs is not None:
            JOBS.check(argument("jobs"), self.jobs)

    def walk(self, walked: Walked) -> list[list[Any]]:
        """Return the walks of each place in the order of its cases; simulate those that the cache lacks.

        Equal places may come again with other cases. Raises InputError for an address that does not answer,
        CacheError if the disk refuses a file, RobotFaultError if a worker runs other code.
        """
        with nullcontext() if self.dask is None else dask_executor(self.dask) as executor:
            return self._walk(walked, executor)

    def _walk(self, walked: Walked, executor: Executor | None) -> list[list[Any]]:
        cache, progress = self.cache, self.progress
        noted, once = len(cache.notes), distinct(walked)
        known = {place.fingerprint: cache.load(place) for place, _ in once}
        for note in cache.notes[noted:]:
            progress.note(note)
        _note_known(once, known, progress)
        todo = [
            (place, chunk)
            for place, cases in once
            for chunk in place.chunks([case for case in cases if case not in known[place.fingerprint]])
        ]
        if left := sum(len(chunk) for _, chunk in todo):
            progress.stage("walks (Ctrl-C stops, the same command continues)", left)
        wanted_of = {place.fingerprint: cases for place, cases in once}
        steps, jobs = [partial(_walk_chunk, *one) for one in todo], self.jobs
        done = as_finished(steps, jobs) if executor is None else _elsewhere(steps, executor, jobs)
        for place, walks in done:
            saved, wanted = known[place.fingerprint], wanted_of[place.fingerprint]
            saved.update((walk.case, walk) for walk in walks)
            cache.save(place, saved.values())
            progress.step(len(walks))
            if all(case in saved for case in wanted):
                progress.note(f"{place.title}: {place.outcome([saved[case] for case in wanted])}")
        return [[known[place.fingerprint][case] for case in cases] for place, cases in walked]

    def evaluate(self, specs: Sequence[LandscapeSpec]) -> list[Landscape]:
        """Return complete landscapes in the order of their specs."""
        walks = self.walk([(spec, spec.codes) for spec in specs])
        return [Landscape.of(spec, some) for spec, some in zip(specs, walks, strict=True)]


def _note_known(walked: Walked, known: dict[str, dict[Any, Any]], progress: Progress) -> None:
    titles = [place.title for place, cases in walked if set(cases) <= known[place.fingerprint].keys()]
    if len(titles) > MOST_NAMED:
        progress.note(f"{len(titles)} of {len(walked)} sets of walks: from the cache")
        return
    for title in titles:
        progress.note(f"{title}: from the cache")


def _walk_chunk(
    place: Place[CaseT, WalkT], cases: Sequence[CaseT], threads: int
) -> tuple[Place[CaseT, WalkT], list[WalkT]]:
    """Walks of cases that are simulated together; picklable, and they depend on nothing else."""
    return place, place.walk(cases, threads)


Done = TypeVar("Done")


def as_finished(walks: Sequence[Callable[[int], Done]], jobs: int | None) -> Iterator[Done]:
    """Yield results as functions finish; if closed early, running functions continue and are dropped.

    Args:
        walks: each is called with the number of threads that it may use.
        jobs: threads that simulate together; None is all cores.
    """
    jobs = jobs or cpu_count() or 1
    if jobs == 1:
        yield from (walk(1) for walk in walks)
        return
    threads = math.ceil(jobs / max(1, len(walks)))
    with simulation_threads(jobs) as executor:
        futures = [executor.submit(walk, threads) for walk in walks]
        for future in as_completed(futures):
            yield future.result()


def _elsewhere(
    walks: Sequence[Callable[[int], Done]], executor: Executor, jobs: int | None
) -> Iterator[Done]:
    """Yield results of picklable functions as a cluster finishes them; `jobs` threads each, None is one."""
    futures = [executor.submit(_walked_elsewhere, walk, jobs or 1) for walk in walks]
    try:
        for future in as_completed(futures):
            versions, done = future.result()
            _check_versions(versions)
            yield done
    finally:
        for future in futures:
            future.cancel()


@contextmanager
def dask_executor(address: str) -> Iterator[Executor]:
    """Executor of the Dask scheduler at an address such as `tcp://127.0.0.1:8786`, as a context manager.

    Raises InputError if nothing answers there, MissingExtraError without the package `distributed`.
    """
    with _client(address) as client, client.get_executor(retries=RETRIES, pure=False) as executor:
        yield executor


def _client(address: str) -> Any:
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ModuleNotFoundError as error:
        raise MissingExtraError(argument("dask"), "study") from error
    try:
        # Before a client starts threads, which it may give up on a busy computer, with another error.
        socket.create_connection(get_address_host_port(address, strict=True), CONNECT_S).close()
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{argument('dask')}: got {address}; allowed: the address of a Dask scheduler that answers "
            f"({reason})"
        ) from error


def _walked_elsewhere(walk: Callable[[int], Done], threads: int) -> tuple[dict[str, str], Done]:
    """Versions of the code that a worker runs, and the result of a function."""
    return code_versions(), walk(threads)


def _check_versions(versions: dict[str, str]) -> None:
    """Raise RobotFaultError unless walks were simulated by the versions that run here."""
    here = code_versions()
    differing = [f"{name} {versions.get(name)} for {here[name]}" for name in here
                 if versions.get(name) != here[name]]  # fmt: skip
    if differing:
        raise RobotFaultError(
            f"study: a worker runs other code than this machine: {', '.join(differing)}; "
            "install the same versions on all workers"
        )
