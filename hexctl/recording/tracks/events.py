"""Events of a recording: phases, failures, detections and reactions, clipped targets, the outcome."""

from collections.abc import Iterator

import numpy as np

from hexctl.control.trace import PHASES
from hexctl.control.trial_result import TrialResult
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.tracks.block import Block
from hexctl.recording.tracks.failures import failure_lines
from hexctl.recording.tracks.gait_tracks import clipped_joints, skipped_ticks
from hexctl.types import JOINT_NAMES

#: A row of the block, Rerun's level, and the text.
Event = tuple[int, str, str]

INFO, WARNING, ERROR = "INFO", "WARN", "ERROR"

#: Statuses of trials that ended early, and the reason of a requested stop, which is not a fault.
STOPS = ("fell", "diverged", "aborted")
REQUESTED = "requested"

#: More joints than this are counted, not named.
MAX_NAMES = 3


def send_events(block: Block) -> None:
    """Send the events in the rows of a block."""
    parts = (_phases(block), _failures(block), _notes(block), _clipped(block), _skipped(block))
    events = sorted((event for part in parts for event in part), key=lambda event: event[0])
    if events:
        rows, levels, texts = zip(*events, strict=True)
        columns = load_rerun().TextLog.columns(text=list(texts), level=list(levels))
        block.send_at(paths.EVENTS, [block.start + row for row in rows], columns)


def _phases(block: Block) -> Iterator[Event]:
    for row in block.changes(block.led("phase")).tolist():
        yield row, INFO, f"{PHASES[block.column('phase')[row]]} begins"


def _failures(block: Block) -> Iterator[Event]:
    """Legs that the world let fail or heal, in the tick before the first that shows it."""
    for row, text in failure_lines(block):
        yield row - block.start, WARNING, text


def _notes(block: Block) -> Iterator[Event]:
    for row, text in block.log.notes:
        if block.start <= row < block.stop:
            yield row - block.start, WARNING, text


def _clipped(block: Block) -> Iterator[Event]:
    led = clipped_joints(block.led("requested_rad"), block.led("commanded_rad"))
    own = block.without_lead(led)
    for row in block.changes(led.any(axis=-1)).tolist():
        names = [name for name, clipped in zip(JOINT_NAMES, own[row], strict=True) if clipped]
        if names:
            more = f" and {len(names) - MAX_NAMES} more" if len(names) > MAX_NAMES else ""
            yield row, WARNING, f"clipped: {', '.join(names[:MAX_NAMES])}{more}"


def _skipped(block: Block) -> Iterator[Event]:
    own = block.without_lead(skipped_ticks(block.led("time_s")))
    for row in np.flatnonzero(own).tolist():
        missed = int(own[row])
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
