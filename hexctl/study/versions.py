"""Versions of the code that simulates walks; walks of different code are never mixed."""

import hashlib
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_PACKAGES = ("hexctl", "mujoco", "dm_control", "numpy")

PACKAGE = Path(__file__).resolve().parents[1]

#: Parts of the package that decide how a robot walks; the modules directly in it count, too.
ROOMS = ("adapt", "backends", "control", "gait", "ik", "learning", "robot", "runs", "study")


@cache
def code_versions() -> dict[str, str]:
    """Versions of the packages that a walk depends on, and a digest of the source that simulates it.

    Read once per process: files are assumed to be the imported ones.
    """
    installed = {package: _version(package) for package in _PACKAGES}
    return {**installed, "source": source_digest()}


def source_digest(package: Path = PACKAGE) -> str:
    """Digest of the names and contents of the files that decide a walk, 16 hexadecimal digits."""
    digest = hashlib.sha256()
    of_rooms = (file for room in ROOMS for file in (package / room).rglob("*.py"))
    for file in sorted([*package.glob("*.py"), *of_rooms]):
        digest.update(file.relative_to(package).as_posix().encode())
        digest.update(file.read_bytes())
    return digest.hexdigest()[:16]


def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return "none"
