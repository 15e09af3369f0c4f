"""The steps of a search in a session's overview: its expectation for every gait, and its choice."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.palette import (
    AXIS_COLOR,
    BACKGROUND,
    BEST_COLOR,
    LINE_COLOR,
    TEXT_COLOR,
    WAY_COLOR,
    baseline_color,
    deviation_color,
)
from hexctl.recording.rrd import load_rerun
from hexctl.recording.sessions.session_overview import GaitBeliefs, Overview, SearchStep, mark_text
from hexctl.types import FloatArray

#: The timeline of an overview: the number of trials.
TIMELINE = "trial"

BELIEF = "belief"
AXES = "belief/axes"
INTERVALS = "belief/intervals"
EXPECTED = "belief/expected"
WALKED = "belief/walked"
NEXT = "belief/next"
NOT_TOLD = "belief/not_told"
STEPS = "steps"

SCENERY = (AXES, f"{AXES}/names")

#: Below this deviation the scale is about linear, above it logarithmic; it is clipped at `FAR_M`.
LINEAR_M, FAR_M = 0.1, 4.0

#: Height of the picture above the line, in gaits, which are one unit apart.
HEIGHT = 17.0

#: Deviations with a line and a name, and gaits with a name.
NAMED_M, NAMED_GAITS = (0.1, 0.5, 3.0), 20

#: Radii in points of the screen, which Rerun marks by a negative sign.
THIN, STRONG, DOT, MARK = -0.5, -1.25, -2.0, -4.5

#: Draw order: higher covers lower.
AXIS_ORDER, BELIEF_ORDER, WALKED_ORDER, NEXT_ORDER = range(0, 40, 10)


def height(deviation_m: FloatArray | float) -> FloatArray:
    """Vertical coordinate of a signed deviation: y is downward, left of the line is up."""
    near_m = np.clip(deviation_m, -FAR_M, FAR_M)
    return np.asarray(-HEIGHT * np.arcsinh(near_m / LINEAR_M) / np.arcsinh(FAR_M / LINEAR_M))


def send_steps(stream: Any, overview: Overview) -> None:
    """Send the steps of a search to a recording stream, with beliefs if there are any."""
    rr = load_rerun()
    for step in overview.steps:
        note = rr.TextDocument.columns(text=[step.note], media_type=["text/markdown"])
        stream.send_columns(STEPS, _at(step), note)
    believed = [(step, step.beliefs) for step in overview.steps if step.beliefs is not None]
    if not believed:
        return
    _send_axes(stream, len(believed[0][1].signed_m))
    _send_not_told(stream, overview)
    for step, beliefs in believed:
        _send_beliefs(stream, step, beliefs)
        _send_walked(stream, step, overview)
        _send_next(stream, step, beliefs)
    _send_end(stream, overview.steps[believed[-1][0].trials + 1 :])


def _send_end(stream: Any, after: Sequence[SearchStep]) -> None:
    for step in after[:1]:
        for path in (INTERVALS, NEXT):
            _clear_lines(stream, path, step)
        for path in (EXPECTED, WALKED, f"{NEXT}/name"):
            _clear_points(stream, path, step)


def _clear_lines(stream: Any, path: str, step: SearchStep) -> None:
    stream.send_columns(path, _at(step), load_rerun().LineStrips2D.columns(strips=[]).partition([0]))


def _clear_points(stream: Any, path: str, step: SearchStep) -> None:
    none = load_rerun().Points2D.columns(positions=np.zeros((0, 2)))
    stream.send_columns(path, _at(step), none.partition([0]))


def _at(step: SearchStep) -> list[Any]:
    return [load_rerun().TimeColumn(TIMELINE, sequence=np.array([step.trials], dtype=np.int64))]


def _send_axes(stream: Any, gaits: int) -> None:
    rr = load_rerun()
    marks_m = [sign * mark for mark in NAMED_M for sign in (-1, 1)]
    lines = [[(0.0, float(height(mark))), (gaits + 1.0, float(height(mark)))] for mark in (*marks_m, 0.0)]
    colors = [AXIS_COLOR] * len(marks_m) + [LINE_COLOR]
    strips = rr.LineStrips2D(lines, colors=colors, radii=[THIN], draw_order=AXIS_ORDER)
    stream.log(AXES, strips, static=True)
    places = [(-4.0, float(height(mark)) - 1.5) for mark in marks_m]
    texts = [f"{'-' if mark < 0 else '+'}{mark_text(abs(mark))}" for mark in marks_m]
    codes = range(NAMED_GAITS, gaits + 1, NAMED_GAITS)
    places += [(float(code), HEIGHT) for code in codes]
    texts += [f"gait {code}" for code in codes]
    names = rr.Points2D(places, radii=[0.0], colors=[TEXT_COLOR], labels=texts, show_labels=True)
    stream.log(f"{AXES}/names", names, static=True)


def _send_not_told(stream: Any, overview: Overview) -> None:
    """Send the ends of walks outside the search whose gait has a code."""
    rr = load_rerun()
    walks = [walk for walk in overview.baseline if walk.code and walk.deviation_m is not None]
    for walk in walks:
        place = [(float(walk.code), float(height(walk.deviation_m or 0.0)))]
        color = baseline_color(walk.gait or "")
        dot = rr.Points2D(place, radii=[MARK], colors=[color], draw_order=WALKED_ORDER)
        stream.log(f"{NOT_TOLD}/{walk.gait}", dot, static=True)
        label = [str(walk.gait)]
        name = rr.Points2D(place, radii=[0.0], colors=[TEXT_COLOR], labels=label, show_labels=True)
        stream.log(f"{NOT_TOLD}/{walk.gait}/name", name, static=True)


def _send_beliefs(stream: Any, step: SearchStep, beliefs: GaitBeliefs) -> None:
    rr, codes = load_rerun(), np.arange(1.0, len(beliefs.signed_m) + 1)
    ends = [np.column_stack([codes, height(ends_m)]) for ends_m in (beliefs.low_m, beliefs.high_m)]
    colors = [deviation_color(float(off_m), valid=True) for off_m in beliefs.signed_m]
    strips = rr.LineStrips2D.columns(strips=np.stack(ends, axis=1), colors=colors, radii=[THIN] * len(codes))
    stream.send_columns(INTERVALS, _at(step), strips.partition([len(codes)]))
    dots = rr.Points2D.columns(
        positions=np.column_stack([codes, height(beliefs.signed_m)]),
        colors=colors,
        radii=[DOT] * len(codes),
    )
    stream.send_columns(EXPECTED, _at(step), dots.partition([len(codes)]))


def _send_walked(stream: Any, step: SearchStep, overview: Overview) -> None:
    ended = [
        (float(trial.code), float(height(trial.deviation_m)))
        for trial in overview.trials
        if trial.index <= step.trials and trial.deviation_m is not None
    ]
    if ended:
        dots = load_rerun().Points2D.columns(
            positions=np.array(ended), colors=[BEST_COLOR] * len(ended), radii=[MARK] * len(ended)
        )
        stream.send_columns(WALKED, _at(step), dots.partition([len(ended)]))


def _send_next(stream: Any, step: SearchStep, beliefs: GaitBeliefs) -> None:
    rr, code = load_rerun(), step.next_code
    if code is None:
        _clear_lines(stream, NEXT, step)
        _clear_points(stream, f"{NEXT}/name", step)
        return
    ends_m = np.array([beliefs.low_m[code - 1], beliefs.high_m[code - 1]])
    interval = np.column_stack([[code, code], height(ends_m)])
    line = rr.LineStrips2D.columns(strips=[interval], colors=[WAY_COLOR], radii=[STRONG])
    stream.send_columns(NEXT, _at(step), line.partition([1]))
    name = rr.Points2D.columns(
        positions=np.array([[float(code), -HEIGHT - 1.0]]),
        radii=[0.0],
        colors=[TEXT_COLOR],
        labels=[f"next: gait {code}"],
    )
    stream.send_columns(f"{NEXT}/name", _at(step), name.partition([1]))


def belief_view(overview: Overview) -> Any | None:
    """View of the beliefs, or None."""
    import rerun.blueprint as rrb

    beliefs = next((step.beliefs for step in overview.steps if step.beliefs is not None), None)
    if beliefs is None:
        return None
    return rrb.Spatial2DView(
        origin=BELIEF,
        name="predicted end of every gait, 90 % interval",
        background=[*BACKGROUND],
        visual_bounds=rrb.VisualBounds2D(
            x_range=[-9.0, len(beliefs.signed_m) + 3.0], y_range=[-HEIGHT - 3.0, HEIGHT + 6.0]
        ),
        overrides={path: rrb.EntityBehavior(interactive=False) for path in SCENERY},
    )
