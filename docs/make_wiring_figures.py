"""Make the wiring pictures of docs/how-to/servos.md.

    .venv/bin/python docs/make_wiring_figures.py [FOLDER]

Writes wiring-bus.svg and a picture of each board, to docs/images without FOLDER. They are drawn on white, so
that they are legible on dark pages too.
"""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
from matplotlib.figure import Figure
from matplotlib.patches import FancyBboxPatch

if TYPE_CHECKING:
    from matplotlib.axes import Axes

IMAGES = Path(__file__).parent / "images"

#: What a wire carries: how it is called, its colour, and its width in points.
KINDS = {
    "servos": ("supply of the servos", "#D62728", 3.5),
    "ground": ("ground, common to all", "#444444", 2.5),
    "logic": ("supply of computer and logic", "#E07B00", 2.0),
    "data": ("data: USB, I2C or bus", "#0072B2", 2.0),
    "pulse": ("pulse, one wire for each servo", "#B59A00", 2.0),
}


@dataclass(frozen=True, slots=True)
class Box:
    """A part: its place in the picture from the left and from below, its width and height, what it is."""

    x: float
    y: float
    width: float
    height: float
    text: str
    hand: bool = False


@dataclass(frozen=True, slots=True)
class Wire:
    """A wire of a kind through points."""

    kind: str
    points: tuple[tuple[float, float], ...]
    text: str = ""


#: The way of the servos' supply is the same in all pictures: battery, fuse, switch.
SUPPLY = (
    Box(0.0, 2.6, 1.7, 0.9, "battery\nof the servos"),
    Box(2.3, 2.75, 0.9, 0.6, "fuse"),
    Box(3.8, 2.6, 1.6, 0.9, "SWITCH\nwithin reach", hand=True),
)
SUPPLY_WIRES = (
    Wire("servos", ((1.7, 3.05), (2.3, 3.05))),
    Wire("servos", ((3.2, 3.05), (3.8, 3.05))),
)
COMPUTER = (
    Box(0.0, 0.3, 1.7, 0.9, "supply\nof its own"),
    Box(2.3, 0.3, 1.9, 0.9, "robot's computer"),
)
COMPUTER_WIRES = (Wire("logic", ((1.7, 0.9), (2.3, 0.9))), Wire("ground", ((1.7, 0.55), (2.3, 0.55))))

BUS = (
    (
        *SUPPLY,
        *COMPUTER,
        Box(5.0, 0.3, 1.9, 0.9, "adapter\nU2D2, FE-URT-1 ..."),
        Box(6.3, 2.3, 1.5, 1.2, "power hub"),
        Box(8.6, 2.3, 1.1, 1.2, "servo\nid 1"),
        Box(10.3, 2.3, 1.1, 1.2, "servo\nid 2"),
        Box(12.6, 2.3, 1.1, 1.2, "servo\nid 18"),
    ),
    (
        *SUPPLY_WIRES,
        *COMPUTER_WIRES,
        Wire("servos", ((5.4, 3.05), (6.3, 3.05))),
        Wire("ground", ((0.85, 2.6), (0.85, 2.0), (6.6, 2.0), (6.6, 2.3))),
        Wire("data", ((4.2, 0.75), (5.0, 0.75)), "USB"),
        Wire("data", ((6.9, 0.9), (7.4, 0.9), (7.4, 2.3)), "data"),
        Wire("ground", ((6.9, 0.55), (7.0, 0.55), (7.0, 2.3))),
        *(
            Wire(kind, ((begin, y), (end, y)))
            for begin, end in ((7.8, 8.6), (9.7, 10.3), (11.4, 11.7), (12.3, 12.6))
            for kind, y in (("servos", 3.2), ("data", 2.9), ("ground", 2.6))
        ),
    ),
)


def on_usb(board: str, servos: str) -> tuple[tuple[Box, ...], tuple[Wire, ...]]:
    """A board at a USB cable, with the supply of its servos."""
    return (
        (*SUPPLY, *COMPUTER, Box(6.3, 1.0, 2.6, 2.5, board), Box(10.6, 2.0, 2.0, 1.5, servos)),
        (
            *SUPPLY_WIRES,
            *COMPUTER_WIRES,
            Wire("servos", ((5.4, 3.05), (6.3, 3.05))),
            Wire("ground", ((0.85, 2.6), (0.85, 2.0), (6.3, 2.0))),
            Wire("data", ((4.2, 0.75), (7.2, 0.75), (7.2, 1.0)), "USB"),
            Wire("pulse", ((8.9, 3.2), (10.6, 3.2)), "18 x"),
            Wire("servos", ((8.9, 2.8), (10.6, 2.8))),
            Wire("ground", ((8.9, 2.4), (10.6, 2.4))),
        ),
    )


SERVO2040 = on_usb(
    'servo2040\n\ntrace\n"Separate USB and\nExt. Power" cut', "18 hobby servos\noutputs 0 to 17"
)

