"""The table of a session, a line for each walk; and tables of all sessions, and of a comparison."""

import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Any, Self

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from hexctl.adapt.objectives import Objective
from hexctl.adapt.optimizers.shipped import STRIDES, TRIM
from hexctl.adapt.search_progress import CONFIRMATION_WALKS, SearchBar
from hexctl.adapt.sessions.comparison import best_so_far, scores_without_search
from hexctl.adapt.sessions.search_session import Session, trials_text
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import (
    BASELINE_INDEX,
    BaselineRecord,
    ConfirmationRecord,
    TrialRecord,
    WalkRecord,
)
from hexctl.adapt.trial_loop import NOT_WORTH
from hexctl.cli.console import print_result
from hexctl.cli.render.tables import plain_table
from hexctl.errors import InputError
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.loader import load_robot


class SessionTable:
    """Prints a line per walk on stdout, and a progress bar with the time left on stderr.

    Silent with `quiet`; the bar is shown only if both are terminals.
    """

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._bar = SearchBar(hidden=True)

    def __enter__(self) -> Self:
        return self  # the bar begins with the table

    def __exit__(self, *error: Any) -> None:
        self._bar.__exit__(*error)

    def begin(self, session: Session) -> None:
        """Print the head of the table and the walks of a resumed session, and open the bar."""
        if self._quiet:
            return
        print_result(*table_lines(session))
        # A bar and a question would overwrite each other.
        self._bar = SearchBar(hidden=session.spec.ask or not sys.stdout.isatty())
        self._bar.begin(session)

    def add(self, session: Session, walk: Walk) -> None:
        """Print a walk and move the bar."""
        if self._quiet:
            return
        self._bar.advance(session)
        line = walk_line(session, walk)
        if self._bar.shown:
            self._bar.print_above(line)
        else:
            print_result(line)


def table_lines(session: Session) -> list[RenderableType]:
    """Options of a session and all its walks, a line each."""
    return [
        *opening_lines(session),
        Text(header_line(session), style="bold"),
        *(walk_line(session, walk) for walk in session.baseline),
        *(walk_line(session, walk) for walk in session.trials),
        *(walk_line(session, walk) for walk in session.confirmations),
    ]


def pareto_parts(session: Session, objectives: Sequence[Objective]) -> list[RenderableType]:
    """Table of the valid trials on the Pareto front of some objectives."""
    front = session.pareto(objectives)
    trials, names = trials_text(len(session.trials)), " and ".join(objective.name for objective in objectives)
    heads = (f"{one.name} ({one.unit})" if one.unit else one.name for one in objectives)
    table = plain_table("trial", "code", "slots", *heads)
    for trial, scores in front:
        slots = ",".join(map(str, trial.slots))
        table.add_row(str(trial.index), str(trial.code), slots, *(f"{score:.3f}" for score in scores))
    head = f"session {session.name}: {len(front)} of {trials} that no other beats in {names}"
    return [head, table, *(f"{one.name}: {one.label}, smaller is better" for one in objectives)]


def header_line(session: Session) -> str:
    """Names of the columns."""
    trim = f"{'trim':>9}" if session.spec.optimizer == TRIM else ""
    trim += f"{'turn':>11}" if trim and session.spec.hold == "none" else ""
    trim += f"{'pace':>9}{'amplitude':>11}{'in air':>8}" if session.spec.optimizer == STRIDES else ""
    score = "" if session.spec.objective == "final" else f"{_score_head(session.spec):>10}"
    return f"walk   gait  {'slots':<11}  {'end':>13}  {'distance':>8}{score}{trim}  status"


def _score_head(spec: SessionSpec) -> str:
    return f"  score {spec.objective_unit}".rstrip()


def opening_lines(session: Session) -> list[str]:
    """Options of a session."""
    spec = session.spec
    believing = f" with the prior {Path(spec.prior).name}" if spec.prior else ""
    lines = [
        f"session {session.name}: {subject(spec)}",
        f"{spec.optimizer}{believing}, up to {trials_text(spec.budget)} of {spec.duration_s:g} s"
        f"{_hold(spec)}{_objective(spec)}{_target(spec)}",
        *_more_walks(session),
    ]
    if spec.uncertainty_text:
        caveat = f" ({spec.uncertainty_caveat})" if spec.uncertainty_caveat else ""
        lines.append(f"ends are known to ± {in_cm(spec.uncertainty_m)}{caveat}")
    return lines


