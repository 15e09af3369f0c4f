"""Legs as a person types them."""

from hexctl.options import listed


def leg_numbers(text: str) -> tuple[int, ...]:
    """Legs of a text such as `2,5`, ascending; raises ValueError for anything but numbers."""
    try:
        return tuple(sorted(int(part) for part in listed(text)))
    except ValueError:
        raise ValueError(f"got {text!r}; allowed: numbers 1..6 with commas, such as 2,5") from None
