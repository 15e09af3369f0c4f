"""A program with more open files than `select` can wait for."""

import os
import resource
from collections.abc import Iterator
from contextlib import contextmanager

import pytest

#: Open files that are allowed meanwhile, and that are held.
ALLOWED, HELD = 2048, 1100


@contextmanager
def many_open_files() -> Iterator[None]:
    """While the block runs, whatever is opened has a descriptor above 1,023.

    Skips the test where the computer allows no more than that.
    """
    before, most = resource.getrlimit(resource.RLIMIT_NOFILE)
    if most != resource.RLIM_INFINITY and most < ALLOWED:
        pytest.skip(f"no more than {most} open files are allowed here; {ALLOWED} are needed")
    held: list[int] = []
    try:
        resource.setrlimit(resource.RLIMIT_NOFILE, (max(before, ALLOWED), most))
        held.extend(os.open(os.devnull, os.O_RDONLY) for _ in range(HELD))
        yield
    finally:
        for one in held:
            os.close(one)
        resource.setrlimit(resource.RLIMIT_NOFILE, (before, most))
