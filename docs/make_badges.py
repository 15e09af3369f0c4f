"""Draw the badges of the README: `python docs/make_badges.py [FOLDER]`, from what pyproject.toml says."""

import sys
import tomllib
from pathlib import Path
from xml.sax.saxutils import escape

ROOT = Path(__file__).resolve().parents[1]

LEFT_COLOR, RIGHT_COLOR, TEXT_COLOR = "#404550", "#1f7a6d", "#ffffff"

#: Height of a badge, size of its letters, and what a letter takes on the mean, in pixels.
HEIGHT_PX, LETTER_PX, ADVANCE_PX, MARGIN_PX = 20, 11, 6.6, 7

PAPER = "2209.00486"


def badges() -> dict[str, tuple[str, str]]:
    """What stands on the left and on the right of each badge, by the name of its file."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    python = [line.rpartition(" ")[2] for line in project["classifiers"] if ":: Python :: 3." in line]
    return {
        "badge-version": ("hexctl", project["version"]),
        "badge-python": ("Python", " | ".join(python)),
        "badge-system": ("system", "Linux x86-64, arm64"),
        "badge-license": ("license", project["license"]),
        "badge-paper": ("arXiv", PAPER),
    }


def badge(left: str, right: str) -> str:
    """SVG of a badge."""
    widths = [len(text) * ADVANCE_PX + 2 * MARGIN_PX for text in (left, right)]
    title, total = escape(f"{left}: {right}"), sum(widths)
    texts = "".join(
        f'<text x="{middle:.1f}" y="14" textLength="{width - 2 * MARGIN_PX:.1f}">{escape(text)}</text>'
        for text, middle, width in (
            (left, widths[0] / 2, widths[0]),
            (right, widths[0] + widths[1] / 2, widths[1]),
        )
    )
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{total:.1f}" height="{HEIGHT_PX}" role="img" '
        f'aria-label="{title}"><title>{title}</title>'
        f'<clipPath id="r"><rect width="{total:.1f}" height="{HEIGHT_PX}" rx="3"/></clipPath>'
        f'<g clip-path="url(#r)"><rect width="{widths[0]:.1f}" height="{HEIGHT_PX}" fill="{LEFT_COLOR}"/>'
        f'<rect x="{widths[0]:.1f}" width="{widths[1]:.1f}" height="{HEIGHT_PX}" fill="{RIGHT_COLOR}"/></g>'
        f'<g fill="{TEXT_COLOR}" text-anchor="middle" font-size="{LETTER_PX}" '
        f'font-family="DejaVu Sans,Verdana,sans-serif">{texts}</g></svg>\n'
    )


def main(folder: Path) -> None:
    """Write all badges into a folder."""
    for name, (left, right) in badges().items():
        (folder / f"{name}.svg").write_text(badge(left, right), encoding="utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else ROOT / "docs" / "images")
