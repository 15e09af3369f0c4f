"""The file of a recording: always a new one. Needs no Rerun."""

from pathlib import Path

from hexctl.errors import InputError

#: Rerun tells its files by this ending.
SUFFIX = ".rrd"


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


def check_name(path: Path) -> None:
    """Raise InputError for a name that Rerun would not open."""
    if path.suffix != SUFFIX:
        raise InputError(f"recording: got {path}; allowed: a name that ends in {SUFFIX}")


def probe_file(path: Path) -> None:
    """Raise InputError unless `create_file` can make the file, which is then removed again; folders stay."""
    check_name(path)
    create_file(path)
    path.unlink()
