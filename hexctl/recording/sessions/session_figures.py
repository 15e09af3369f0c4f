"""The overview recording of a session: trajectories from above, convergence curve and table in one file."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.errors import HexctlError, InputError, RecordingError
from hexctl.files import replacing
from hexctl.palette import (
    AXIS_COLOR,
    BACKGROUND,
    BEST_COLOR,
    INVALID_COLOR,
    LEGEND_M,
    LINE_COLOR,
    TARGET_BANDS,
    TEXT_COLOR,
    baseline_color,
    deviation_color,
)
from hexctl.recording.blueprint import two_columns
from hexctl.recording.rrd import create_file, create_folders, load_rerun, new_recording
from hexctl.recording.rrd_reader import check_end
from hexctl.recording.sessions.session_overview import (
    Overview,
    OverviewTrial,
    deviation_text,
    make_table,
    mark_text,
)
from hexctl.types import FloatArray

#: The timeline: the number of trials, and the position of the baseline on it.
TIMELINE, BEFORE_TRIALS = "trial", 0

ABOVE = "above"
AXES = "above/axes"
BANDS = "above/bands"
LINE = "above/line_of_travel"
LEGEND = "above/legend"
BEST = "above/best"

SCENERY = (AXES, BANDS, LEGEND, LINE)

CURVE = "curve"
TABLE = "table"

#: Limits of the picture around the line of travel, as shares of its length.
SIDE_LIMIT, END_LIMIT = 0.75, 0.25
SIDE_LEAST, MARGIN = 0.15, 0.06

#: Candidate distances between grid lines; the first with at most MAX_LINES along the course is used.
GRID_STEPS_M = (0.25, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 50.0)
MAX_LINES = 6

#: Line widths and sizes of marks in points of the screen, which Rerun marks by a negative sign.
THIN, TRACK, BOLD, MARK = -0.5, -1.0, -1.75, -5.0

#: Draw order: higher covers lower.
AXIS_ORDER, BAND_ORDER, LINE_ORDER, TRACK_ORDER, BEST_ORDER, MARK_ORDER = range(0, 60, 10)


def trial_column(indices: Sequence[int]) -> Any:
    """Trials as a column of the timeline."""
    return load_rerun().TimeColumn(TIMELINE, sequence=np.asarray(indices, dtype=np.int64))


def draw(stream: Any, path: str, thing: Any, trial: int | None = None) -> None:
    """Send an archetype of Rerun, to be shown from a trial on; `trial` None draws it at all times."""
    if trial is None:
        stream.log(path, thing, static=True)
        return
    batches = thing.as_component_batches()
    columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
    stream.send_columns(path, [trial_column([trial])], columns)


def draw_names(stream: Any, path: str, names: Sequence[tuple[Any, str]], trial: int | None = None) -> None:
    """Send texts with their positions in the picture."""
    places = np.array([place for place, _ in names]).reshape(-1, 2)
    texts = [text for _, text in names]
    look = {"radii": [0.0], "colors": [TEXT_COLOR], "labels": texts, "show_labels": True}
    draw(stream, path, load_rerun().Points2D(places, **look), trial)


def picture(points_m: FloatArray) -> FloatArray:
    """Progress and signed deviation, (…, 2) in m, as picture coordinates."""
    return points_m * [1.0, -1.0]


def visible_m(overview: Overview) -> FloatArray:
    """Corners of the picture, ((x low, y low), (x high, y high)) in m."""
    length = overview.course_m
    corners = np.array([[0.0, -SIDE_LEAST * length], [length, SIDE_LEAST * length]])
    points = np.concatenate([corners, *(trial.path_m for trial in (*overview.baseline, *overview.trials))])
    points = np.clip(points, [-END_LIMIT * length, -SIDE_LIMIT * length], [length * 1.1, SIDE_LIMIT * length])
    margin = MARGIN * length
    return np.array([points.min(axis=0) - margin, points.max(axis=0) + margin])


def send_above(stream: Any, overview: Overview) -> None:
    """Send the view from above to a recording stream."""
    _send_axes(stream, overview)
    _send_course(stream, overview)
    _send_legend(stream, overview)
    _send_baseline(stream, overview)
    for trial in overview.trials:
        if len(trial.path_m):
            _send_trial(stream, trial)
    _send_best(stream, overview)


def _send_names(stream: Any, path: str, names: Sequence[tuple[Any, str]]) -> None:
    draw_names(stream, path, [(picture(np.array(place_m)), text) for place_m, text in names])


def _send_axes(stream: Any, overview: Overview) -> None:
    (x_low, y_low), (x_high, y_high) = visible_m(overview)
    step = next((step for step in GRID_STEPS_M if overview.course_m <= MAX_LINES * step), GRID_STEPS_M[-1])
    along = np.arange(np.ceil(x_low / step), x_high / step) * step
    across = np.arange(np.ceil(y_low / step), y_high / step) * step
    lines = [[(x, y_low), (x, y_high)] for x in along] + [[(x_low, y), (x_high, y)] for y in across]
    look = {"colors": [AXIS_COLOR], "radii": [THIN], "draw_order": AXIS_ORDER}
    draw(stream, AXES, load_rerun().LineStrips2D(picture(np.array(lines)), **look))
    foot = y_low + MARGIN * overview.course_m
    names = [((x, foot), f"{x:g} m") for x in along if x]
    side = x_low + MARGIN * overview.course_m / 2
    names += [((side, y), f"{y:+g} m") for y in across if y]
    _send_names(stream, f"{AXES}/names", names)


def _send_course(stream: Any, overview: Overview) -> None:
    rr, length = load_rerun(), overview.course_m
    for order, (half_width_m, color, _) in enumerate(TARGET_BANDS):
        # A line as wide as the band; its round ends reach half the width further.
        ends = [[(half_width_m, 0.0), (length - half_width_m, 0.0)]]
        look = {"colors": [color], "radii": [half_width_m], "draw_order": BAND_ORDER + order}
        draw(stream, f"{BANDS}/{order + 1}", rr.LineStrips2D(ends, **look))
    look = {"colors": [LINE_COLOR], "radii": [THIN], "draw_order": LINE_ORDER}
    draw(stream, LINE, rr.LineStrips2D([[(0.0, 0.0), (length, 0.0)]], **look))
    targets = "targets " + ", ".join(name for *_, name in reversed(TARGET_BANDS))
    names = [
        ((0.25 * length, TARGET_BANDS[0][0] + MARGIN * length), targets),
        ((0.0, -TARGET_BANDS[0][0]), "start"),
    ]
    _send_names(stream, f"{BANDS}/names", names)
    start = rr.Points2D([[0.0, 0.0]], radii=[MARK], colors=[LINE_COLOR], draw_order=MARK_ORDER)
    draw(stream, f"{ABOVE}/start", start)


def _send_legend(stream: Any, overview: Overview) -> None:
    (x_low, _), (x_high, y_high) = visible_m(overview)
    xs = x_low + (x_high - x_low) * np.linspace(0.1, 0.9, len(LEGEND_M))
    places = np.column_stack([xs, np.full(len(xs), y_high - MARGIN * overview.course_m / 4)])
    colors = [deviation_color(mark, valid=True) for mark in LEGEND_M]
    dots = load_rerun().Points2D(picture(places), radii=[MARK], colors=colors, draw_order=MARK_ORDER)
    draw(stream, LEGEND, dots)
    names = [mark_text(mark) for mark in LEGEND_M]
    names[0], names[-1] = f"deviation ≤ {names[0]}", f"≥ {names[-1]}"
    _send_names(stream, f"{LEGEND}/names", list(zip(places, names, strict=True)))


def _send_trial(stream: Any, trial: OverviewTrial) -> None:
    valid, far_m = trial.score_m is not None, LEGEND_M[-1]
    off_m = min(abs(trial.deviation_m or 0.0), far_m) if valid else far_m
    line = load_rerun().LineStrips2D(
        [picture(trial.path_m)],
        colors=[deviation_color(trial.deviation_m, valid=valid)],
        radii=[TRACK],
        draw_order=TRACK_ORDER + far_m - off_m,
    )
    draw(stream, f"{ABOVE}/trials/{trial.index:03d}", line, trial.index)


def _send_baseline(stream: Any, overview: Overview) -> None:
    walks = [walk for walk in overview.baseline if len(walk.path_m)]
    for walk, place in zip(walks, _spread_ends_m(walks, overview), strict=True):
        path = f"{ABOVE}/baseline/{walk.gait}"
        look = {"colors": [baseline_color(walk.gait or "")], "radii": [TRACK], "draw_order": TRACK_ORDER}
        draw(stream, path, load_rerun().LineStrips2D([picture(walk.path_m)], **look))
        _send_names(stream, f"{path}/name", [(place, str(walk.gait))])


def _spread_ends_m(walks: Sequence[OverviewTrial], overview: Overview) -> list[FloatArray]:
    """A label position for each path, a gap apart, below the legend and inside the picture."""
    gap_m, (right_m, top_m) = 0.7 * MARGIN * overview.course_m, visible_m(overview)[1]
    ceiling_m = top_m - 2.5 * MARGIN * overview.course_m
    places: dict[int, FloatArray] = {}
    for number in sorted(range(len(walks)), key=lambda one: -float(walks[one].end_m[1])):
        along_m, across_m = walks[number].end_m
        place_m = min(float(across_m) + gap_m / 2, ceiling_m)
        places[number] = np.array([min(along_m + 2 * gap_m, right_m - 2 * gap_m), place_m])
        ceiling_m = place_m - gap_m
    return [places[number] for number in range(len(walks))]


def _send_best(stream: Any, overview: Overview) -> None:
    rr, last = load_rerun(), None
    (_, y_low), _ = visible_m(overview)
    # Below the middle of the line, which paths rarely reach.
    name_m = np.array([0.5 * overview.course_m, y_low + 2.5 * MARGIN * overview.course_m])
    for trial, best in zip(overview.trials, overview.best_so_far(), strict=True):
        if best is last or best is None or not len(best.path_m):
            continue
        last = best
        line = rr.LineStrips2D(
            [picture(best.path_m)], colors=[BEST_COLOR], radii=[BOLD], draw_order=BEST_ORDER
        )
        draw(stream, BEST, line, trial.index)
        label = f"best so far: trial {best.index}, code {best.code}, {deviation_text(best.deviation_m)}"
        end = rr.Points2D(
            [picture(best.end_m)],
            colors=[BEST_COLOR],
            radii=[MARK],
            draw_order=MARK_ORDER,
            labels=[label],
            show_labels=False,  # named elsewhere; here only on hover
        )
        draw(stream, f"{BEST}/end", end, trial.index)
        draw_names(stream, f"{BEST}/name", [(picture(name_m), label)], trial.index)


def score_top(overview: Overview) -> float:
    """Height in the curve above all valid walks, at which invalid trials are drawn."""
    walks = (*overview.baseline, *overview.trials)
    scores_m = [walk.score_m for walk in walks if walk.score_m is not None]
    return overview.curve_factor * 1.1 * max([TARGET_BANDS[0][0], *scores_m])


def _send_scores(stream: Any, overview: Overview) -> None:
    """Send the points of the curve: scores, invalid trials, and the best so far."""
    rr, factor, top = load_rerun(), overview.curve_factor, score_top(overview)
    valid = [(one.index, factor * one.score_m) for one in overview.trials if one.score_m is not None]
    dots = rr.SeriesPoints(names=["trial"], markers=["circle"], marker_sizes=[4.0])
    _send_series(stream, "score", dots, valid)
    if valid:
        colors = [
            deviation_color(one.deviation_m, valid=True) for one in overview.trials if one.score_m is not None
        ]
        columns = rr.SeriesPoints.columns(colors=np.array(colors, dtype=np.uint8))
        stream.send_columns(f"{CURVE}/score", [trial_column([index for index, _ in valid])], columns)
    crosses = rr.SeriesPoints(
        names=["invalid"], markers=["cross"], marker_sizes=[4.0], colors=[INVALID_COLOR]
    )
    # Above all scores: an invalid trial ranks behind them.
    invalid = [(one.index, top) for one in overview.trials if one.score_m is None]
    _send_series(stream, "invalid", crosses, invalid)
    steps = rr.SeriesLines(
        names=["best so far"], colors=[BEST_COLOR], widths=[2.5], interpolation_mode="StepAfter"
    )
    pairs = zip(overview.trials, overview.best_so_far(), strict=True)
    best = [
        (trial.index, factor * one.score_m)
        for trial, one in pairs
        if one is not None and one.score_m is not None
    ]
    _send_series(stream, "best_so_far", steps, best)


def _send_levels(stream: Any, overview: Overview) -> None:
    """Send the horizontal lines of the curve: targets, and scores of the baseline."""
    lines, factor = load_rerun().SeriesLines, overview.curve_factor
    indices = [trial.index for trial in overview.trials]
    for number, (half_width_m, _, name) in enumerate(TARGET_BANDS, start=1):
        look = lines(names=[name.removeprefix("±")], colors=[INVALID_COLOR], widths=[1.0])
        _send_series(stream, f"targets/{number}", look, [(index, factor * half_width_m) for index in indices])
    for walk in overview.baseline:
        if walk.score_m is not None:
            name, color = f"{walk.gait}, without a search", baseline_color(walk.gait or "")
            look, level = lines(names=[name], colors=[color], widths=[1.5]), factor * walk.score_m
            points = [(index, level) for index in (BEFORE_TRIALS, *indices)]
            _send_series(stream, f"baseline/{walk.gait}", look, points)


def _send_series(stream: Any, name: str, look: Any, points: Sequence[tuple[int, float]]) -> None:
    """Send a series of the curve with its look, by trial; nothing without a point."""
    if points:
        indices, values = zip(*points, strict=True)
        draw(stream, f"{CURVE}/{name}", look)
        scalars = load_rerun().Scalars.columns(scalars=values)
        stream.send_columns(f"{CURVE}/{name}", [trial_column(indices)], scalars)


#: Share of the curve's width reserved for its legend.
LEGEND_SHARE = 0.15


def make_layout(overview: Overview) -> Any:
    """Blueprint of an overview."""
    rrb = load_rerun().blueprint
    left = rrb.Vertical(_above_view(overview), _curve_view(overview), row_shares=[5, 2])
    table = rrb.TextDocumentView(origin=TABLE, name="trials")
    # Following: the time cursor begins at the last trial, so that all are shown.
    time = {"play_state": "following", "loop_mode": None, "fps": 4.0}
    return two_columns(left, table, TIMELINE, **time)


def _above_view(overview: Overview) -> Any:
    rrb = load_rerun().blueprint
    (x_low, bottom), (x_high, top) = picture(visible_m(overview))
    return rrb.Spatial2DView(
        origin=ABOVE,
        name="trajectories from above (m)",
        background=[*BACKGROUND],
        visual_bounds=rrb.VisualBounds2D(x_range=[x_low, x_high], y_range=[top, bottom]),
        overrides={path: rrb.EntityBehavior(interactive=False) for path in SCENERY},
    )


def _curve_view(overview: Overview) -> Any:
    rrb = load_rerun().blueprint
    first, last = overview.trials[0].index, overview.trials[-1].index
    # Room for the legend.
    last += max(1, round(LEGEND_SHARE * (last - first)))
    top, unit = score_top(overview), overview.curve_unit
    return rrb.TimeSeriesView(
        origin=CURVE,
        name=f"{overview.objective} ({unit})" if unit else overview.objective,
        plot_legend=rrb.Corner2D.RightTop,
        axis_x=rrb.TimeAxis(
            view_range=rrb.TimeRange(
                start=rrb.TimeRangeBoundary.absolute(seq=first - 1),
                end=rrb.TimeRangeBoundary.absolute(seq=last),
            )
        ),
        # The points appear with their trials.
        time_ranges=rrb.VisibleTimeRanges(
            timeline=TIMELINE,
            start=rrb.TimeRangeBoundary.infinite(),
            end=rrb.TimeRangeBoundary.cursor_relative(),
        ),
        axis_y=rrb.ScalarAxis(range=(-0.05 * top, 1.05 * top)),
    )


#: Differs from that of trials: a viewer keeps one layout per application.
APPLICATION_ID = "hexctl session"


def write_overview_file(path: Path, overview: Overview) -> None:
    """Write an overview atomically, replacing an earlier one.

    Raises InputError without trials or a writable place, RecordingError, and MissingExtraError.
    """
    if not overview.trials:
        raise InputError(f"overview: {overview.title} has no trials; allowed: one or more")
    load_rerun()
    try:
        create_folders(path)
        with replacing(path) as draft:
            create_file(draft)
            with new_recording(draft, APPLICATION_ID, overview.title, make_layout(overview)) as stream:
                _send(stream, overview)
            check_end(draft)
    except HexctlError:
        raise
    except OSError as error:
        raise RecordingError(f"{path}: the overview cannot be written: {error.strerror}") from error


def _send(stream: Any, overview: Overview) -> None:
    send_above(stream, overview)
    _send_scores(stream, overview)
    _send_levels(stream, overview)
    document = load_rerun().TextDocument(make_table(overview), media_type="text/markdown")
    stream.log(TABLE, document, static=True)
