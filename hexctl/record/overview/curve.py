"""The convergence curve: the score of each trial and the best so far, over the trials."""

from typing import Any

import numpy as np

from hexctl.record.overview import paths
from hexctl.record.overview.colors import BEST_COLOR, INVALID_COLOR, TARGET_BANDS, TEXT_COLOR, deviation_color
from hexctl.record.overview.trials import Overview
from hexctl.record.sdk import load_rerun


def score_top_m(overview: Overview) -> float:
    """Return a score above those of all valid trials: where the invalid ones are drawn."""
    scores_m = [trial.score_m for trial in overview.trials if trial.score_m is not None]
    return 1.1 * max([TARGET_BANDS[0][0], *scores_m])


def send_curve(stream: Any, overview: Overview) -> None:
    """Send scores, best so far and targets to a recording stream."""
    _send_scores(stream, overview)
    _send_invalid(stream, overview)
    _send_best_so_far(stream, overview)
    _send_targets(stream, overview)


def _send_scores(stream: Any, overview: Overview) -> None:
    """Send a point per valid trial, in the colour of its trajectory."""
    rr = load_rerun()
    valid = [(trial, trial.score_m) for trial in overview.trials if trial.score_m is not None]
    if not valid:
        return
    look = rr.SeriesPoints(names=["trial"], markers=["circle"], marker_sizes=[4.0])
    stream.log(paths.SCORE, look, static=True)
    colors = [deviation_color(trial.deviation_m, valid=True) for trial, _ in valid]
    columns = [
        *rr.Scalars.columns(scalars=[score_m for _, score_m in valid]),
        *rr.SeriesPoints.columns(colors=np.array(colors, dtype=np.uint8)),
    ]
    stream.send_columns(paths.SCORE, [paths.at([trial.index for trial, _ in valid])], columns)


def _send_invalid(stream: Any, overview: Overview) -> None:
    """Send a cross per invalid trial, above all scores: it ranks behind them."""
    rr = load_rerun()
    indices = [trial.index for trial in overview.trials if trial.score_m is None]
    if not indices:
        return
    look = rr.SeriesPoints(names=["invalid"], markers=["cross"], marker_sizes=[4.0], colors=[INVALID_COLOR])
    stream.log(paths.INVALID, look, static=True)
    scalars = rr.Scalars.columns(scalars=np.full(len(indices), score_top_m(overview)))
    stream.send_columns(paths.INVALID, [paths.at(indices)], scalars)


def _send_best_so_far(stream: Any, overview: Overview) -> None:
    rr = load_rerun()
    pairs = zip(overview.trials, overview.best_so_far(), strict=True)
    known = [(trial.index, best.score_m) for trial, best in pairs if best is not None]
    if not known:
        return
    look = rr.SeriesLines(
        names=["best so far"], colors=[BEST_COLOR], widths=[2.5], interpolation_mode="StepAfter"
    )
    stream.log(paths.BEST_SO_FAR, look, static=True)
    scalars = rr.Scalars.columns(scalars=[score_m for _, score_m in known])
    stream.send_columns(paths.BEST_SO_FAR, [paths.at([index for index, _ in known])], scalars)


def _send_targets(stream: Any, overview: Overview) -> None:
    """Send the targets as lines that grow with the trials."""
    rr = load_rerun()
    for number, (half_width_m, _, name) in enumerate(TARGET_BANDS, start=1):
        path = f"{paths.TARGETS}/{number}"
        look = rr.SeriesLines(names=[name.removeprefix("±")], colors=[TEXT_COLOR], widths=[1.0])
        stream.log(path, look, static=True)
        indices = [trial.index for trial in overview.trials]
        scalars = rr.Scalars.columns(scalars=np.full(len(indices), half_width_m))
        stream.send_columns(path, [paths.at(indices)], scalars)
