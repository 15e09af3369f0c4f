"""Recordings of a session that are left out: named on stderr, and an exit code of their own."""

from typing import TYPE_CHECKING

from hexctl.cli.console import DONE, FAULT, print_note

if TYPE_CHECKING:
    from hexctl.errors import HexctlError


class LeftOut:
    """Names each recording that a command leaves out, as it is found; the command does all the rest.

    Attributes:
        count: of those that were named.
    """

    def __init__(self) -> None:
        self.count = 0

    def name(self, error: "HexctlError") -> None:
        """Print what is wrong with a recording; this is an `on_damage`."""
        print_note(f"hexctl: {error}")
        self.count += 1

    def code(self, code: int = DONE) -> int:
        """Exit code of a command that would end with `code` if nothing had been left out."""
        return FAULT if self.count and code == DONE else code
