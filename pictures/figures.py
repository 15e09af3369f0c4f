"""The pictures themselves: a walk and a session in the viewer, and the study's convergence."""

import os
from pathlib import Path

from hexctl.adapt.overview import write_overview
from hexctl.adapt.sessions.store import SessionStore
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


#: The paper's differential evolution, which tries on where the default would be sure after a few trials.
SEARCH = ("--failed-leg", "5", "--budget", "20", "--optimizer", "derand")


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
    with SessionStore(folder / "runs") as store:
        (name,) = store.names()
        overview = write_overview(store.load(name), store.folder_of(name))
    with opened(overview) as window:
        return window.picture().cut(0, BAR, SIZE[0], SIZE[1] - BAR)


FIGURE = "convergence_paper_count.png"


def draw_convergence(folder: Path) -> Picture:
    """Repeat the paper's study, or what is missing of it, and return its figure."""
    out = folder / "study"
    code = exit_code(["study", "--json", "--out", str(out)])
    if code != 0:
        raise RuntimeError(f"hexctl study ended with {code}; repeat the command to resume")
    return Picture.from_png((out / FIGURE).read_bytes())
