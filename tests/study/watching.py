"""A watcher that remembers what it was told, and a simulation that counts."""

from collections.abc import Iterator, Sequence

from hexctl.study.landscapes.evaluate import Chunk, ChunkDone, Silent, simulate_chunk
from hexctl.study.landscapes.landscape import Landscape


class Remembering(Silent):
    def __init__(self) -> None:
        self.known: list[bool] = []
        self.gaits: list[int] = []

    def begin(self, landscapes: Sequence[Landscape]) -> None:
        self.known = [landscape.complete for landscape in landscapes]

    def advance(self, landscape: Landscape, gaits: int) -> None:
        self.gaits.append(gaits)


class Counting:
    """Simulates, counts chunks, and is interrupted after some of them."""

    def __init__(self, interrupt_after: int | None = None) -> None:
        self.chunks: list[Chunk] = []
        self._left = interrupt_after

    def __call__(self, chunks: Sequence[Chunk]) -> Iterator[ChunkDone]:
        for chunk in chunks:
            if self._left == len(self.chunks):
                raise KeyboardInterrupt
            self.chunks.append(chunk)
            yield simulate_chunk(chunk)
