"""Installed packages of hexctl, by extra."""

import re
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, requires, version

#: Name and extra of a requirement, in the form of `Requires-Dist`.
_REQUIREMENT = re.compile(r"^([A-Za-z0-9._-]+)(\[[^]]*\])?[^;]*(?:;.*extra == ['\"]([\w-]+)['\"])?")

#: Extras for developers, and the sum of all others.
_NOT_FOR_USE = ("all", "dev", "docs", "testing")


@dataclass(frozen=True, slots=True, kw_only=True)
class Packages:
    """Versions of hexctl and of its packages, None if missing, and missing packages by extra."""

    hexctl: str | None
    versions: dict[str, str | None]
    extras: dict[str, tuple[str, ...]]

    def lacks(self, *names: str) -> tuple[str, ...]:
        """The missing packages among some."""
        return tuple(name for name in names if installed(name) is None)


def installed(name: str) -> str | None:
    """Version of a package, or None."""
    try:
        return version(name)
    except PackageNotFoundError:
        return None


def read_packages() -> Packages:
    """Installed packages."""
    needed = _requirements()
    versions = {name: installed(name) for names in needed.values() for name in names}
    return Packages(
        hexctl=installed("hexctl"),
        versions=dict(sorted(versions.items())),
        extras={
            extra: tuple(name for name in names if versions[name] is None)
            for extra, names in needed.items()
            if extra and extra not in _NOT_FOR_USE
        },
    )


def _requirements() -> dict[str, list[str]]:
    """Packages by extra, required ones under an empty name; extras of extras are resolved."""
    try:
        lines = requires("hexctl") or []
    except PackageNotFoundError:
        return {"": []}
    own: dict[str, list[str]] = {"": []}
    others: dict[str, list[str]] = {}
    for line in lines:
        found = _REQUIREMENT.match(line)
        if found is None:
            continue
        name, bracket, extra = found[1], found[2] or "", found[3] or ""
        own.setdefault(extra, [])
        if name == "hexctl":
            others.setdefault(extra, []).extend(bracket.strip("[]").split(","))
        elif extra not in ("dev", "docs", "testing"):
            own[extra].append(name)
    return {extra: _with_others(extra, own, others) for extra in own}


def _with_others(extra: str, own: dict[str, list[str]], others: dict[str, list[str]]) -> list[str]:
    names = list(own.get(extra, []))
    for other in others.get(extra, []):
        names += _with_others(other, own, others)
    return list(dict.fromkeys(names))
