"""The trajectories of a session from above: travel to the right of the picture, left of the line upward.

A picture's second axis points down, so a deviation y is drawn at -y.
"""

from typing import Any

import numpy as np

from hexctl.record.overview import paths
from hexctl.record.overview.colors import (
    AXIS_COLOR,
    BEST_COLOR,
    LEGEND_M,
    LINE_COLOR,
    TARGET_BANDS,
    TEXT_COLOR,
    deviation_color,
)
from hexctl.record.overview.trials import Overview, OverviewTrial, deviation_text
from hexctl.record.sdk import load_rerun
from hexctl.types import FloatArray

#: Room around the line of travel that trials of any kind are given in the picture, in shares of its length.
SIDE_LIMIT, END_LIMIT = 0.75, 0.25
SIDE_LEAST, MARGIN = 0.15, 0.06

#: Distances between grid lines: the first that needs no more than so many along the course.
GRID_STEPS_M = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
MAX_LINES = 6

#: Line widths in points of the screen; negative is how Rerun tells them from metres.
THIN, TRACK, BOLD, MARK = -0.5, -1.0, -1.75, -5.0

#: What covers what.
AXIS_ORDER, BAND_ORDER, LINE_ORDER, TRACK_ORDER, BEST_ORDER, MARK_ORDER = range(0, 60, 10)


def picture(points_m: FloatArray) -> FloatArray:
    """Return progress and signed deviation, (…, 2) in m, as picture coordinates."""
    return points_m * [1.0, -1.0]


def visible_m(overview: Overview) -> FloatArray:
    """Return the corners of what the picture shows, ((x low, y low), (x high, y high)) in m."""
    length = overview.course_m
    corners = np.array([[0.0, -SIDE_LEAST * length], [length, SIDE_LEAST * length]])
    points = np.concatenate([corners, *(trial.path_m for trial in overview.trials)])
    points = np.clip(points, [-END_LIMIT * length, -SIDE_LIMIT * length], [length * 1.1, SIDE_LIMIT * length])
    margin = MARGIN * length
    return np.array([points.min(axis=0) - margin, points.max(axis=0) + margin])


def send_above(stream: Any, overview: Overview) -> None:
    """Send everything that is seen from above to a recording stream."""
    _send_axes(stream, overview)
    _send_course(stream, overview)
    _send_legend(stream, overview)
    for trial in overview.trials:
        _send_trial(stream, trial)
    _send_best(stream, overview)


def _send_axes(stream: Any, overview: Overview) -> None:
    """Send grid lines and their names, a few to a course."""
    (x_low, y_low), (x_high, y_high) = visible_m(overview)
    step = next((step for step in GRID_STEPS_M if overview.course_m <= MAX_LINES * step), GRID_STEPS_M[-1])
    along = np.arange(np.ceil(x_low / step), x_high / step) * step
    across = np.arange(np.ceil(y_low / step), y_high / step) * step
    lines = [[(x, y_low), (x, y_high)] for x in along] + [[(x_low, y), (x_high, y)] for y in across]
    look = {"colors": [AXIS_COLOR], "radii": [THIN], "draw_order": AXIS_ORDER}
    strips = load_rerun().LineStrips2D(picture(np.array(lines)), **look)
    stream.log(paths.AXES, strips, static=True)
    foot = y_low + MARGIN * overview.course_m
    names = [((x, foot), f"{x:g} m") for x in along if x]
    side = x_low + MARGIN * overview.course_m / 2
    names += [((side, y), f"{y:+g} m") for y in across if y]
    _send_names(stream, f"{paths.AXES}/names", names)


