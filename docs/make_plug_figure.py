"""Make the picture of servo plugs of docs/how-to/which-servos.md.

    .venv/bin/python docs/make_plug_figure.py [FOLDER]

Writes plugs.svg, to docs/images without FOLDER.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch, Rectangle

if TYPE_CHECKING:
    from matplotlib.axes import Axes

IMAGES = Path(__file__).parent / "images"

GROUND, SUPPLY, SIGNAL, SECOND = "#444444", "#D62728", "#E0A800", "#0072B2"

#: Title, what the plug is called, distance of its pins in mm, and the pins with their colours.
PLUGS = (
    ("Dynamixel AX", "Molex, 3 pins", 2.5, (("GND", GROUND), ("VDD", SUPPLY), ("DATA", SIGNAL))),
    ("Dynamixel X (TTL)", "JST EH, 3 pins", 2.5, (("GND", GROUND), ("VDD", SUPPLY), ("DATA", SIGNAL))),
    (
        "Dynamixel X (RS-485)",
        "JST EH, 4 pins",
        2.5,
        (("GND", GROUND), ("VDD", SUPPLY), ("D+", SIGNAL), ("D-", SECOND)),
    ),
    ("Dynamixel XL-320", "Molex, small", 1.25, (("GND", GROUND), ("VDD", SUPPLY), ("DATA", SIGNAL))),
    ("Feetech STS, SCS", "5264, 3 pins", 2.5, (("GND", GROUND), ("V", SUPPLY), ("S", SIGNAL))),
    ("Hiwonder LX, HTS", "5264, 3 pins", 2.5, (("GND", GROUND), ("VIN", SUPPLY), ("SIG", SIGNAL))),
    ("hobby servo", "socket, 3 wires", 2.54, (("GND", GROUND), ("V+", SUPPLY), ("pulse", SIGNAL))),
)

#: How many units of the picture are a millimetre.
SCALE = 0.36


def draw_plug(
    panel: "Axes", title: str, name: str, pitch_mm: float, pins: tuple[tuple[str, str], ...]
) -> None:
    """Draw the face of a plug with its pins, at their distance, and the wires that leave it."""
    pitch = SCALE * pitch_mm
    width = pitch * (len(pins) + 0.4)
    body = FancyBboxPatch(
        (-width / 2, 0), width, 0.9, boxstyle="round,pad=0.02", facecolor="#F4F4F4", edgecolor="#777777"
    )
    panel.add_patch(body)
    for number, (label, color) in enumerate(pins):
        x = pitch * (number - (len(pins) - 1) / 2)
        panel.plot([x, x], [-0.75, 0], color=color, linewidth=4, solid_capstyle="butt")
        panel.add_patch(Rectangle((x - 0.11, 0.34), 0.22, 0.22, color=color))
        panel.text(x, -0.85, label, ha="center", va="top", fontsize=7, rotation=90)
    panel.text(0, 1.35, title, ha="center", fontsize=9, fontweight="bold")
    panel.text(0, 1.08, f"{name}, {pitch_mm:g} mm", ha="center", fontsize=7)
    panel.set(xlim=(-2.0, 2.0), ylim=(-1.7, 1.6), aspect="equal")
    panel.axis("off")


def plugs() -> Figure:
    """Return the picture of all plugs."""
    figure = Figure(figsize=(10.5, 4.6), layout="constrained")
    panels = figure.subplots(2, 4).ravel()
    for panel, plug in zip(panels, PLUGS, strict=False):
        draw_plug(panel, *plug)
    for panel in panels[len(PLUGS) :]:
        panel.axis("off")
    return figure


def main(folder: Path) -> None:
    """Write the picture into a folder."""
    mpl.rcParams["svg.hashsalt"] = "hexctl"  # the same file each time
    folder.mkdir(parents=True, exist_ok=True)
    plugs().savefig(folder / "plugs.svg", metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES)
