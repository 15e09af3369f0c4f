"""Chunks simulated by the workers of a Dask cluster, or of any executor."""

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor, Future, as_completed
from contextlib import AbstractContextManager, contextmanager
from typing import Any

from hexctl.errors import InputError, MissingExtraError
from hexctl.study.chunk import Chunk, ChunkDone, simulate_chunk
from hexctl.study.evaluate import Simulate

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
