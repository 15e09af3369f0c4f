"""Simulate the gaits that landscapes lack, in chunks: on this computer or on a Dask cluster."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from typing import Any, Protocol

from hexctl.control.batch import run_sim_trials
from hexctl.errors import InputError, MissingExtraError, RobotFaultError
from hexctl.study.cache import LandscapeCache
from hexctl.study.landscape import Landscape, LandscapeSpec, Rows, rows_of, with_rows
from hexctl.study.versions import code_versions

#: Gaits in a chunk. Each chunk settles and turns anew (a sixth of a second), and an interrupt loses one.
CHUNK_SIZE = 40


@dataclass(frozen=True, kw_only=True)
class Chunk:
    """Gaits of one landscape; picklable, and simulating it is a pure function of this value."""

    spec: LandscapeSpec
    codes: tuple[int, ...]


@dataclass(frozen=True, kw_only=True)
class ChunkDone:
    """What became of a chunk, and the code that computed it."""

    chunk: Chunk
    rows: Rows
    versions: dict[str, str]


def simulate_chunk(chunk: Chunk, threads: int = 0) -> ChunkDone:
    """Walk all gaits of a chunk at once; the rows do not depend on how a landscape is cut into chunks.

    `threads` 0 uses all cores.
    """
    results = run_sim_trials([chunk.spec.trial(code) for code in chunk.codes], threads)
    return ChunkDone(chunk=chunk, rows=rows_of(chunk.spec, chunk.codes, results), versions=code_versions())


def chunks_of(landscape: Landscape, size: int = CHUNK_SIZE) -> Iterator[Chunk]:
    """Give the gaits that a landscape still misses, in chunks."""
    missing = landscape.missing
    for first in range(0, len(missing), size):
        yield Chunk(spec=landscape.spec, codes=missing[first : first + size])


Simulate = Callable[[Sequence[Chunk]], Iterable[ChunkDone]]


class Watcher(Protocol):
    """Is told how the work goes on."""

    def begin(self, landscapes: Sequence[Landscape]) -> None:
        """Take what is known of every landscape before anything is simulated."""

    def advance(self, landscape: Landscape, gaits: int) -> None:
        """Take a landscape that has got some more gaits."""


def simulate_here(threads: int = 0) -> Simulate:
    """Return a way to simulate chunks one after the other on this machine, each on `threads` cores."""

    def simulate(chunks: Sequence[Chunk]) -> Iterator[ChunkDone]:
        return (simulate_chunk(chunk, threads) for chunk in chunks)

    return simulate


def fill(
    specs: Sequence[LandscapeSpec],
    cache: LandscapeCache,
    simulate: Simulate,
    watcher: Watcher,
    chunk_size: int = CHUNK_SIZE,
) -> list[Landscape]:
    """Return all landscapes, complete, in the order of their specs; only what the cache lacks is simulated.

    Whatever ends this early, each chunk that was done is in the cache, and another call goes on from there.

    Raises RobotFaultError when a chunk was computed by other code than runs here.
    """
    landscapes = {spec.fingerprint: cache.load(spec) for spec in specs}
    watcher.begin(list(landscapes.values()))
    todo = [chunk for landscape in landscapes.values() for chunk in chunks_of(landscape, chunk_size)]
    for done in simulate(todo):
        _check_versions(done)
        key = done.chunk.spec.fingerprint
        landscapes[key] = with_rows(landscapes[key], done.rows)
        cache.save(landscapes[key])
        watcher.advance(landscapes[key], len(done.chunk.codes))
    return [landscapes[spec.fingerprint] for spec in specs]


def _check_versions(done: ChunkDone) -> None:
    here = code_versions()
    differing = [f"{name} {done.versions.get(name)} for {here[name]}" for name in here
                 if done.versions.get(name) != here[name]]  # fmt: skip
    if differing:
        raise RobotFaultError(
            f"study: a worker runs other code than this machine: {', '.join(differing)}; "
            "install the same versions on all workers"
        )


#: How long a scheduler may take to answer.
CONNECT_S = 15

#: A chunk whose worker dies is given to another one; after so many deaths it is the chunk's own fault.
RETRIES = 3


def simulate_on(executor: Executor, threads: int = 1) -> Simulate:
    """Return a way to simulate chunks on an executor, in whatever order they are done.

    `threads` is for each chunk; the executor runs several chunks at once, so one is enough.
    """

    def simulate(chunks: Sequence[Chunk]) -> Iterator[ChunkDone]:
        futures = [executor.submit(simulate_chunk, chunk, threads) for chunk in chunks]
        try:
            for future in as_completed(futures):
                yield future.result()
        finally:
            _drop(futures)

    return simulate


def dask_executor(address: str) -> AbstractContextManager[Executor]:
    """Return an executor of the Dask scheduler at an address such as `tcp://127.0.0.1:8786`, to be closed.

    Raises InputError when nothing answers there.
    """
    return _executor(address, _client)


@contextmanager
def _executor(address: str, connect: Callable[[str], Any]) -> Iterator[Executor]:
    with connect(address) as client, client.get_executor(retries=RETRIES, pure=False) as executor:
        yield executor


def _client(address: str) -> Any:
    try:
        from distributed import Client
    except ModuleNotFoundError as error:
        raise MissingExtraError("--dask", "study") from error
    try:
        return Client(address, timeout=CONNECT_S, set_as_default=False)
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise InputError(
            f"--dask: got {address}; allowed: the address of a Dask scheduler that answers ({reason})"
        ) from error


def _drop(futures: Sequence[Future[ChunkDone]]) -> None:
    for future in futures:
        future.cancel()
