"""Exit codes of every command."""

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from hexctl.control.result import TrialResult

DONE = 0
BAD_INPUT = 2
FAULT = 3
ABORTED = 4
INTERRUPTED = 130

#: Stops that are the robot's or the link's fault rather than somebody's wish or a fall; `fault` may say more
#: after a colon.
FAULTS = ("fault", "state", "pose lost", "expired")


def code_of(result: "TrialResult") -> int:
    """Return the exit code of a trial that nobody interrupted."""
    if result.status == "diverged" or (result.stopped or "").partition(":")[0] in FAULTS:
        return FAULT
    return ABORTED if result.status in ("fell", "aborted") else DONE
