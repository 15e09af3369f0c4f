"""A program with more open files than `select` can wait for."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def many_open_files() -> Iterator[None]:
    """While the block runs, whatever is opened has a descriptor above 1,023."""
    before, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (max(before, 2048), most))
    held = [os.open(os.devnull, os.O_RDONLY) for _ in range(1100)]
    try:
        yield
    finally:
        for one in held:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, most))
