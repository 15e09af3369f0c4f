"""Comparison of sessions: the best score so far against the number of trials."""

import io
from collections.abc import Sequence
from itertools import accumulate
from pathlib import Path
from typing import Any

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.walk_records import BaselineRecord
from hexctl.errors import InputError, MissingExtraError, argument
from hexctl.files import write_new

#: What two searches need alike for their scores to be comparable.
SET_UP = ("robot", "world", "failure", "duration_s", "heading_rad", "hold")


def best_so_far(session: Session) -> list[float | None]:
    """Lowest score up to each trial, in the unit of the objective; None before the first valid trial."""
    scores = (trial.score if trial.valid else INVALID_SCORE for trial in session.trials)
    return [score if score < INVALID_SCORE else None for score in accumulate(scores, min)]


def scores_without_search(session: Session) -> dict[str, float]:
    """Valid scores of the gaits that need no search, by name; empty before the first trial."""
    walks = ((found.walk, found.score) for found in session.contenders())
    return {walk.gait: score for walk, score in walks if isinstance(walk, BaselineRecord)}


def check_comparable(sessions: Sequence[Session]) -> None:
    """Raise InputError for fewer than two sessions, different objectives, or a session without trials."""
    if len({session.name for session in sessions}) < 2:
        raise InputError("session: got one to compare; allowed: two or more")
    objectives = sorted({session.spec.objective for session in sessions})
    if len(objectives) > 1:
        raise InputError(
            f"{argument('session')}: got sessions with the objectives {', '.join(objectives)}; "
            "allowed: sessions with one objective"
        )
    for session in sessions:
        if not session.trials:
            raise InputError(f"{argument('session')}: {session.name} has no trials; allowed: one with trials")


def differences(sessions: Sequence[Session]) -> list[str]:
    """Differences between sessions except the search, such as `duration_s (10.0, 30.0)`."""
    found = []
    for name in SET_UP:
        values = dict.fromkeys(_in_words(getattr(session.spec, name)) for session in sessions)
        if len(values) > 1:
            found.append(f"{name} ({', '.join(values)})")
    return found


def _in_words(value: Any) -> str:
    return " and ".join(map(str, value)) or "none" if isinstance(value, tuple) else str(value)


def draw_comparison(sessions: Sequence[Session], path: Path) -> None:
    """Write a new PNG with the best score so far of sessions, a step line each.

    A dotted line shows the best score without a search. Raises InputError for a path that does not end in
    .png, exists or cannot be written; MissingExtraError without matplotlib.
    """
    if path.suffix != ".png":
        raise InputError(f"{argument('out')}: got {path.name}; allowed: a name that ends in .png")
    try:
        from matplotlib.figure import Figure
    except ModuleNotFoundError as error:
        raise MissingExtraError("a plot", "study") from error
    figure = Figure(figsize=(8, 5), layout="constrained")
    _draw(sessions, figure.add_subplot())
    picture = io.BytesIO()
    figure.savefig(picture, format="png", dpi=150)
    write_new(path, picture.getvalue(), argument("out"))


def _draw(sessions: Sequence[Session], axes: Any) -> None:
    spec = sessions[0].spec
    unit, scale = ("cm", 100.0) if spec.objective_unit == "m" else (spec.objective_unit, 1.0)
    for session in sessions:
        scores = [float("nan") if best is None else scale * best for best in best_so_far(session)]
        (line,) = axes.plot(
            range(1, len(scores) + 1), scores, drawstyle="steps-post", marker="o", label=session.name
        )
        if known := scores_without_search(session):
            gait = min(known, key=lambda name: known[name])
            level = {"linestyle": ":", "color": line.get_color(), "label": f"{gait}, without a search"}
            axes.axhline(scale * known[gait], **level)
    axes.set(xlabel="trials", ylabel=f"best {spec.score_label} so far" + (f" ({unit})" if unit else ""))
    axes.xaxis.get_major_locator().set_params(integer=True)
    axes.set_ylim(bottom=0)
    axes.grid(alpha=0.3)
    axes.legend()
