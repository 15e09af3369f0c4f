"""One recording: a trial as a Rerun file with its layout."""

import time
import uuid
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, suppress
from pathlib import Path
from typing import Any, Self

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.terrain import Floor
from hexctl.control.log import TickLog
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.recording import paths
from hexctl.recording.blueprint import make_blueprint
from hexctl.recording.rrd import (
    check_name,
    create_file,
    disconnect,
    flush,
    load_rerun,
    save_stream,
    still_there,
)
from hexctl.recording.rrd_reader import check_end
from hexctl.recording.scene import LEVEL, Subject, send_scene
from hexctl.recording.tracks.balance import Tally
from hexctl.recording.tracks.block import Block
from hexctl.recording.tracks.events import send_outcome
from hexctl.recording.tracks.parts import send_parts
from hexctl.recording.trial_summary import make_markdown, make_properties
from hexctl.robot.formats.json_model import robot_to_json
from hexctl.robot.meshes import Meshes
from hexctl.robot.model import Robot

APPLICATION_ID = "hexctl"

#: Number of rows per write: chunks cost time and space. A walk up to twice as fast as real time also writes
#: after this much time, which bounds the loss in a crash.
BLOCK_TICKS = 2000
BLOCK_S = 2.0
MOST_PACE = 2.0

#: Longer walks have no index: Rerun keeps it in memory until the end, and it grows by 150 kB a second.
#: `rerun rrd optimize` adds one.
INDEXED_S = 120.0


class Recording:
    """Writes a trial to an .rrd file; a recorder of `run_trial` and a context manager."""

    block_ticks: int | None = None

    def __init__(
        self,
        path: Path,
        robot: Robot,
        plan: TrialPlan,
        *,
        title: str,
        floor: Floor | None = None,
        meshes: Meshes | None = None,
        watched: bool = False,
        servos: bool = False,
        on_stand: bool = False,
    ) -> None:
        """Create the file with scene and layout.

        Args:
            path: the new file; missing folders are made.
            title: heading of the text panel and name of the recording.
            floor: None is an even, level floor.
            meshes: of the robot's parts; None draws solids of its geometry.
            watched: whether the walk monitors its legs; adds the evidence to the layout.
            servos: whether the servos may report temperatures and voltages; adds them to the layout.
            on_stand: whether a stand holds the trunk, and no foot touches anything.

        Raises InputError for a file that exists or cannot be created, RecordingError if its beginning cannot
        be written, MissingExtraError without Rerun. A file without its beginning is deleted.
        """
        rr = load_rerun()
        self.path = path
        self._subject = Subject(robot, plan, floor or LEVEL, meshes or {})
        self._title = title
        self._log: TickLog | None = None
        self._due = 0
        self._created_at_s, self._began_at_s = time.time(), 0.0
        self._tally = Tally()
        self._last: Block | None = None
        self._parts: Iterator[None] | None = None
        self._written, self._written_at_s = 0, time.monotonic()
        self._indexed = plan.duration_s <= INDEXED_S
        self._stream: Any = None
        check_name(path)
        create_file(path)
        with ExitStack() as undo:  # at Ctrl-C, too
            undo.callback(self.discard)
            self._stream = rr.RecordingStream(APPLICATION_ID, recording_id=str(uuid.uuid4()))
            floor = self._subject.floor
            blueprint = make_blueprint(robot, plan.heading_rad, floor, watched=watched, servos=servos)
            save_stream(self._stream, path, blueprint, index=self._indexed)
            self._stream.send_recording_name(title)
            # It allows an export without the robot's file.
            values = rr.AnyValues(name=robot.name, model=robot_to_json(robot), on_stand=on_stand)
            self._stream.send_property("robot", values)
            send_scene(self._stream, self._subject, servos=servos)
            self._send_summary(None, {})
            flush(self._stream, path)  # a truncated file has its robot and scene all the same
            undo.pop_all()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        """Close the file; one without a tick is deleted."""
        if self._due:
            self.close()
        else:
            self.discard()

    def write_block(self, log: TickLog, start: int, stop: int) -> None:
        """Add the next rows [start, stop) of a log; due rows are written one part per call."""
        if start == 0:
            self._began_at_s = self._beginning_s(log, stop)
        self._log, self._due = log, stop
        if self._parts is not None:
            self._write_part()
        elif self._is_due(stop - self._written):
            self._begin_to_write()

    def _is_due(self, rows: int) -> bool:
        passed_s = time.monotonic() - self._written_at_s
        return rows >= BLOCK_TICKS or passed_s >= max(BLOCK_S, rows * PERIOD_S / MOST_PACE)

    def finish(self, result: TrialResult, facts: Mapping[str, Any]) -> None:
        """Add the outcome, as text and properties, and close. Raises RecordingError if it is incomplete."""
        rr = load_rerun()
        self._write_all()
        flush(self._stream, self.path)
        with still_there(self.path):
            written = self.path.stat().st_size
        self._send_summary(result, facts)
        properties = make_properties(self._title, self._subject, result, self._tally.share, facts)
        self._stream.send_property("trial", rr.AnyValues(**properties))
        if self._last is not None:
            send_outcome(self._last, result)
        flush(self._stream, self.path)
        self.close()
        check_end(self.path, written, index=self._indexed)

    def close(self) -> None:
        """Close the file; a second call does nothing."""
        if self._stream is not None:
            self._write_all()
            stream, self._stream = self._stream, None
            disconnect(stream)

    def discard(self) -> None:
        """Delete the file, then close it: closing takes time, and Ctrl-C may interrupt it."""
        with suppress(OSError):
            self.path.unlink()
        self.close()

    def _send_summary(self, result: TrialResult | None, facts: Mapping[str, Any]) -> None:
        text = make_markdown(self._title, self._subject, result, self._tally.share, facts)
        document = load_rerun().TextDocument(text, media_type="text/markdown")
        self._stream.log(paths.SUMMARY, document, static=True)

    def _write_all(self) -> None:
        self._write_parts()
        self._begin_to_write()
        self._write_parts()

    def _write_parts(self) -> None:
        while self._parts is not None:
            self._write_part()

    def _begin_to_write(self) -> None:
        start, self._written, self._written_at_s = self._written, self._due, time.monotonic()
        if self._log is not None and self._stream is not None and self._due > start:
            block = Block(self._stream, self._subject, self._log, start, self._due, self._began_at_s)
            self._parts = self._send(block)

    def _send(self, block: Block) -> Iterator[None]:
        self._tally += yield from send_parts(block)
        self._last = block

    def _write_part(self) -> None:
        parts, due = self._parts, self._due
        # After rows that cannot be sent, skip the rest: the file can still be closed.
        self._parts, self._due = None, self._written
        for _ in parts or ():
            self._parts = parts
            break
        self._due = due

    def _beginning_s(self, log: TickLog, stop: int) -> float:
        """A simulation's first block spans more simulated time than real time."""
        times_s = log.rows("time_s", 0, stop)
        return max(self._created_at_s, time.time() - float(times_s[-1] - times_s[0]))
