"""Names that a person types: found in any case and spelling, and proposed where one is near."""

import re
from collections.abc import Iterable, Mapping

#: How American words end or begin that the names here write in the British way.
_BRITISH = {
    "izat": "isat", "ize": "ise", "izing": "ising", "yze": "yse", "color": "colour", "center": "centre",
    "gray": "grey", "meter": "metre", "behavior": "behaviour",
}  # fmt: skip

#: Share of signs that a proposal has in common with what was typed.
_NEAR = 0.6


def known_name(text: str, names: Iterable[str]) -> str | None:
    """The one of some names that a text means: itself, or the same in another case or in US spelling.

    Hyphens, underscores and spaces are one sign. None for anything else.
    """
    known = list(names)
    if text in known:
        return text
    same = [name for name in known if _plain(name) == _plain(text)]
    return same[0] if len(same) == 1 else None


def nearest(text: str, names: Iterable[str]) -> str:
    """The end of a message about an unknown name: `; did you mean 'tripod'?`, empty where none is near."""
    near = nearest_name(text, names)
    return "" if near is None else f"; did you mean {near!r}?"


def nearest_name(text: str, names: Iterable[str]) -> str | None:
    """The one of some names that is written most like a text; None where none is near."""
    by_plain: Mapping[str, str] = {_plain(name): name for name in names}
    from difflib import get_close_matches  # loaded for a message only

    near = get_close_matches(_plain(text)[:100], by_plain, n=1, cutoff=_NEAR)
    return by_plain[near[0]] if near else None


def _plain(text: str) -> str:
    """A name without what people write differently."""
    plain = re.sub(r"[\s_-]+", "-", text.strip().casefold())
    for american, british in _BRITISH.items():
        plain = plain.replace(american, british)
    return plain
