"""The file of an overview: written aside and put in place whole."""

import uuid
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, RecordingError
from hexctl.record.files import check_whole, create_file
from hexctl.record.overview import paths
from hexctl.record.overview.above import send_above
from hexctl.record.overview.curve import send_curve
from hexctl.record.overview.layout import make_layout
from hexctl.record.overview.table import make_table
from hexctl.record.overview.trials import Overview
from hexctl.record.sdk import flush, load_rerun

#: Another than that of trials: a viewer has one layout for each.
APPLICATION_ID = "hexctl session"


def write_overview_file(path: Path, overview: Overview) -> None:
    """Write an overview, in place of an earlier one: a reader sees the old file or the new one, never a part.

    Raises InputError for an overview without trials or a place that cannot be written, RecordingError when
    the disk did not take everything, and MissingExtraError without Rerun.
    """
    if not overview.trials:
        raise InputError(f"overview: {overview.title} has no trials; allowed: one or more")
    load_rerun()
    # Not an .rrd until it is whole: nobody shall take it for a recording.
    aside = path.with_name(f".{path.stem}-{uuid.uuid4().hex[:8]}.part")
    create_file(aside)
    try:
        _write(aside, path, overview)
        _put_in_place(aside, path)
    finally:
        aside.unlink(missing_ok=True)


def _write(aside: Path, path: Path, overview: Overview) -> None:
    stream = load_rerun().RecordingStream(APPLICATION_ID, recording_id=str(uuid.uuid4()))
    stream.save(str(aside), default_blueprint=make_layout(overview))
    try:
        _send(stream, overview)
        flush(stream, path)
    finally:
        stream.disconnect()
    check_whole(aside)


def _put_in_place(aside: Path, path: Path) -> None:
    try:
        aside.replace(path)
    except OSError as error:
        raise RecordingError(f"{path}: the overview cannot be written: {error.strerror}") from error


def _send(stream: Any, overview: Overview) -> None:
    rr = load_rerun()
    stream.send_recording_name(overview.title)
    send_above(stream, overview)
    send_curve(stream, overview)
    document = rr.TextDocument(make_table(overview), media_type="text/markdown")
    stream.log(paths.TABLE, document, static=True)
