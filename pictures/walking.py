"""A recorded walk with leg 5 failed, as it opens in the viewer."""

from pathlib import Path

from hexctl.cli.main import exit_code
from pictures.opened import BAR, SIZE, opened
from pictures.picture import Picture

#: Gait of the walk, one of the 120, and the time of the picture: well into the walk.
GAIT, AT_S = "57", 17.3


def draw(folder: Path) -> Picture:
    """Walk, record it into an empty folder, and return what the viewer shows."""
    path = folder / "walk.rrd"
    code = exit_code(["run", "--json", "--failed-leg", "5", "--gait", GAIT, "--record", str(path)])
    if code != 0:
        raise RuntimeError(f"hexctl run ended with {code}")
    with opened(path) as window:
        window.show_time(AT_S)
        return window.picture().cut(0, BAR, SIZE[0], SIZE[1] - BAR)
