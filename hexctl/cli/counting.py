"""Counts in words, for people."""

from collections.abc import Mapping


def in_words(counts: Mapping[str, int]) -> str:
    """Return the counts above zero: `2 late, 1 stale owner`."""
    return ", ".join(f"{n} {name.replace('_', ' ')}" for name, n in counts.items() if n)


def link_in_words(counts: Mapping[str, int] | None) -> str:
    """Return what became of the messages to and from a servo board; empty where there is none."""
    if not counts:
        return ""
    troubles = in_words({name: n for name, n in counts.items() if name != "received"})
    return f"{counts.get('received', 0)} messages came; {troubles or 'none lost'}"
