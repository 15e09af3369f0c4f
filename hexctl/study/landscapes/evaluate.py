"""Simulate the gaits that landscapes lack, in chunks: on this computer or on a Dask cluster."""

import math
import socket
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, ThreadPoolExecutor, as_completed
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from os import cpu_count
from threading import enumerate as enumerate_threads
from typing import Any, Protocol, TypeVar

from hexctl.control.batch import run_sim_trials
from hexctl.errors import InputError, MissingExtraError, RobotFaultError, argument
from hexctl.study.compute_options import JOBS
from hexctl.study.landscapes.cache import LandscapeCache
from hexctl.study.landscapes.landscape import Landscape, LandscapeSpec, Rows, rows_of, with_rows
from hexctl.study.landscapes.versions import code_versions

#: Gaits in a chunk. Each chunk settles and turns once more (a sixth of a second); an interrupt loses one.
CHUNK_SIZE = 40

#: How long a Dask scheduler may take to answer.
CONNECT_S = 15

#: How often a chunk whose worker died is given to another worker; after that the chunk counts as the cause.
RETRIES = 3


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """Gaits of one landscape; picklable, and simulating it is a pure function of this value."""

    spec: LandscapeSpec
    codes: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class ChunkDone:
    """The rows of a simulated chunk, and the versions of the code that computed them."""

    chunk: Chunk
    rows: Rows
    versions: dict[str, str]


Simulate = Callable[[Sequence[Chunk]], Iterable[ChunkDone]]


class Progress(Protocol):
    """Observer of a study, a transfer benchmark or the building of a prior."""

    def begin(self, landscapes: Sequence[Landscape]) -> None:
        """Take the landscapes as the cache has them, before any gait is simulated."""

    def advance(self, landscape: Landscape, gaits: int) -> None:
        """Take a landscape to which some simulated gaits were added."""

    def stage(self, name: str, steps: int) -> None:
        """Take the name of the next part of the work and its number of steps."""

    def step(self) -> None:
        """Take that one step of the current part is done."""

    def note(self, text: str) -> None:
        """Take a remark for the user, such as a damaged file in the cache."""


class Silent:
    """Progress that reports nothing."""

    def begin(self, landscapes: Sequence[Landscape]) -> None:
        """Ignore the cached landscapes."""

    def advance(self, landscape: Landscape, gaits: int) -> None:
        """Ignore the simulated gaits."""

    def stage(self, name: str, steps: int) -> None:
        """Ignore the next part of the work."""

    def step(self) -> None:
        """Ignore a step."""

    def note(self, text: str) -> None:
        """Ignore a remark."""


def check_jobs(jobs: int | None) -> None:
    """Raise InputError unless a number of threads is one of `JOBS`; None is the default number."""
    if jobs is not None:
        JOBS.check(argument("jobs"), jobs)


