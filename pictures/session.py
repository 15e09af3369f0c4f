"""A session of twenty trials, as it opens in the viewer."""

import os
from pathlib import Path

from hexctl.adapt.overview import write_overview
from hexctl.adapt.store import SessionStore
from hexctl.cli.main import exit_code
from pictures.opened import BAR, SIZE, opened
from pictures.picture import Picture

#: The paper's differential evolution, which tries on where the default would be sure after a few trials.
SEARCH = ("--failed-leg", "5", "--budget", "20", "--optimizer", "derand")


def draw(folder: Path) -> Picture:
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
