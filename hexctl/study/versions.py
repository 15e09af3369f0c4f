"""What the code is that simulates: landscapes of other code are never mixed."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

#: Raised by hand when landscapes change in a way that nothing below tells.
LANDSCAPE_VERSION = 1

_PACKAGES = ("hexctl", "mujoco", "dm_control", "numpy")

#: The parts of hexctl that decide how a robot walks in a simulation.
_SOURCES = ("robot", "gait", "ik", "control", "backends", "study/landscape.py", "study/evaluate.py")


@cache
def code_versions() -> dict[str, str]:
    """Return the versions that a landscape depends on, and a digest of the source that simulates it.

    Read once per process: it describes the code that runs, as long as nobody changes the files meanwhile.
    """
    installed = {package: _version(package) for package in _PACKAGES}
    return {**installed, "landscape": str(LANDSCAPE_VERSION), "source": _source_digest()}


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"


def _source_digest() -> str:
    """Return a digest of the files of `_SOURCES`, names and contents."""
    root, digest = Path(__file__).resolve().parent.parent, hashlib.sha256()
    for source in _SOURCES:
        path = root / source
        for file in sorted(path.rglob("*.py")) if path.is_dir() else [path]:
            digest.update(file.relative_to(root).as_posix().encode())
            digest.update(file.read_bytes())
    return digest.hexdigest()[:16]