def _more_walks(session: Session) -> list[str]:
    baseline = len(session.baseline if session.trials else session.spec.baseline_gaits)
    walks = "walk" if baseline == 1 else "walks"
    first = f"first {baseline} baseline {walks}: not part of --budget; only a trial ends the search"
    last = f"last a finer walk to confirm (counts as {CONFIRMATION_WALKS} walks)"
    return [first] * bool(baseline) + [last] * bool(session.spec.confirmed_uncertainty_m)


def _target(spec: SessionSpec) -> str:
    told = spec.target_m is not None and (spec.target_share is not None or spec.objective_unit != "m")
    return f", target {spec.target_text}" if told else ""


def subject(spec: SessionSpec) -> str:
    """Robot, world or backend, and failure."""
    where = f"in {spec.world}" if spec.world is not None else f"over {spec.backend}"
    return f"{robot_name(spec.robot)} {where}, leg {spec.broken.leg} {spec.broken}"


def _hold(spec: SessionSpec) -> str:
    return "" if spec.hold == "none" else f", hold {spec.hold}"


def _objective(spec: SessionSpec) -> str:
    return "" if spec.objective == "final" else f", best by the objective {spec.objective}"


@lru_cache
def robot_name(file: str) -> str:
    """Name of a robot, or of its file if that no longer exists."""
    try:
        return load_robot(file).name
    except InputError:
        return Path(file).stem


def walk_line(session: Session, walk: Walk) -> Text:
    """Table line of a walk."""
    if isinstance(walk, TrialRecord):
        return _trial_line(session, walk)
    if isinstance(walk, BaselineRecord):
        return _baseline_line(session, walk)
    return _confirmation_line(session, walk)


def _trial_line(session: Session, trial: TrialRecord) -> Text:
    """Table line of a trial; green if it is the best so far, red if it is invalid."""
    before = [one for one in session.trials if one.index < trial.index]
    again = any(other.commanded == trial.commanded for other in before)
    note = ", repeat" if again and not session.spec.count_repeats else ""
    best = trial.valid and all(trial.score < other.score for other in before)
    style = "green" if best else "" if trial.valid else "red"
    return Text(_walk_text(session.spec, trial, f"{trial.index}", f"{trial.code}", note), style=style)


def _baseline_line(session: Session, walk: BaselineRecord) -> Text:
    """Table line of a walk of the baseline, trial 0."""
    return Text(
        _walk_text(session.spec, walk, f"{BASELINE_INDEX}", walk.gait), style="" if walk.valid else "red"
    )


def _confirmation_line(session: Session, walk: ConfirmationRecord) -> Text:
    """Line of a walk at a finer time step."""
    named = (gait for gait, slots in NAMED_SLOTS.items() if walk.code is None and slots == walk.slots)
    name = next(named, "-" if walk.code is None else f"{walk.code}")
    note = f" at {1000 * walk.time_step_s:g} ms"
    return Text(_walk_text(session.spec, walk, "", name, note), style="cyan" if walk.valid else "red")


def _walk_text(spec: SessionSpec, walk: WalkRecord, index: str, gait: str, note: str = "") -> str:
    signed, distance_m = walk.outcome["deviation_m"]["signed"], walk.outcome["distance_m"]
    end = "-" if signed is None else side_text(signed)
    distance = "-" if distance_m is None else f"{distance_m:.2f} m"
    slots = ",".join(str(slot) for slot in walk.slots)
    number = f"{walk.score:.3f}" if walk.valid else "-"
    score = "" if spec.objective == "final" else f"{number:>{max(10, len(_score_head(spec)))}}"
    return (
        f"{index:>4} {gait:>6}  {slots:<11}  {end:<13}  {distance:>8}{score}{_trim(spec, walk)}  "
        f"{status_text(walk)}{note}{_cause(walk)}"
    )


