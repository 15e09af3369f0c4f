"""Simulate what landscapes still miss, chunk by chunk, each saved as soon as it is done."""

from collections.abc import Callable, Iterable, Iterator, Sequence
from typing import Protocol

from hexctl.errors import RobotFaultError
from hexctl.study.cache import LandscapeCache
from hexctl.study.chunk import CHUNK_SIZE, Chunk, ChunkDone, chunks_of, simulate_chunk
from hexctl.study.landscape import Landscape, LandscapeSpec, with_rows
from hexctl.study.versions import code_versions

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
