"""A file that is open before it is needed: a process without a free descriptor can still write it."""

import errno
import os
from contextlib import suppress
from pathlib import Path


class ReadyDraft:
    """Replaces a file as a whole, with descriptors that were opened in advance.

    The draft has no name until it is written (O_TMPFILE), so nothing is left behind.

    Args:
        path: of the file; its folder exists. Where disk or system have no such files, `write` fails.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._named = path.with_name(f".{path.name}.{os.getpid()}.part")
        self._folder: int | None = None
        self._file: int | None = None
        self._open()

    def write(self, content: bytes) -> None:
        """Replace the file; it is on the disk when this returns. Raises OSError when the disk refuses."""
        if self._file is None or self._folder is None:
            raise OSError(errno.EBADF, "no draft is open", str(self._path))
        os.ftruncate(self._file, 0)
        if os.pwrite(self._file, content, 0) < len(content):
            raise OSError(errno.ENOSPC, "the disk is full", str(self._path))
        os.fsync(self._file)
        with suppress(FileNotFoundError):
            self._named.unlink()
        # With the number of a folder Python calls linkat, which follows the link; else it would not.
        os.link(f"/proc/self/fd/{self._file}", self._named, src_dir_fd=self._folder, follow_symlinks=True)
        self._named.replace(self._path)
        os.fsync(self._folder)
        os.close(self._file)
        self._file = None
        self._open()

    def close(self) -> None:
        """Give the descriptors back."""
        for descriptor in (self._file, self._folder):
            if descriptor is not None:
                os.close(descriptor)
        self._file = self._folder = None

    def _open(self) -> None:
        """Open the folder and a draft in it, as far as the system has them."""
        with suppress(OSError, AttributeError):  # macOS has no O_TMPFILE
            if self._folder is None:
                self._folder = os.open(self._path.parent, os.O_RDONLY | os.O_DIRECTORY)
            self._file = os.open(self._path.parent, os.O_TMPFILE | os.O_RDWR, 0o666)
