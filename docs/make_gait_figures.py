"""Make the figures of docs/explanation/gaits.md and docs/how-to/robot-file.md from hexctl itself.

    .venv/bin/python docs/make_gait_figures.py [FOLDER]

Writes gaits.svg, foot.svg, frames.svg and leg.svg, to docs/images without FOLDER. A few seconds.
"""

import sys
from pathlib import Path
from typing import TYPE_CHECKING

import matplotlib as mpl
import numpy as np
from matplotlib.figure import Figure

from hexctl.gait.foot_trajectory import in_stance, lift_offset, part_of_cycle, stroke_offset
from hexctl.gait.gait import parse_slots
from hexctl.ik.legs import link_points_body
from hexctl.robot.loader import load_robot
from hexctl.types import N_LEGS

if TYPE_CHECKING:
    from matplotlib.axes import Axes

IMAGES = Path(__file__).parent / "images"
AIR, FLOOR, FAILED, LINE = "#D55E00", "#CFE3EF", "#999999", "#0072B2"

#: Title, gait as on the command line, failed leg.
GAITS = (("tripod", "tripod", None), ("wave", "wave", None), ("code 57, leg 5 failed", "57", 5))


def draw_gait(panel: "Axes", title: str, text: str, failed: int | None) -> None:
    """Draw when each leg is in the air, over two cycles."""
    slots = parse_slots(text, () if failed is None else (failed,))
    cycles = np.linspace(0, 2, 2401)
    for leg in range(1, N_LEGS + 1):
        slot = slots[leg - 1]
        swinging = ~in_stance(part_of_cycle(cycles + (slot - 1) / 6))
        broken = leg == failed
        panel.barh(leg, 2, height=0.7, color=FAILED if broken else FLOOR)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], swinging.astype(int), [0]])))
        for begin, end in zip(edges[::2], edges[1::2], strict=True):
            if not broken:
                left, right = cycles[begin], cycles[min(end, len(cycles) - 1)]
                panel.barh(leg, right - left, left=left, height=0.7, color=AIR)
        panel.text(2.04, leg, "failed" if broken else f"slot {slot}", va="center", fontsize=8)
    panel.set(title=title, xlim=(0, 2), ylim=(6.6, 0.4), xlabel="gait cycles", yticks=range(1, 7))
    panel.title.set_fontsize(10)


def gaits() -> Figure:
    """Return the gait diagrams."""
    figure = Figure(figsize=(10.5, 3.0), layout="constrained")
    for panel, (title, text, failed) in zip(figure.subplots(1, len(GAITS)), GAITS, strict=True):
        draw_gait(panel, title, text, failed)
    figure.axes[0].set_ylabel("leg")
    return figure


def foot() -> Figure:
    """Return the offset of a foot over its normalised time, and its path from the side."""
    figure = Figure(figsize=(9.0, 2.8), layout="constrained")
    over_time, side = figure.subplots(1, 2)
    u = np.linspace(0, 1, 601)[:-1]
    over_time.axvspan(1 / 3, 2 / 3, color=AIR, alpha=0.15)
    over_time.plot(u, stroke_offset(u), color=LINE, label="m / A, along the line (Eq. 3)")
    over_time.plot(u, lift_offset(u), color=AIR, label="h / H, height (Eq. 4)")
    over_time.set(xlabel="normalised time u of the leg", xticks=[0, 1 / 3, 1 / 2, 2 / 3, 1], xlim=(0, 1))
    over_time.set_xticklabels(["0", "1/3", "1/2", "2/3", "1"])
    over_time.legend(fontsize=8, loc="lower left", frameon=False)
    air = ~in_stance(u)
    # The heading is where the body goes; on the floor a foot moves the other way.
    side.plot(
        -stroke_offset(u)[air], lift_offset(u)[air], color=AIR, label="in the air, a third of the cycle"
    )
    side.plot(-stroke_offset(u)[~air], lift_offset(u)[~air], ".", color=LINE, ms=3, label="on the floor")
    side.annotate(
        "body travels this way",
        (0.48, 1.15),
        (-0.15, 1.15),
        arrowprops={"arrowstyle": "->"},
        va="center",
        fontsize=8,
        ha="center",
    )
    side.set(xlabel="along the heading, seen from the body, in A", ylabel="height, in H", ylim=(-0.15, 1.6))
    side.legend(fontsize=8, loc="upper left", frameon=False)
    return figure


def frames() -> Figure:
    """Return the body from above: mounts, their azimuths, legs in the stance."""
    figure = Figure(figsize=(9.0, 4.4), layout="constrained")
    for panel, name in zip(figure.subplots(1, 2), ("ant", "phantomx"), strict=True):
        robot = load_robot(name)
        points = link_points_body(robot, robot.stance_angles_rad)
        for leg in range(N_LEGS):
            # x forward is up on the page, y left is left.
            panel.plot(-points[leg, :, 1], points[leg, :, 0], "-o", color=LINE, ms=3)
            yaw_deg = round(float(np.degrees(robot.mount_yaws_rad[leg])))
            panel.annotate(
                f"leg {leg + 1}, {yaw_deg if -180 < yaw_deg <= 180 else yaw_deg % 360}°",
                (-points[leg, -1, 1], points[leg, -1, 0]),
                (0, 6),
                textcoords="offset points",
                ha="center",
                fontsize=9,
            )
        for text, across, up in (("x forward", 0.0, 0.05), ("y left", -0.05, 0.0)):
            panel.annotate("", (across, up), (0, 0), arrowprops={"arrowstyle": "->", "color": "black"})
            panel.annotate(text, (across, up), (2, 3), textcoords="offset points", fontsize=8)
        panel.set(title=name, aspect="equal")
        panel.margins(0.12)
        panel.axis("off")
    return figure


def leg() -> Figure:
    """Return one leg from the side in its stance, and what a positive angle of each joint does."""
    robot = load_robot("phantomx")
    figure = Figure(figsize=(9.0, 2.9), layout="constrained")
    for number, (panel, kind) in enumerate(
        zip(figure.subplots(1, 3), ("coxa", "femur", "tibia"), strict=True)
    ):
        for change, color in ((0.0, LINE), (15.0, AIR)):
            angles = robot.stance_angles_rad.copy()
            angles[3 + number] += np.radians(change)  # leg 2, which points to the left
            points = link_points_body(robot, angles)[1]
            from_above = (points[:, 1], -points[:, 0]) if kind == "coxa" else (points[:, 1], points[:, 2])
            label = "stance" if change == 0 else f"{kind} 15° more"
            panel.plot(*from_above, "-o", color=color, ms=4, label=label)
        panel.set(
            title=f"{kind}, from above" if kind == "coxa" else f"{kind}, along the body", aspect="equal"
        )
        panel.set_xlabel("outward, m", fontsize=8)
        panel.set_ylabel("to the rear, m" if kind == "coxa" else "up, m", fontsize=8)
        panel.title.set_fontsize(10)
        panel.tick_params(labelsize=7)
        panel.legend(fontsize=8, frameon=False)
        panel.margins(0.1, 0.25)
    return figure


def main(folder: Path) -> None:
    """Write all figures; the same bytes each time."""
    for name, make in (("gaits", gaits), ("foot", foot), ("frames", frames), ("leg", leg)):
        with mpl.rc_context({"svg.hashsalt": name}):
            make().savefig(folder / f"{name}.svg", metadata={"Date": None, "Creator": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else IMAGES)
