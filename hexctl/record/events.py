"""What happened when, in words: parts of the trial, targets that were clipped, ticks that were missed."""

from collections.abc import Iterator

import numpy as np

from hexctl.control.log import PHASES
from hexctl.control.result import TrialResult
from hexctl.record import paths, style
from hexctl.record.block import Block
from hexctl.record.lanes import clipped_joints, skipped_ticks
from hexctl.record.sdk import load_rerun
from hexctl.types import JOINT_NAMES

#: A row of the block, how grave it is in Rerun's words, and what it was.
Event = tuple[int, str, str]

INFO, WARNING, ERROR = "INFO", "WARN", "ERROR"

#: How a trial ends before its time, and why when nothing is wrong: somebody asked for it.
STOPS = ("fell", "diverged", "aborted")
REQUESTED = "requested"

#: More joints than this are counted, not named.
MAX_NAMES = 3


def send_events(block: Block) -> None:
    """Send what happened in the rows of a block."""
    events = sorted([*_phases(block), *_clipped(block), *_skipped(block)])
    if events:
        rows, levels, texts = zip(*events, strict=True)
        columns = load_rerun().TextLog.columns(text=list(texts), level=list(levels))
        block.send(paths.EVENTS, np.array(rows), columns)


def _phases(block: Block) -> Iterator[Event]:
    for row in block.changes(block.led("phase")).tolist():
        yield row, INFO, f"{PHASES[block.column('phase')[row]]} begins"


def _clipped(block: Block) -> Iterator[Event]:
    """Yield where the guard began to change targets, with the joints it changed first."""
    led = clipped_joints(block.led("wanted_rad"), block.led("sent_rad"))
    lead = len(led) - (block.stop - block.start)
    for row in block.changes(led.any(axis=-1)).tolist():
        names = [name for name, clipped in zip(JOINT_NAMES, led[row + lead], strict=True) if clipped]
        if names:
            more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
            yield row, WARNING, f"clipped: {', '.join(names[:MAX_NAMES])}{more}"


def _skipped(block: Block) -> Iterator[Event]:
    """Yield where the clock missed ticks because one took too long."""
    led = skipped_ticks(block.led("time_s"))
    lead = len(led) - (block.stop - block.start)
    for row in np.flatnonzero(led[lead:]).tolist():
        missed = int(led[row + lead])
        ticks = "1 tick" if missed == 1 else f"{missed} ticks"
        yield row, WARNING, f"missed {ticks}: the one before took too long"


def send_outcome(last: Block, result: TrialResult) -> None:
    """Send how the trial ended, at the last tick of its last block; the guard's lane shows a stop too."""
    rr, row = load_rerun(), np.array([last.stop - last.start - 1])
    why = f": {result.stopped}" if result.stopped else ""
    stopped = result.status in STOPS and result.stopped != REQUESTED
    level = ERROR if stopped else WARNING if result.status == "no_progress" else INFO
    columns = rr.TextLog.columns(text=[f"trial over, {result.status}{why}"], level=[level])
    last.send(paths.EVENTS, row, columns)
    if stopped:
        last.send(paths.GUARD, row, rr.StateChange.columns(state=[style.STOPPED]))