MAESTRO_BOXES, MAESTRO_WIRES = on_usb(
    "Mini Maestro\n\nservo rail, jumper\nVSRV=VIN removed", "18 hobby servos\nchannels 0 to 17"
)
MAESTRO = (
    (*MAESTRO_BOXES, Box(10.6, 0.3, 2.0, 1.2, "6 foot switches\nto 5 V, 10 kOhm\nto ground")),
    (*MAESTRO_WIRES, Wire("data", ((8.9, 1.3), (10.6, 1.3)), "inputs")),
)

SSC32 = on_usb("SSC-32U\n\nVS1 and VS2, jumper\nVS1=VL removed", "18 hobby servos\nchannels 0 to 31")

PCA9685 = (
    (
        *SUPPLY,
        *COMPUTER,
        Box(7.0, 2.2, 2.4, 1.3, "PCA9685\n0x40, outputs 0 to 15"),
        Box(7.0, 0.3, 2.4, 1.3, "PCA9685\n0x41, outputs 16 to 31"),
        Box(11.1, 1.2, 1.7, 1.5, "18 hobby\nservos"),
    ),
    (
        *SUPPLY_WIRES,
        *COMPUTER_WIRES,
        Wire("servos", ((5.4, 3.05), (7.0, 3.05)), "V+"),
        Wire("servos", ((6.55, 3.05), (6.55, 1.35), (7.0, 1.35))),
        Wire("ground", ((0.85, 2.6), (0.85, 2.0), (6.25, 2.0), (6.25, 0.45), (7.0, 0.45))),
        Wire("ground", ((6.25, 2.0), (6.25, 2.4), (7.0, 2.4))),
        Wire("ground", ((4.2, 0.45), (6.25, 0.45)), "GND"),
        Wire("logic", ((4.2, 1.05), (5.65, 1.05), (5.65, 2.7), (7.0, 2.7)), "3.3 V: VCC"),
        Wire("logic", ((5.65, 1.05), (7.0, 1.05))),
        Wire("data", ((4.2, 0.75), (5.95, 0.75), (5.95, 2.55), (7.0, 2.55)), "SDA, SCL"),
        Wire("data", ((5.95, 0.75), (7.0, 0.75))),
        Wire("pulse", ((9.4, 3.0), (10.3, 3.0), (10.3, 2.45), (11.1, 2.45))),
        Wire("pulse", ((9.4, 0.8), (10.3, 0.8), (10.3, 1.45), (11.1, 1.45)), "18 in all"),
        Wire("servos", ((9.4, 2.75), (10.0, 2.75), (10.0, 2.1), (11.1, 2.1))),
        Wire("ground", ((9.4, 2.5), (9.7, 2.5), (9.7, 1.8), (11.1, 1.8))),
    ),
)


def draw_box(panel: "Axes", box: Box) -> None:
    """Draw a part; what a hand reaches for is framed in red."""
    edge, width = ("#D62728", 2.5) if box.hand else ("#777777", 1.0)
    panel.add_patch(
        FancyBboxPatch(
            (box.x, box.y),
            box.width,
            box.height,
            boxstyle="round,pad=0,rounding_size=0.08",
            facecolor="#F4F4F4",
            edgecolor=edge,
            linewidth=width,
        )
    )
    weight = "bold" if box.hand else "normal"
    x, y = box.x + box.width / 2, box.y + box.height / 2
    panel.text(x, y, box.text, ha="center", va="center", fontsize=9, fontweight=weight)


def draw_wire(panel: "Axes", wire: Wire) -> None:
    """Draw a wire, with its text above its first piece."""
    _, color, width = KINDS[wire.kind]
    xs, ys = zip(*wire.points, strict=True)
    panel.plot(xs, ys, color=color, linewidth=width, solid_joinstyle="round", zorder=0)
    if wire.text:
        panel.text((xs[0] + xs[1]) / 2, ys[0] + 0.08, wire.text, ha="center", va="bottom", fontsize=8)


def wiring(boxes: tuple[Box, ...], wires: tuple[Wire, ...]) -> Figure:
    """Return a picture of parts and wires, with a key of the colours that it has."""
    figure = Figure(figsize=(10.5, 3.4), layout="constrained", facecolor="white")
    panel = figure.subplots()
    for wire in wires:
        draw_wire(panel, wire)
    for box in boxes:
        draw_box(panel, box)
    right = max(box.x + box.width for box in boxes)
    for index, kind in enumerate(kind for kind in KINDS if any(wire.kind == kind for wire in wires)):
        name, color, width = KINDS[kind]
        x = index * right / 5
        panel.plot([x, x + 0.35], [-0.25, -0.25], color=color, linewidth=width)
        panel.text(x + 0.45, -0.25, name, va="center", fontsize=8)
    panel.set(xlim=(-0.15, right + 0.15), ylim=(-0.45, 3.65), aspect="equal")
    panel.axis("off")
    return figure


def main(folder: Path) -> None:
    """Write the pictures into a folder."""
    mpl.rcParams["svg.hashsalt"] = "hexctl"  # the same file each time
    folder.mkdir(parents=True, exist_ok=True)
    pictures = {
        "bus": BUS,
        "servo2040": SERVO2040,
        "pca9685": PCA9685,
        "maestro": MAESTRO,
        "ssc32": SSC32,
    }
    for name, parts in pictures.items():
        wiring(*parts).savefig(folder / f"wiring-{name}.svg", metadata={"Date": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES)