def evaluate(
    specs: Sequence[LandscapeSpec],
    cache: LandscapeCache,
    *,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> list[Landscape]:
    """Complete landscapes in the order of their specs; only gaits that the cache lacks are simulated.

    Args:
        specs: of the landscapes.
        cache: has the gaits simulated before and gets each chunk as soon as it is done.
        jobs: threads per chunk; None is all cores here, one on a Dask worker.
        dask: address of a Dask scheduler; None simulates here.
        progress: observer.

    Raises InputError for an address that does not answer, CacheError when the disk refuses a file.
    """
    progress = progress or Silent()
    if dask is None:
        landscapes = fill(specs, cache, simulate_here(jobs or 0), progress)
    else:
        with dask_executor(dask) as executor:
            landscapes = fill(specs, cache, simulate_on(executor, jobs or 1), progress)
    for note in cache.notes:
        progress.note(note)
    return landscapes


def fill(
    specs: Sequence[LandscapeSpec],
    cache: LandscapeCache,
    simulate: Simulate,
    progress: Progress,
    chunk_size: int = CHUNK_SIZE,
) -> list[Landscape]:
    """Complete landscapes in the order of their specs, simulated by `simulate` where the cache lacks gaits.

    When this is interrupted, every finished chunk is in the cache, and another call continues from there.

    Raises RobotFaultError when a chunk was computed by other code than runs here.
    """
    landscapes = {spec.fingerprint: cache.load(spec) for spec in specs}
    progress.begin(list(landscapes.values()))
    todo = [chunk for landscape in landscapes.values() for chunk in chunks_of(landscape, chunk_size)]
    for done in simulate(todo):
        _check_versions(done.versions)
        key = done.chunk.spec.fingerprint
        landscapes[key] = with_rows(landscapes[key], done.rows)
        cache.save(landscapes[key])
        progress.advance(landscapes[key], len(done.chunk.codes))
    return [landscapes[spec.fingerprint] for spec in specs]


def chunks_of(landscape: Landscape, size: int = CHUNK_SIZE) -> Iterator[Chunk]:
    """Chunks of the gaits that a landscape lacks."""
    missing = landscape.missing
    for first in range(0, len(missing), size):
        yield Chunk(spec=landscape.spec, codes=missing[first : first + size])


def simulate_chunk(chunk: Chunk, threads: int = 0) -> ChunkDone:
    """Rows of all gaits of a chunk, simulated as one batch; they do not depend on the size of the chunk.

    `threads` 0 uses all cores.
    """
    results = run_sim_trials([chunk.spec.trial(code) for code in chunk.codes], threads)
    return ChunkDone(chunk=chunk, rows=rows_of(chunk.spec, chunk.codes, results), versions=code_versions())


def simulate_here(threads: int = 0) -> Simulate:
    """Simulator of chunks one after the other on this computer, each on `threads` cores."""

    def simulate(chunks: Sequence[Chunk]) -> Iterator[ChunkDone]:
        return (simulate_chunk(chunk, threads) for chunk in chunks)

    return simulate


def simulate_on(executor: Executor, threads: int = 1) -> Simulate:
    """Simulator of chunks on an executor, in the order in which they finish.

    `threads` is for each chunk; the executor runs several chunks in parallel, so one is enough.
    """

    def simulate(chunks: Sequence[Chunk]) -> Iterator[ChunkDone]:
        futures = [executor.submit(simulate_chunk, chunk, threads) for chunk in chunks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            _cancel(futures)

    return simulate


def dask_executor(address: str) -> AbstractContextManager[Executor]:
    """Executor of the Dask scheduler at an address such as `tcp://127.0.0.1:8786`, as a context manager.

    Raises InputError when nothing answers there, MissingExtraError without the package `distributed`.
    """
    return _executor(address, _client)


@contextmanager
def _executor(address: str, connect: Callable[[str], Any]) -> Iterator[Executor]:
    with connect(address) as client, client.get_executor(retries=RETRIES, pure=False) as executor:
        yield executor


def _client(address: str) -> Any:
    try:
        from distributed import Client
        from distributed.comm import get_address_host_port
    except ModuleNotFoundError as error:
        raise MissingExtraError(argument("dask"), "study") from error
    try:
        # Before a client starts threads, which it may give up on a busy computer, with an error of its own.
        socket.create_connection(get_address_host_port(address, strict=True), CONNECT_S).close()
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"{argument('dask')}: got {address}; allowed: the address of a Dask scheduler that answers "
            f"({reason})"
        ) from error


def _cancel(futures: Sequence[Future[ChunkDone]]) -> None:
    for future in futures:
        future.cancel()


def _check_versions(versions: dict[str, str]) -> None:
    """Raise RobotFaultError unless a chunk was computed by the versions that run here."""
    here = code_versions()
    differing = [f"{name} {versions.get(name)} for {here[name]}" for name in here
                 if versions.get(name) != here[name]]  # fmt: skip
    if differing:
        raise RobotFaultError(
            f"study: a worker runs other code than this machine: {', '.join(differing)}; "
            "install the same versions on all workers"
        )


Done = TypeVar("Done")

#: Threads of `as_finished` have names that begin so.
THREADS = "simulate"


def as_finished(walks: Sequence[Callable[[int], Done]], jobs: int | None) -> Iterator[Done]:
    """What functions return as they finish; left early, those that have begun run on and are dropped.

    Args:
        walks: simulate; each is called with the number of threads that it may use.
        jobs: threads that simulate together; None is all cores.
    """
    jobs = jobs or cpu_count() or 1
    if jobs == 1:
        yield from (walk(1) for walk in walks)
        return
    threads = math.ceil(jobs / max(1, len(walks)))
    executor = ThreadPoolExecutor(jobs, THREADS)
    try:
        futures = [executor.submit(walk, threads) for walk in walks]
        for future in as_completed(futures):
            yield future.result()
    finally:
        # Not awaited: a walk cannot be stopped, and takes up to a minute.
        executor.shutdown(wait=False, cancel_futures=True)


def finished_on_dask(
    walks: Sequence[Callable[[int], Done]], address: str, jobs: int | None
) -> Iterator[Done]:
    """What picklable functions return as they finish on a Dask cluster.

    Args:
        walks: simulate; each is called with the number of threads that it may use.
        address: of the scheduler.
        jobs: threads of each; None is one.

    Raises InputError for an address that does not answer, RobotFaultError when a worker runs other code.
    """
    with dask_executor(address) as executor:
        futures = [executor.submit(_walked_elsewhere, walk, jobs or 1) for walk in walks]
        try:
            for future in as_completed(futures):
                versions, done = future.result()
                _check_versions(versions)
                yield done
        finally:
            for future in futures:
                future.cancel()


def _walked_elsewhere(walk: Callable[[int], Done], threads: int) -> tuple[dict[str, str], Done]:
    """What a function returns, and the versions of the code that it ran."""
    return code_versions(), walk(threads)


def simulating() -> bool:
    """Whether walks that were dropped still run: the interpreter would wait for them when it ends."""
    return any(thread.name.startswith(THREADS) for thread in enumerate_threads())
