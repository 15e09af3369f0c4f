"""Damage that a command leaves out: named on stderr, with a separate exit code."""

from typing import TYPE_CHECKING

from hexctl.cli.console import DONE, FAULT, print_message

if TYPE_CHECKING:
    from hexctl.errors import HexctlError


class LeftOut:
    """Names the damaged parts that a command leaves out, and counts them; the command continues."""

    def __init__(self) -> None:
        self.count = 0

    def name(self, error: "HexctlError") -> None:
        """Print an error; this is an `on_damage`."""
        print_message(error)
        self.count += 1

    def code(self, code: int = DONE) -> int:
        """Exit code of a command that would end with `code` if nothing had been left out."""
        return FAULT if self.count and code == DONE else code