def _send_course(stream: Any, overview: Overview) -> None:
    """Send the target bands, the line of travel and the start."""
    rr, length = load_rerun(), overview.course_m
    for order, (half_width_m, color, _) in enumerate(TARGET_BANDS):
        # A line as wide as the band; its round ends reach half the width further.
        ends = [[(half_width_m, 0.0), (length - half_width_m, 0.0)]]
        look = {"colors": [color], "radii": [half_width_m], "draw_order": BAND_ORDER + order}
        stream.log(f"{paths.BANDS}/{order + 1}", rr.LineStrips2D(ends, **look), static=True)
    look = {"colors": [LINE_COLOR], "radii": [THIN], "draw_order": LINE_ORDER}
    stream.log(paths.LINE, rr.LineStrips2D([[(0.0, 0.0), (length, 0.0)]], **look), static=True)
    targets = "targets " + ", ".join(name for *_, name in reversed(TARGET_BANDS))
    names = [
        ((0.92 * length, TARGET_BANDS[0][0] + MARGIN * length / 2), targets),
        ((0.0, -TARGET_BANDS[0][0]), "start"),
    ]
    _send_names(stream, f"{paths.BANDS}/names", names)
    start = rr.Points2D([[0.0, 0.0]], radii=[MARK], colors=[LINE_COLOR], draw_order=MARK_ORDER)
    stream.log(paths.START, start, static=True)


def _send_legend(stream: Any, overview: Overview) -> None:
    """Send the colours of the deviations, at the top of the picture."""
    (x_low, _), (x_high, y_high) = visible_m(overview)
    xs = x_low + (x_high - x_low) * np.linspace(0.1, 0.75, len(LEGEND_M))
    places = np.column_stack([xs, np.full(len(xs), y_high - MARGIN * overview.course_m / 4)])
    colors = [deviation_color(mark, valid=True) for mark in LEGEND_M]
    dots = load_rerun().Points2D(picture(places), radii=[MARK], colors=colors, draw_order=MARK_ORDER)
    stream.log(paths.LEGEND, dots, static=True)
    names = [f"{mark:g} m" for mark in LEGEND_M]
    names[0], names[-1] = "deviation 0", f"{names[-1]} or more"
    _send_names(stream, f"{paths.LEGEND}/names", list(zip(places, names, strict=True)))


def _send_names(stream: Any, path: str, names: list[tuple[Any, str]]) -> None:
    """Send texts without a mark, each just below its place (progress, deviation) in m."""
    points = picture(np.array([place for place, _ in names]).reshape(-1, 2))
    texts = [text for _, text in names]
    labels = load_rerun().Points2D(points, radii=[0.0], colors=[TEXT_COLOR], labels=texts, show_labels=True)
    stream.log(path, labels, static=True)


def _send_trial(stream: Any, trial: OverviewTrial) -> None:
    """Send a trajectory that appears with its trial, the straighter the further in front."""
    if not len(trial.path_m):
        return
    color = deviation_color(trial.deviation_m, valid=trial.score_m is not None)
    off_m = min(abs(trial.deviation_m or 0.0), LEGEND_M[-1]) if trial.score_m is not None else LEGEND_M[-1]
    look = load_rerun().LineStrips2D.columns(
        strips=[picture(trial.path_m)],
        colors=[color],
        radii=[TRACK],
        draw_order=[TRACK_ORDER + LEGEND_M[-1] - off_m],
    )
    stream.send_columns(paths.trial_path(trial.index), [paths.at([trial.index])], look)


def _send_best(stream: Any, overview: Overview) -> None:
    """Send the best trajectory so far, and what it is, wherever it changes."""
    rr, last = load_rerun(), None
    for trial, best in zip(overview.trials, overview.best_so_far(), strict=True):
        if best is last or best is None or not len(best.path_m):
            continue
        last, when = best, [paths.at([trial.index])]
        line = rr.LineStrips2D.columns(
            strips=[picture(best.path_m)], colors=[BEST_COLOR], radii=[BOLD], draw_order=[BEST_ORDER]
        )
        stream.send_columns(paths.BEST, when, line)
        label = f"best: trial {best.index}, code {best.code}, {deviation_text(best.deviation_m)}"
        end = rr.Points2D.columns(
            positions=[picture(best.end_m)],
            colors=[BEST_COLOR],
            radii=[MARK],
            labels=[label],
            draw_order=[MARK_ORDER],
        )
        stream.send_columns(paths.BEST_END, when, end)
