"""What `hexctl view` does: find the files of recordings and sessions, and open them together."""

import time
from collections.abc import Sequence
from pathlib import Path
from tempfile import TemporaryDirectory

from hexctl.adapt.overview import FILE_NAME, recordings_of, write_overview
from hexctl.adapt.session import Session
from hexctl.adapt.store import SessionStore, stored_names
from hexctl.cli.console import DONE, RUNS, StopOnInterrupt, print_note
from hexctl.errors import HexctlError, InputError
from hexctl.record.viewer import FileServer, free_port, newest_recording, open_viewer, serve_web, web_origin

#: A session, and the folder of its trials' recordings.
FoundSession = tuple[Session, Path]


def open_all(names: Sequence[str], *, web: bool = False) -> int:
    """Open recordings and sessions, or the newest one, and return the viewer's exit code.

    A session opens as its overview, from which its trials are opened. Raises InputError for a name that is
    neither.
    """
    chosen = [_chosen(name) for name in names or [_newest()]]
    if web:
        return _serve(chosen)
    return open_viewer([one if isinstance(one, Path) else _overview(*one) for one in chosen])


def _serve(chosen: Sequence[Path | FoundSession]) -> int:
    """Serve recordings and sessions to browsers on this computer until interrupted."""
    port = free_port()
    with (
        StopOnInterrupt() as interrupt,
        FileServer(web_origin(port)) as files,
        TemporaryDirectory() as aside,
    ):
        urls = []
        for number, one in enumerate(chosen):
            if isinstance(one, Path):
                urls.append(files.add(str(number), one))
            else:
                session, folder = one
                for recording in recordings_of(session, folder).values():
                    files.add(session.name, recording)
                into = Path(aside, str(number))
                overview = write_overview(session, folder, into=into, base=files.base(session.name))
                urls.append(files.add(session.name, overview))
        with serve_web(port, urls) as served:
            print_note(f"open {served.url} in a browser; Ctrl-C ends it")
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


def _chosen(name: str) -> Path | FoundSession:
    """Return the recording of that path, or a session and the folder of its recordings."""
    path = Path(name)
    if path.suffix == ".rrd" or path.is_file():
        return path
    # A folder as the shell completes it: runs/SESSION/
    session = path.name if path.parent == RUNS else name
    if session not in stored_names(RUNS):
        known = ", ".join(stored_names(RUNS)[-5:]) or "none yet, hexctl adapt makes one"
        raise InputError(f"view: got {name!r}; allowed: an .rrd file or a session (newest last): {known}")
    with SessionStore(RUNS) as store:
        loaded, folder = store.load(session), store.folder_of(session)
    if not loaded.trials:
        raise InputError(
            f"session {session}: has no trial yet; hexctl adapt --resume {session} goes on with it"
        )
    return loaded, folder


def _overview(session: Session, folder: Path) -> Path:
    """Return the overview as of now: a session that was cut off, or still runs, left an old one or none."""
    try:
        return write_overview(session, folder)
    except (HexctlError, OSError):
        if (folder / FILE_NAME).is_file():
            return folder / FILE_NAME
        raise
