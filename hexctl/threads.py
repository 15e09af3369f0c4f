"""Threads that simulate. An interrupt drops them: a simulation cannot be stopped, and may take a minute."""

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from threading import enumerate as enumerate_threads

#: Prefix of the names of the threads.
NAME = "simulate"


@contextmanager
def simulation_threads(count: int | None = None) -> Iterator[ThreadPoolExecutor]:
    """Executor with some threads; None is all cores. Its end awaits no running call, and drops the others."""
    executor = ThreadPoolExecutor(count, NAME)
    try:
        yield executor
    finally:
        executor.shutdown(wait=False, cancel_futures=True)


def simulating() -> bool:
    """Whether dropped calls still run: the interpreter would wait for them at its end."""
    return any(thread.name.startswith(NAME) for thread in enumerate_threads())
