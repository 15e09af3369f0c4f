"""The steps of a search in a session's overview: its expectation for every gait, and its choice."""

from typing import Any

import numpy as np

from hexctl.palette import (
    AXIS_COLOR,
    BACKGROUND,
    BEST_COLOR,
    LINE_COLOR,
    WAY_COLOR,
    baseline_color,
    deviation_color,
)
from hexctl.recording.rrd import load_rerun
from hexctl.recording.sessions.drawing import THIN, draw, draw_names
from hexctl.recording.sessions.session_overview import GaitBeliefs, Overview, SearchStep, mark_text
from hexctl.types import FloatArray

BELIEF = "belief"
AXES = "belief/axes"
INTERVALS = "belief/intervals"
EXPECTED = "belief/expected"
WALKED = "belief/walked"
NEXT = "belief/next"
STEPS = "steps"

#: Below this deviation the scale is about linear, above it logarithmic; it is clipped at `FAR_M`.
LINEAR_M, FAR_M = 0.1, 4.0

#: Height of the picture above the line, in gaits, which are one unit apart.
HEIGHT = 17.0

#: Deviations with a line and a name, and gaits with a name.
NAMED_M, NAMED_GAITS = (0.1, 0.5, 3.0), 20

#: Widths and sizes like `THIN`.
STRONG, DOT, MARK = -1.25, -2.0, -4.5

#: Draw order: higher covers lower.
AXIS_ORDER, WALKED_ORDER = 0, 20


def height(deviation_m: FloatArray | float) -> FloatArray:
    """Vertical coordinate of a signed deviation: y is downward, left of the line is up."""
    near_m = np.clip(deviation_m, -FAR_M, FAR_M)
    return np.asarray(-HEIGHT * np.arcsinh(near_m / LINEAR_M) / np.arcsinh(FAR_M / LINEAR_M))


def send_steps(stream: Any, overview: Overview) -> None:
    """Send the steps of a search to a recording stream, with beliefs if there are any."""
    rr = load_rerun()
    for step in overview.steps:
        draw(stream, STEPS, rr.TextDocument(step.note, media_type="text/markdown"), step.trials)
    believed = [(step, step.beliefs) for step in overview.steps if step.beliefs is not None]
    if not believed:
        return
    _send_axes(stream, len(believed[0][1].signed_m))
    _send_baseline(stream, overview)
    for step, beliefs in believed:
        _send_beliefs(stream, step, beliefs)
        _send_walked(stream, step, overview)
        _send_next(stream, step, beliefs)
    for step in overview.steps[believed[-1][0].trials + 1 :][:1]:
        _clear(stream, step, INTERVALS, EXPECTED, WALKED, NEXT, f"{NEXT}/name")


def _clear(stream: Any, step: SearchStep, *paths: str) -> None:
    rr = load_rerun()
    for path in paths:
        nothing = rr.LineStrips2D([]) if path in (INTERVALS, NEXT) else rr.Points2D(np.zeros((0, 2)))
        draw(stream, path, nothing, step.trials)


def _send_axes(stream: Any, gaits: int) -> None:
    rr = load_rerun()
    marks_m = [sign * mark for mark in NAMED_M for sign in (-1, 1)]
    lines = [[(0.0, height(mark)), (gaits + 1.0, height(mark))] for mark in (*marks_m, 0.0)]
    colors = [AXIS_COLOR] * len(marks_m) + [LINE_COLOR]
    draw(stream, AXES, rr.LineStrips2D(lines, colors=colors, radii=[THIN], draw_order=AXIS_ORDER))
    names: list[tuple[Any, str]] = [
        ((-4.0, height(mark) - 1.5), f"{'-' if mark < 0 else '+'}{mark_text(abs(mark))}") for mark in marks_m
    ]
    names += [((code, HEIGHT), f"gait {code}") for code in range(NAMED_GAITS, gaits + 1, NAMED_GAITS)]
    draw_names(stream, f"{AXES}/names", names)


def _send_baseline(stream: Any, overview: Overview) -> None:
    """Send the ends of walks outside the search whose gait has a code."""
    for walk in overview.baseline:
        if walk.code and walk.deviation_m is not None:
            path, place = f"{BELIEF}/baseline/{walk.gait}", (walk.code, height(walk.deviation_m))
            look = {"radii": [MARK], "colors": [baseline_color(walk.gait or "")], "draw_order": WALKED_ORDER}
            draw(stream, path, load_rerun().Points2D([place], **look))
            draw_names(stream, f"{path}/name", [(place, str(walk.gait))])


def _send_beliefs(stream: Any, step: SearchStep, beliefs: GaitBeliefs) -> None:
    rr, codes = load_rerun(), np.arange(1.0, len(beliefs.signed_m) + 1)
    low, dots, high = (
        np.column_stack([codes, height(end_m)]) for end_m in (beliefs.low_m, beliefs.signed_m, beliefs.high_m)
    )
    colors = [deviation_color(float(off_m), valid=True) for off_m in beliefs.signed_m]
    intervals = rr.LineStrips2D(np.stack([low, high], axis=1), colors=colors, radii=[THIN])
    draw(stream, INTERVALS, intervals, step.trials)
    draw(stream, EXPECTED, rr.Points2D(dots, colors=colors, radii=[DOT]), step.trials)


def _send_walked(stream: Any, step: SearchStep, overview: Overview) -> None:
    ended = [
        (trial.code, height(trial.deviation_m))
        for trial in overview.trials
        if trial.index <= step.trials and trial.deviation_m is not None
    ]
    if ended:
        draw(stream, WALKED, load_rerun().Points2D(ended, colors=[BEST_COLOR], radii=[MARK]), step.trials)


def _send_next(stream: Any, step: SearchStep, beliefs: GaitBeliefs) -> None:
    code = step.next_code
    if code is None:
        _clear(stream, step, NEXT, f"{NEXT}/name")
        return
    interval = [(code, height(ends_m[code - 1])) for ends_m in (beliefs.low_m, beliefs.high_m)]
    draw(stream, NEXT, load_rerun().LineStrips2D([interval], colors=[WAY_COLOR], radii=[STRONG]), step.trials)
    draw_names(stream, f"{NEXT}/name", [((code, -HEIGHT - 1.0), f"next: gait {code}")], step.trials)


def belief_view(overview: Overview) -> Any | None:
    """View of the beliefs, or None."""
    rrb = load_rerun().blueprint
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
        overrides={path: rrb.EntityBehavior(interactive=False) for path in (AXES, f"{AXES}/names")},
    )
