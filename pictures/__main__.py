"""Make pictures of the documentation: `python -m pictures [NAME]...`, all of them without a name."""

import contextlib
import io
import os
import runpy
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path

os.environ.setdefault("MUJOCO_GL", "disable")

from pictures import camera_map, failure_strip, figures, pages, play, reality, rescue, step_response
from pictures.needed import MissingProgramError
from pictures.picture import Picture

DOCS = Path(__file__).parents[1] / "docs"


def _prior(folder: Path) -> Path:
    """The figure of a prior, drawn by the script that explains its numbers."""
    path = folder / "prior.svg"
    runpy.run_path(str(DOCS / "make_prior_figure.py"))["main"](path)
    return path


#: Each picture by the name of its file; what it draws goes into an empty folder. A path is a file.
PICTURES: dict[str, Callable[[Path], Picture | Path]] = {
    "rescue": rescue.draw_rescue,
    "walking": figures.draw_walking,
    "play": play.draw_play,
    "session": figures.draw_session,
    "prior": _prior,
    "step_response": step_response.draw_step_response,
    "failure": failure_strip.draw_failure_strip,
    "servo_terms": reality.draw_servo_terms,
    "real_walks": reality.draw_real_walks,
    "camera_map": camera_map.draw_camera_map,
    "drive_phone": pages.draw_drive_phone,
    "calibration": pages.draw_calibration,
}


def main(names: Sequence[str]) -> int:
    """Make the pictures of some names and return the exit code."""
    unknown = [name for name in names if name not in PICTURES]
    if unknown:
        sys.stderr.write(f"pictures: got {', '.join(unknown)}; allowed: {', '.join(PICTURES)}\n")
        return 2
    for name in names or PICTURES:
        sys.stderr.write(f"{name} …\n")
        try:
            with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
                _save(PICTURES[name](Path(folder)), DOCS / "images" / name)
        except MissingProgramError as error:
            sys.stderr.write(f"pictures: {error}\n")
            return 1
    return 0


def _save(drawn: Picture | Path, path: Path) -> None:
    """Write a picture as PNG, or copy a file, beside the others."""
    if isinstance(drawn, Path):
        shutil.copyfile(drawn, path.with_suffix(drawn.suffix))
    else:
        drawn.save(path.with_suffix(".png"))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
