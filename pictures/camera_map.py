"""Map of the error over the floor: where a webcam sees a robot, and how far off."""

import io
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from benchmarks.see import SEED
from benchmarks.see_floor import FLOOR_TAGS, HALF_FLOOR_M, floor_errors
from hexctl.simulators.camera.rendering import CAMERA, WEBCAM
from pictures.picture import Picture

#: Grid of the floor, in m, and the greatest error that has a colour of its own, in mm.
STEP_M, MOST_MM = 0.125, 3.0


def draw_camera_map(_: Path) -> Picture:
    """Draw the floor from above, the error at each place as a colour; the folder stays empty."""
    errors = floor_errors(CAMERA, WEBCAM, STEP_M, seed=SEED)
    off_mm = 1e3 * np.hypot(*errors.off_m.T)
    figure = Figure(figsize=(7.2, 4.4), layout="constrained")
    panel = figure.subplots()
    # Seen from above with the camera below: x up, y to the left.
    across, ahead = -errors.places[:, 1], errors.places[:, 0]
    hidden = np.isnan(off_mm)
    panel.plot(across[hidden], ahead[hidden], "x", color="#999999", markersize=4, label="not seen")
    colors = panel.scatter(
        across[~hidden],
        ahead[~hidden],
        c=off_mm[~hidden],
        s=42,
        marker="s",
        vmin=0.0,
        vmax=MOST_MM,
        cmap="viridis",
    )
    for number, tag in FLOOR_TAGS.items():
        panel.plot(-tag.pose.y_m, tag.pose.x_m, "s", color="white", markeredgecolor="black", markersize=9)
        panel.annotate(str(number), (-tag.pose.y_m, tag.pose.x_m), ha="center", va="center", fontsize=7)
    panel.annotate(
        "camera, 1.63 m high, 0.63 m behind this edge",
        (0.0, -HALF_FLOOR_M[0] - 0.16),
        ha="center",
        fontsize=8,
    )
    panel.set_xlim(-HALF_FLOOR_M[1] - 0.15, HALF_FLOOR_M[1] + 0.15)
    panel.set_ylim(-HALF_FLOOR_M[0] - 0.25, HALF_FLOOR_M[0] + 0.15)
    panel.set_aspect("equal")
    panel.set_xlabel("to the right of the home tag in m")
    panel.set_ylabel("ahead of it in m")
    panel.legend(loc="upper right", fontsize=8)
    figure.colorbar(colors, ax=panel, label="position off in mm", shrink=0.8)
    content = io.BytesIO()
    figure.savefig(content, format="png", dpi=110, bbox_inches="tight")
    return Picture.from_png(content.getvalue())
