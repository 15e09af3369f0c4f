"""The trajectories of a session from above: travel to the right of the picture, left of the line upward.

A picture's second axis points down, so a deviation y is drawn at −y.
"""

from typing import Any

import numpy as np

from hexctl.record.overview import paths
from hexctl.record.overview.colors import (
    AXIS_COLOR,
    BANDS,
    BEST_COLOR,
    LEGEND_M,
    LINE_COLOR,
    TEXT_COLOR,
    Color,
    deviation_color,
)
from hexctl.record.overview.trials import Overview, OverviewTrial, deviation_text
from hexctl.record.sdk import load_rerun
from hexctl.robot.messages import FloatArray

#: Room around the line of travel that trials of any kind are given in the picture, in shares of its length.
SIDE_LIMIT, END_LIMIT = 0.75, 0.25
SIDE_LEAST, MARGIN = 0.15, 0.06

#: Line widths in points of the screen; negative is how Rerun tells them from metres.
THIN, TRACK, BOLD = -0.5, -1.0, -2.5

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
    """Send a line and its name for every metre, or every few on a long course."""
    (x_low, y_low), (x_high, y_high) = visible_m(overview)
    step = max(1.0, np.ceil(overview.course_m / 8))
    along = np.arange(np.ceil(x_low / step), x_high / step) * step
    across = np.arange(np.ceil(y_low / step), y_high / step) * step
    lines = [[(x, y_low), (x, y_high)] for x in along] + [[(x_low, y), (x_high, y)] for y in across]
    look = {"colors": [AXIS_COLOR], "radii": [THIN], "draw_order": AXIS_ORDER}
    strips = picture(np.array(lines))
    stream.log(paths.AXES, load_rerun().LineStrips2D(strips, **look), static=True)
    marks = [((x, y_low), f"{x:g} m") for x in along if x] + [
        ((x_low, y), f"{y:+g} m" if y else "0") for y in across
    ]
    _send_labels(stream, f"{paths.AXES}/names", marks, TEXT_COLOR)


def _send_course(stream: Any, overview: Overview) -> None:
    """Send the target bands, the line of travel and the start."""
    rr, length = load_rerun(), overview.course_m
    line = np.array([[0.0, 0.0], [length, 0.0]])
    for order, (half_width_m, color, _) in enumerate(BANDS):
        corners = {"mins": [[0.0, -half_width_m]], "sizes": [[length, 2 * half_width_m]]}
        band = _band(corners, color, BAND_ORDER + order)
        stream.log(f"{paths.BANDS}/{order + 1}", band, static=True)
    look = {"colors": [LINE_COLOR], "radii": [THIN], "draw_order": LINE_ORDER}
    stream.log(paths.LINE, rr.LineStrips2D([line], **look), static=True)
    marks = [((length, half_width_m), name) for half_width_m, _, name in BANDS]
    _send_labels(stream, f"{paths.BANDS}/names", marks, TEXT_COLOR)
    start = rr.Points2D(
        [[0.0, 0.0]], radii=[-5.0], colors=[LINE_COLOR], labels=["start"], draw_order=MARK_ORDER
    )
    stream.log(paths.START, start, static=True)


def _band(corners: dict[str, Any], color: Color, order: int) -> Any:
    """Return a filled rectangle: a line as wide as the band is."""
    (x, y), (length, width) = corners["mins"][0], corners["sizes"][0]
    middle = y + width / 2
    return load_rerun().LineStrips2D(
        [[(x, middle), (x + length, middle)]], colors=[color], radii=[width / 2], draw_order=order
    )


def _send_legend(stream: Any, overview: Overview) -> None:
    """Send the colours of the deviations, at the top of the picture."""
    (x_low, _), (x_high, y_high) = visible_m(overview)
    xs = x_low + (x_high - x_low) * np.linspace(0.1, 0.55, len(LEGEND_M))
    points = picture(np.column_stack([xs, np.full(len(xs), y_high)]))
    names = [f"{mark:g} m" for mark in LEGEND_M]
    names[-1] += " or more"
    colors = [deviation_color(mark, valid=True) for mark in LEGEND_M]
    legend = load_rerun().Points2D(
        points, radii=[-6.0], colors=colors, labels=names, show_labels=True, draw_order=MARK_ORDER
    )
    stream.log(paths.LEGEND, legend, static=True)


def _send_labels(stream: Any, path: str, marks: list[tuple[Any, str]], color: Color) -> None:
    """Send names without a point, each at its place (progress, deviation) in m."""
    points = picture(np.array([place for place, _ in marks]))
    labels = load_rerun().Points2D(
        points, radii=[0.0], colors=[color], labels=[name for _, name in marks], show_labels=True
    )
    stream.log(path, labels, static=True)


def _send_trial(stream: Any, trial: OverviewTrial) -> None:
    """Send a trajectory that appears with its trial."""
    if not len(trial.path_m):
        return
    rr = load_rerun()
    color = deviation_color(trial.deviation_m, valid=trial.score_m is not None)
    look = rr.LineStrips2D.columns(
        strips=[picture(trial.path_m)], colors=[color], radii=[TRACK], draw_order=[TRACK_ORDER]
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
            radii=[-5.0],
            labels=[label],
            draw_order=[MARK_ORDER],
        )
        stream.send_columns(f"{paths.BEST}/end", when, end)
