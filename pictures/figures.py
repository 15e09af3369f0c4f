"""A walk and a session in the viewer."""

import os
from pathlib import Path

from hexctl.adapt.sessions.session_viewing import write_overview
from hexctl.adapt.sessions.store import list_sessions
from hexctl.cli.main import exit_code
from pictures.picture import Picture
from pictures.window import BAR, SIZE, opened

#: Gait of the walk, one of the 120, and the time of the picture: well into the walk.
GAIT, AT_S = "57", 17.3


def draw_walking(folder: Path) -> Picture:
    """Walk, record it into an empty folder, and return what the viewer shows."""
    path = folder / "walk.rrd"
    code = exit_code(["run", "--json", "--failed-leg", "5", "--gait", GAIT, "--record", str(path)])
    if code != 0:
        raise RuntimeError(f"hexctl run ended with {code}")
    with opened(path) as window:
        window.show_time(AT_S)
        return window.picture().cut(0, BAR, SIZE[0], SIZE[1] - BAR)


#: A world that no prior was built with, in which the search needs a few trials, and the trial of the picture.
SEARCH = ("--failed-leg", "5", "--budget", "20", "--world", "randomised:7")
SHOWN_TRIAL = 2


def draw_session(folder: Path) -> Picture:
    """Adapt in an empty folder, and return what the viewer shows."""
    before = Path.cwd()
    os.chdir(folder)
    try:
        code = exit_code(["adapt", "--json", *SEARCH])
    finally:
        os.chdir(before)
    if code != 0:
        raise RuntimeError(f"hexctl adapt ended with {code}")
    (session,) = list_sessions(folder / "runs")
    overview = write_overview(session, folder / "runs" / session.name)
    with opened(overview) as window:
        window.show_trial(SHOWN_TRIAL)
        return window.picture().cut(0, BAR, SIZE[0], SIZE[1] - BAR)
