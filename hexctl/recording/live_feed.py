"""The process between a walk and its live viewer: `python -m hexctl.recording.live_feed PORT` reads rows."""

import pickle
import signal
import socket
import sys
import uuid
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any, BinaryIO

from hexctl.control.log import TickLog
from hexctl.errors import InputError
from hexctl.recording.blueprint import make_blueprint
from hexctl.recording.recording import APPLICATION_ID
from hexctl.recording.rrd import Layout, free_streams, load_rerun
from hexctl.recording.scene import LEVEL, Subject, send_scene
from hexctl.recording.tracks.block import Block
from hexctl.recording.tracks.parts import send_parts
from hexctl.recording.viewer import LOCAL
from hexctl.robot.loader import load_meshes
from hexctl.robot.meshes import Meshes
from hexctl.waiting import comes_true

#: Time in which a viewer has to open its window.
VIEWER_TIMEOUT_S = 30.0


class Feed:
    """Shows one walk in a viewer."""

    def __init__(self, address: str, header: dict[str, Any]) -> None:
        rr = load_rerun()
        robot, plan, floor = header["robot"], header["plan"], header["floor"] or LEVEL
        meshes = _meshes(header["looks"])
        self._subject = Subject(robot, plan, floor, meshes)
        self._log = TickLog()
        self._stream: Any = rr.RecordingStream(APPLICATION_ID, recording_id=str(uuid.uuid4()))
        shown = {name: header[name] for name in ("watched", "servos")}
        blueprint = make_blueprint(robot, plan.heading_rad, floor, live=True, **shown)
        with Layout(blueprint) as layout:
            self._stream.connect_grpc(address, default_blueprint=layout)
        self._stream.send_recording_name(header["title"])
        send_scene(self._stream, self._subject, servos=header["servos"])
        self._began_at_s: float | None = None

    def show(self, block: dict[str, Any]) -> None:
        """Show the rows of a block."""
        log, start = self._log, len(self._log)
        append(log, block)
        if self._began_at_s is None:
            times_s = log["time_s"]
            self._began_at_s = block["at_s"] - float(times_s[-1] - times_s[0])
        for _ in send_parts(Block(self._stream, self._subject, log, start, len(log), self._began_at_s)):
            pass

    def close(self) -> None:
        """Send the remaining rows to the viewer."""
        self._stream.disconnect()
        free_streams()


def append(log: TickLog, block: dict[str, Any]) -> None:
    """Append the rows of a block and their events, as made by `rows_of` of a log that may be longer."""
    log.frame = block["frame"]
    shift = len(log) - block["start"]
    for row, servos in block["servo_rows"]:
        log.servo_rows.append(row + shift, servos)
    log.notes += [(row + shift, text) for row, text in block["notes"]]
    log.leg_changes += [replace(change, row=change.row + shift) for change in block["leg_changes"]]
    log.extend(block["rows"])


def _meshes(looks: str | None) -> Meshes:
    """Meshes of a robot file; none if they can no longer be loaded."""
    try:
        return load_meshes(looks) if looks is not None else {}
    except InputError:
        return {}


def _listens(port: int) -> bool:
    try:
        socket.create_connection((LOCAL, port), timeout=1.0).close()
    except OSError:
        return False
    return True


def main(port: str) -> None:
    """Show the messages on stdin until it ends."""
    # Ctrl-C is for the walk; this process ends when the walk closes the pipe.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    # Earlier data would be lost.
    if not comes_true(lambda: _listens(int(port)), VIEWER_TIMEOUT_S, poll_s=0.1):
        sys.exit(1)
    address = f"rerun+http://{LOCAL}:{port}/proxy"
    feed: Feed | None = None
    for message in messages(sys.stdin.buffer):
        if "robot" in message:
            if feed is not None:
                feed.close()
            feed = Feed(address, message)
        elif feed is not None:
            feed.show(message)
    if feed is not None:
        feed.close()


def messages(source: BinaryIO) -> Iterator[dict[str, Any]]:
    """Messages of `LiveView`, until the stream ends or is cut off."""
    with suppress(EOFError, pickle.UnpicklingError):
        while True:
            yield pickle.load(source)  # noqa: S301  from our own parent process


if __name__ == "__main__":
    main(*sys.argv[1:])
