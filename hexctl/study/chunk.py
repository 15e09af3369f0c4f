"""A chunk: some gaits of one landscape, the unit of work that is simulated, saved and sent to others."""

from collections.abc import Iterator
from dataclasses import dataclass

from hexctl.control.batch import run_sim_trials
from hexctl.study.landscape import Landscape, LandscapeSpec, Rows, rows_of
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
