"""The file of a recording: always a new one. Needs no Rerun."""

from pathlib import Path

from hexctl.errors import InputError


def create_file(path: Path) -> None:
    """Make an empty file and the folders above it, because Rerun overwrites an existing one without a word.

    Raises InputError for a file that exists or cannot be written.
    """
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.open("xb").close()
    except OSError as error:
        if isinstance(error, FileExistsError) and path.exists():
            raise InputError(f"recording: {path} exists; allowed: a new file, nothing is replaced") from None
        raise InputError(
            f"recording: {path} cannot be written ({error.strerror}); allowed: a new file"
        ) from error


def probe_file(path: Path) -> None:
    """Raise InputError unless `create_file` can make the file; leave nothing behind."""
    create_file(path)
    path.unlink()
