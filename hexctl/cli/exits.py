"""Exit codes of every command."""

DONE = 0
BAD_INPUT = 2
FAULT = 3
ABORTED = 4
INTERRUPTED = 130

#: Exit code of a run by the status of its trial; a run that was interrupted by hand is INTERRUPTED.
BY_STATUS = {"ok": DONE, "no_progress": DONE, "fell": ABORTED, "aborted": ABORTED, "diverged": FAULT}
