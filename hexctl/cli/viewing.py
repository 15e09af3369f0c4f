"""What `hexctl view` does: find the files of recordings and sessions, and open them together."""

import time
from collections.abc import Sequence
from pathlib import Path

from hexctl.adapt.overview import FILE_NAME, write_overview
from hexctl.adapt.session import Session
from hexctl.adapt.store import SessionStore, stored_names
from hexctl.cli.exits import DONE
from hexctl.cli.interrupt import StopOnInterrupt
from hexctl.cli.output import say_aside
from hexctl.cli.places import RUNS
from hexctl.errors import HexctlError, InputError
from hexctl.record.viewer import newest_recording, open_viewer
from hexctl.record.webviewer import serve_web


def open_all(names: Sequence[str], *, web: bool = False) -> int:
    """Open recordings and sessions, or the newest one, and return the viewer's exit code.

    The overview of the first session is shown first, though not in a browser. Raises InputError for a name
    that is neither.
    """
    files = [file for name in names or [_newest()] for file in _files(name)]
    overviews = [file for file in files if file.name == FILE_NAME]
    if web:
        return _serve(files)
    return open_viewer(files, front=overviews[0] if overviews else None)


def _serve(files: Sequence[Path]) -> int:
    """Serve recordings to browsers on this computer until interrupted."""
    with StopOnInterrupt() as interrupt, serve_web(files) as served:
        say_aside(f"open {served.url} in a browser; Ctrl-C ends it")
        while not interrupt.requested():
            served.check()
            time.sleep(0.1)
    return DONE


def _newest() -> str:
    """Return the recording that was written last, or the session that it belongs to."""
    # An overview is written anew whenever its session is viewed.
    path = newest_recording(RUNS, leave_out=FILE_NAME)
    session = path.parent.name
    if session not in stored_names(RUNS):
        return str(path)
    with SessionStore(RUNS) as store:
        return session if store.load(session).trials else str(path)


def _files(name: str) -> list[Path]:
    """Return the recording of that path, or a session's overview and the recordings of its trials."""
    path = Path(name)
    if path.suffix == ".rrd" or path.is_file():
        return [path]
    # A folder as the shell completes it: runs/SESSION/
    session = path.name if path.parent == RUNS else name
    if session not in stored_names(RUNS):
        known = ", ".join(stored_names(RUNS)[-5:]) or "none yet, hexctl adapt makes one"
        raise InputError(f"view: got {name!r}; allowed: an .rrd file or a session (newest last): {known}")
    return _session_files(session)


def _session_files(name: str) -> list[Path]:
    with SessionStore(RUNS) as store:
        session, folder = store.load(name), store.folder_of(name)
    if not session.trials:
        raise InputError(f"session {name}: has no trial yet; hexctl adapt --resume {name} goes on with it")
    trials = (folder / Path(trial.recording).name for trial in session.trials if trial.recording)
    return [_overview(session, folder), *(path for path in trials if path.is_file())]


def _overview(session: Session, folder: Path) -> Path:
    """Return the overview as of now: a session that was cut off, or still runs, left an old one or none."""
    try:
        return write_overview(session, folder)
    except (HexctlError, OSError):
        if (folder / FILE_NAME).is_file():
            return folder / FILE_NAME
        raise
