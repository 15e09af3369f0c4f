"""Files written atomically: a reader, or a power cut, finds the old file or the new one, never a part."""

import os
import secrets
import shutil
import zipfile
import zlib
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

#: What numpy and zipfile raise for an archive (.npz) that is damaged.
ARCHIVE_DAMAGE: tuple[type[Exception], ...] = (
    OSError,
    EOFError,
    ValueError,
    KeyError,
    TypeError,
    NotImplementedError,
    zipfile.BadZipFile,
    zlib.error,
    RuntimeError,  # zipfile, of a file that claims to be encrypted
)


def atomic_write(path: Path, content: str | bytes) -> None:
    """Write a file, in place of an earlier one; it is on the disk when this returns. Text is UTF-8.

    Raises OSError when the disk refuses; the earlier file is then as it was.
    """
    data = content.encode() if isinstance(content, str) else content
    with replacing(path) as draft:
        draft.write_bytes(data)


@contextmanager
def replacing(path: Path) -> Iterator[Path]:
    """Path of a draft beside a file, which takes the file's place, and its permissions, when the block ends.

    The block creates the draft. If the block raises, the draft is removed and the file is as it was.
    Raises OSError when the disk refuses.
    """
    draft = path.with_name(f".{path.stem}-{secrets.token_hex(4)}.part")
    try:
        yield draft
        if path.is_file():
            shutil.copymode(path, draft)
        _sync(draft)
        draft.replace(path)
        _sync(path.parent)
    finally:
        with suppress(OSError):
            draft.unlink(missing_ok=True)


def _sync(path: Path) -> None:
    """Make sure that a file, or the names in a folder, are on the disk."""
    descriptor = os.open(path, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)
