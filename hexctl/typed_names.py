"""Typed names: found in any case and spelling, with suggestions."""

import re
from collections.abc import Iterable, Mapping

#: Word parts in American spelling, with the British ones of the names.
_BRITISH = {
    "izat": "isat",
    "ize": "ise",
    "izing": "ising",
    "yze": "yse",
    "color": "colour",
    "center": "centre",
    "gray": "grey",
    "meter": "metre",
    "behavior": "behaviour",
}

#: Minimum similarity of a suggestion.
_NEAR = 0.6


def known_name(text: str, names: Iterable[str]) -> str | None:
    """The name that a text means, in any case, with US spelling, hyphens, underscores or spaces; or None."""
    known = list(names)
    if text in known:
        return text
    same = [name for name in known if _plain(name) == _plain(text)]
    return same[0] if len(same) == 1 else None


def nearest(text: str, names: Iterable[str]) -> str:
    """The end of a message about an unknown name: `; did you mean 'tripod'?`, or empty."""
    near = nearest_name(text, names)
    return "" if near is None else f"; did you mean {near!r}?"


def nearest_name(text: str, names: Iterable[str]) -> str | None:
    """The name most similar to a text, or None."""
    by_plain: Mapping[str, str] = {_plain(name): name for name in names}
    from difflib import get_close_matches  # loaded for a message only

    near = get_close_matches(_plain(text)[:100], by_plain, n=1, cutoff=_NEAR)
    return by_plain[near[0]] if near else None


def _plain(text: str) -> str:
    plain = re.sub(r"[\s_-]+", "-", text.strip().casefold())
    for american, british in _BRITISH.items():
        plain = plain.replace(american, british)
    return plain
