"""The study's figure of convergence: five minutes of two cores, kept under runs/study-cache."""

from pathlib import Path

from hexctl.cli.main import exit_code
from pictures.picture import Picture

FIGURE = "convergence_paper_count.png"


def draw(folder: Path) -> Picture:
    """Repeat the paper's study, or what is missing of it, and return its figure."""
    out = folder / "study"
    code = exit_code(["study", "--json", "--out", str(out)])
    if code != 0:
        raise RuntimeError(f"hexctl study ended with {code}; repeat the command to resume")
    return Picture.from_png((out / FIGURE).read_bytes())