def status_text(walk: WalkRecord) -> str:
    """Status of a walk, and why it was cut short."""
    status, stopped = walk.outcome["status"], walk.outcome.get("stopped")
    return f"cut ({stopped})" if status == "cut_short" and stopped else str(status)


def _trim(spec: SessionSpec, walk: WalkRecord) -> str:
    """Columns of the trim or the stride; empty for a walk without one."""
    if (stride := walk.stride) is not None:
        pace, amplitude = f"{stride.pace_hz:.2f} Hz", f"{100 * stride.amplitude:.1f} %"
        return f"{pace:>9}{amplitude:>11}{100 * stride.swing_share:>6.0f} %"
    if spec.optimizer == STRIDES:
        return f"{'-':>9}{'-':>11}{'-':>8}"
    if spec.optimizer != TRIM:
        return ""
    trim_deg, turn_deg_s = (walk.outcome[name] for name in ("trim_deg", "turn_trim_deg_s"))
    course = "-" if trim_deg is None else f"{trim_deg:+.2f}\N{DEGREE SIGN}"
    turn = "-" if turn_deg_s is None else f"{turn_deg_s:+.3f}\N{DEGREE SIGN}/s"
    return f"{course:>9}" + (f"{turn:>11}" if spec.hold == "none" else "")


def _cause(walk: WalkRecord) -> str:
    cause = walk.outcome.get("cause")
    return "" if cause is None else f": {cause}"


def in_cm(length_m: float) -> str:
    """A length in centimetres, to a millimetre."""
    return f"{100 * length_m:.1f} cm"


def side_text(signed_m: float) -> str:
    """A distance from the line, and its side."""
    return f"{100 * abs(signed_m):>5.1f} cm {'left' if signed_m > 0 else 'right'}"


#: Short texts of the ends of a search.
ENDED = {"exhausted": "all tried", NOT_WORTH: "no gain"}


def sessions_table(sessions: Sequence[Session]) -> Table:
    """Sessions, a row each, in 80 columns: subject, recommended gait, and end of the search."""
    table = plain_table("session", "robot", "world", "failure", "trials", "found", "end")
    table.padding = (0, 1, 0, 0)
    for column in table.columns[1:4]:
        column.no_wrap, column.overflow = False, "fold"
    for column in table.columns[1:4] + table.columns[5:]:
        column.justify = "left"
    for session in sessions:
        spec = session.spec
        table.add_row(
            session.name,
            robot_name(spec.robot),
            spec.world or spec.backend,
            str(spec.broken),
            f"{len(session.trials)}/{spec.budget}",
            _found(session),
            "unfinished" if session.ended is None else ENDED.get(session.ended, session.ended),
        )
    return table


#: Numbers of trials with a row, in addition to the last one.
ROWS = (1, 2, 3, 5, 10, 20, 30, 50, 100, 200, 500, 1000)


def comparison_table(sessions: Sequence[Session]) -> Table:
    """Scores of sessions, a column each: baseline, best by number of trials, result."""
    table = plain_table("trials", *(session.name for session in sessions))
    for column in table.columns[1:]:
        column.no_wrap, column.overflow = False, "fold"
    known = [scores_without_search(session) for session in sessions]
    for gait in dict.fromkeys(gait for scores in known for gait in scores):
        cells = (_score(session, scores.get(gait)) for session, scores in zip(sessions, known, strict=True))
        table.add_row(f"0: {gait}", *cells)
    bests = [best_so_far(session) for session in sessions]
    last = max(len(best) for best in bests)
    for count in [*(count for count in ROWS if count < last), last]:
        cells = (
            "-" if count > len(best) else _score(session, best[count - 1])
            for session, best in zip(sessions, bests, strict=True)
        )
        table.add_row(f"best of {count}", *cells)
    table.add_row("found", *map(_found, sessions))
    return table


def _found(session: Session) -> str:
    found = session.recommended
    if found is None:
        return "-"
    walk = found.walk
    name = walk.gait if isinstance(walk, BaselineRecord) else f"{walk.code}"
    return f"{name} {_score(session, found.score)}"


def _score(session: Session, score: float | None) -> str:
    if score is None:
        return "-"
    return in_cm(score) if session.spec.objective_unit == "m" else session.spec.score_text(score)
