"""Texts of stop reasons, and of fault counters."""

from collections.abc import Mapping

from hexctl.backends.clock import Standstill
from hexctl.wire.links import CLEAR_COMMAND
from hexctl.wire.zenoh_messages import SERVER_ENDED

#: Where to look after a stop that the user did not request, by the reason up to a colon; {} clears it.
HINTS = {
    "state": "its state came late or repeated itself as the legs moved: check link, server and servo bus",
    "expired": "commands did not reach the robot in time; a busy computer, or a bad link",
    "pose lost": "the robot no longer reports its position, or repeats it",
    "arena": "the walk was ended before it left the circle of --arena",
    "no position": "--arena needs a robot with a known position, and its sensor may hang",
    "estop": "{} when it may move again",
    "fault": "remove the cause, then {}",
    f"fault: {SERVER_ENDED}": "start it again",
}


def why_in_words(
    stopped: str | None, standstill_s: float | None = None, *, clear: str | None = CLEAR_COMMAND
) -> str:
    """Reason of a stop and where to look, as an appendix; empty for None.

    `clear` is None if no `hexctl serve` keeps the stop.
    """
    if stopped is None:
        return ""
    if standstill_s is not None:
        return f" ({stopped}): {Standstill(standstill_s)}"
    hint = _hint(stopped)
    if clear is None:
        hint = hint.partition("{}")[0].removesuffix(", then ")
    return f" ({stopped}): {hint.format(clear)}" if hint else f" ({stopped})"


def clearing_in_words(stopped: str | None, *, clear: str | None) -> str:
    """Text of the command `clear`; empty if nothing has to be cleared."""
    hint = "" if stopped is None else _hint(stopped)
    return hint.format(clear) if clear is not None and "{}" in hint else ""


def _hint(stopped: str) -> str:
    return HINTS.get(stopped, HINTS.get(stopped.partition(":")[0], ""))


def in_words(counts: Mapping[str, int]) -> str:
    """Counts above zero: `2 late, 1 stale owner, 3 leases refused`."""
    return ", ".join(counted(n, name.replace("_", " ")) for name, n in counts.items() if n)


def counted(number: int, name: str) -> str:
    """A number with its plural name, such as `leases refused`: of one, `1 lease refused`."""
    thing, space, rest = name.partition(" ")
    one = number == 1 and thing.endswith("s") and not thing.endswith("ss")
    return f"{number} {thing[:-1] if one else thing}{space}{rest}"


def link_in_words(counts: Mapping[str, int] | None) -> str:
    """Messages to and from a servo board, received and lost; empty without a board."""
    if not counts:
        return ""
    troubles = in_words({name: n for name, n in counts.items() if name != "received"})
    if "received" not in counts:  # a bus counts its requests
        return troubles or "nothing yet"
    return f"{counted(counts['received'], 'messages')} came; {troubles or 'none lost'}"
