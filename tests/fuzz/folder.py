"""Inputs as files, for decoders that take a path."""

import atexit
import os
import shutil
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from functools import cache
from pathlib import Path


@cache
def own_folder() -> Path:
    """A folder of this process, gone with it; in memory where the system has such a place."""
    memory = Path("/dev/shm")  # noqa: S108  the folder in it has a name of its own
    place = memory if os.access(memory, os.W_OK) else None
    folder = Path(tempfile.mkdtemp(prefix="hexctl-fuzz-", dir=place))
    atexit.register(shutil.rmtree, folder, ignore_errors=True)
    return folder


@contextmanager
def written(name: str, data: bytes) -> Iterator[Path]:
    """Path of a file with an input, which only its owner may read, while the block runs."""
    path = own_folder() / name
    path.write_bytes(data)
    path.chmod(0o600)
    yield path
