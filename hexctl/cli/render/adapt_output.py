"""Sessions as text: the table that grows with each trial, and the final summary."""

import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import fields
from functools import lru_cache
from pathlib import Path
from types import TracebackType
from typing import Self

from rich.console import RenderableType
from rich.text import Text

from hexctl.adapt.objectives import Objective
from hexctl.adapt.optimizer import TRIM_DIGITS
from hexctl.adapt.optimizers.bayes import SURE
from hexctl.adapt.optimizers.shipped import STRIDES, TRIM
from hexctl.adapt.runner import LegFailedError
from hexctl.adapt.search_progress import CONFIRMATION_WALKS, SearchBar
from hexctl.adapt.sessions.comparison import scores_without_search
from hexctl.adapt.sessions.recommendation import (
    Contender,
    contenders,
    recommended,
    straightest_baseline,
)
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
from hexctl.cli.console import FAULT, code_of_stop, print_result
from hexctl.errors import HexctlError, InputError
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.failure_grammar import option_of
from hexctl.robot.loader import load_robot
from hexctl.runs.run_spec import RunSpec


class SessionTable:
    """Prints a line per walk on stdout, and a progress bar with the time left on stderr.

    Silent with `quiet`; the bar is shown only if both are terminals.
    """

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._bar = SearchBar(hidden=True)

    def __enter__(self) -> Self:
        return self  # the bar begins with the table

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.__exit__(kind, error, trace)

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


def session_lines(session: Session) -> list[RenderableType]:
    """Lines of a complete session: its options, its walks, its outcome."""
    return [*table_lines(session), *closing_parts(session, session.ended)]


def pareto_lines(session: Session, objectives: Sequence[Objective]) -> list[str]:
    """Table of the valid trials on the Pareto front of some objectives."""
    front = session.pareto(objectives)
    trials, names = trials_text(len(session.trials)), " and ".join(objective.name for objective in objectives)
    heads = [f"{one.name} ({one.unit})" if one.unit else one.name for one in objectives]
    lines = [
        f"session {session.name}: {len(front)} of {trials} that no other beats in {names}",
        f"trial  code  {'slots':<11}  " + "  ".join(f"{head:>12}" for head in heads),
    ]
    for trial, scores in front:
        slots = ",".join(str(slot) for slot in trial.slots)
        values = "  ".join(
            f"{score:>{max(12, len(head))}.3f}" for score, head in zip(scores, heads, strict=True)
        )
        lines.append(f"{trial.index:>5} {trial.code:>5}  {slots:<11}  {values}")
    return [*lines, *(f"{one.name}: {one.label}, smaller is better" for one in objectives)]


def header_line(session: Session) -> str:
    """Names of the columns."""
    trim = f"{'trim':>9}" if _trims(session.spec) else ""
    trim += f"{'turn':>11}" if trim and session.spec.hold == "none" else ""
    trim += f"{'pace':>9}{'amplitude':>11}{'in air':>8}" if session.spec.optimizer == STRIDES else ""
    score = "" if session.spec.objective == "final" else f"{_score_head(session.spec):>10}"
    return f"walk   gait  {'slots':<11}  {'end':>13}  {'distance':>8}{score}{trim}  status"


def _score_head(spec: SessionSpec) -> str:
    return f"  score {spec.objective_unit}".rstrip()


def _trims(spec: SessionSpec) -> bool:
    return spec.optimizer == TRIM


def opening_lines(session: Session) -> list[str]:
    """Options of a session."""
    spec = session.spec
    believing = f" with the prior {Path(spec.prior).name}" if spec.prior else ""
    lines = [
        f"session {session.name}: {subject(spec)}",
        f"{spec.optimizer}{believing}, {trials_text(spec.budget)} of {spec.duration_s:g} s"
        f"{_hold(spec)}{_objective(spec)}{_target(spec)}",
        *_more_walks(session),
    ]
    if spec.uncertainty_text:
        caveat = f" ({spec.uncertainty_caveat})" if spec.uncertainty_caveat else ""
        lines.append(f"ends are known to ± {in_cm(spec.uncertainty_m)}{caveat}")
    return lines


def _more_walks(session: Session) -> list[str]:
    baseline = len(session.baseline if session.trials else session.spec.baseline_gaits)
    first = [f"first {_walks_text(baseline)} without a search"] if baseline else []
    confirming = session.spec.confirmed_uncertainty_m
    last = [f"last a finer walk to confirm (counts as {CONFIRMATION_WALKS} walks)"] if confirming else []
    return [", ".join(first + last)] if first or last else []


def _walks_text(count: int) -> str:
    return f"{count} walk" + ("" if count == 1 else "s")


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
    end = "-" if signed is None else _side(signed)
    distance = "-" if distance_m is None else f"{distance_m:.2f} m"
    slots = ",".join(str(slot) for slot in walk.slots)
    number = f"{walk.score:.3f}" if walk.valid else "-"
    score = "" if spec.objective == "final" else f"{number:>{max(10, len(_score_head(spec)))}}"
    return (
        f"{index:>4} {gait:>6}  {slots:<11}  {end:<13}  {distance:>8}{score}{_trim(spec, walk)}  "
        f"{_status(walk)}{note}{_cause(walk)}"
    )


def _status(walk: WalkRecord) -> str:
    status, stopped = walk.outcome["status"], walk.outcome.get("stopped")
    return f"cut ({stopped})" if status == "cut_short" and stopped else str(status)


def _trim(spec: SessionSpec, walk: WalkRecord) -> str:
    """Columns of the trim or the stride; empty for a walk without one."""
    if (stride := walk.stride) is not None:
        pace, amplitude = f"{stride.pace_hz:.2f} Hz", f"{100 * stride.amplitude:.1f} %"
        return f"{pace:>9}{amplitude:>11}{100 * stride.swing_share:>6.0f} %"
    if spec.optimizer == STRIDES:
        return f"{'-':>9}{'-':>11}{'-':>8}"
    if not _trims(spec):
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


def _side(signed_m: float) -> str:
    return f"{100 * abs(signed_m):>5.1f} cm {'left' if signed_m > 0 else 'right'}"


ENDS = {
    "budget": "its budget is spent",
    "target": "its target is reached",
    "confirmed": "it is sure of a gait",
    "exhausted": "every gait was tried",
    NOT_WORTH: "another trial would gain too little",
}


def finished_line(spec: SessionSpec, ended: str) -> str | None:
    """Message when a finished session is resumed, and how to walk more trials; None without an end."""
    if ended not in ENDS:
        return None
    asked, failure = option_of(spec.broken)
    options = {
        asked.replace("_", "-"): failure,
        "objective": None if spec.objective == "final" else spec.objective,
        **_where(spec),
        "target": None if spec.target_m is None else f"{spec.target_m / 2:g}",
    }
    again = shlex.join(["hexctl", "adapt", *_as_words(options)])
    more = {"budget": "; a greater --budget walks more", "exhausted": ""}
    then = more.get(ended, f"; another target takes a new session, such as {again}")
    return f"the session is finished, {ENDS[ended]}: nothing to walk{then}"


def after_stop(spec: SessionSpec, error: HexctlError) -> str:
    """Steps for a stop before the search continues, as the beginning of a list; empty for a fault.

    The local guard's stop does not outlast the session.
    """
    reason = getattr(error, "reason", None)
    if reason is None or code_of_stop(reason) == FAULT:
        return ""
    if isinstance(error, LegFailedError):
        legs = ",".join(map(str, sorted({spec.broken.leg, *error.legs})))
        return f"repair the leg, or walk without it (hexctl run --failed-leg {legs}), "
    at = f" --connect {shlex.quote(spec.connect)}" if spec.connect else ""
    at += f" --keys {shlex.quote(str(spec.credentials))}" if spec.credentials else ""
    clear = f"clear the stop (hexctl estop --clear{at}), " if spec.backend == "zenoh" else ""
    return f"stand it up, {clear}" if reason == "fell" else clear


def closing_parts(session: Session, ended: str | None) -> list[RenderableType]:
    """Final summary of a session, a line each, its finding coloured; `ended` is None if it can be resumed."""
    return [
        *finding_parts(session),
        *_less_lines(session),
        _ending(session, ended),
        *_commands(session),
    ]


def finding_parts(session: Session) -> list[RenderableType]:
    """Result of a search, its accuracy, and the baseline, a line each."""
    found = recommended(session)
    known = [Text(line, style="green" if found else "red") for line in _found_lines(session, found)]
    return [*known, *_surety_lines(session, found), *_baseline_lines(session, found)]


def resume_command(session: Session) -> str:
    """Command that continues a session of this user."""
    trust = " --trust" if session.spec.foreign_parts else ""
    return f"hexctl adapt --resume {shlex.quote(session.name)}{trust}"


def _ending(session: Session, ended: str | None) -> str:
    trials = trials_text(len(session.trials))
    if ended in (None, "interrupted"):
        return f"unfinished after {trials}{_others(session)}; continue with: {resume_command(session)}"
    return f"ended after {trials}{_others(session)}: {ENDS.get(ended, ended)}"


def _others(session: Session) -> str:
    count = len(session.baseline)
    others = f" and {count} baseline {'walk' if count == 1 else 'walks'}" if count else ""
    finer = f" and {len(session.confirmations)} to confirm" if session.confirmations else ""
    return f"{others}{finer}, {session.walked_s:.0f} s walked"


def _commands(session: Session) -> list[str]:
    walk, lines = session.best_walk, []
    if walk is not None:
        lines.append(f"walk on with: {_walking(session, walk)}")
    if any(trial.recording for trial in session.trials):
        lines.append(f"look at it with: hexctl view {shlex.quote(session.name)}")
    return lines


def _found_lines(session: Session, found: Contender | None) -> list[str]:
    if not session.trials and found is None:
        return ["found: nothing yet, no trial has been walked"]
    if found is None:
        return [f"found: no valid trial: {_why_none(session)}"]
    walk = found.walk
    name = _name(walk)
    if session.spec.objective != "final":
        return [f"found: {name} {session.spec.score_text(found.score)}"]
    signed = (found.confirmation or walk).outcome["deviation_m"]["signed"]
    return [f"found: {name} ends {_side(signed).strip()} of its line"]


def _name(walk: TrialRecord | BaselineRecord) -> str:
    if isinstance(walk, TrialRecord):
        return f"gait {walk.code}, trial {walk.index},"
    option = _gait_option(walk)
    return f"gait {walk.gait}{'' if option == walk.gait else f' ({option})'}, which needs no search,"


def _surety_lines(session: Session, found: Contender | None) -> list[str]:
    spec, settled = session.spec, session.settled_on
    uncertain = f"accuracy: ± {in_cm(found.uncertainty_m)} by" if found is not None else ""
    match found.confirmation if found is not None else None:
        case ConfirmationRecord(time_step_s=step_s):
            return [f"{uncertain} a walk at a time step of {1000 * step_s:g} ms{_reached(session)}"]
        case TrialRecord() as again:
            return [f"accuracy: repeated in {again.name}{_reached(session)}"]
    if found is not None and spec.uncertainty_text:
        return [f"{uncertain} the simulation's time step{_reached(session)}"]
    if settled is None:
        return []
    chance, target = 100 * settled["chance"], in_cm(settled["target_m"])
    return [f"chance: {chance:.0f} % that gait {settled['code']} ends within {target}"]


def _reached(session: Session) -> str:
    chance, target_m = session.within_target, session.spec.target_m
    if chance is None or target_m is None:
        return ""
    if chance >= SURE:
        return f"; within {in_cm(target_m)}"
    return f"; not within {in_cm(target_m)}" if chance <= 1 - SURE else f"; perhaps within {in_cm(target_m)}"


def _baseline_lines(session: Session, found: Contender | None) -> list[str]:
    if not session.baseline:
        return []
    known = scores_without_search(session)
    unit, scale = ("cm", 100.0) if session.spec.objective_unit == "m" else (session.spec.objective_unit, 1.0)
    ends = (
        f"{scale * known.get(walk.gait, walk.score):.1f}" if walk.valid else _status(walk)
        for walk in session.baseline
    )
    unit = unit if any(walk.valid for walk in session.baseline) else ""
    walks = [f"{walk.gait} {end}" for walk, end in zip(session.baseline, ends, strict=True)]
    return [f"without a search: {', '.join(walks)} {unit}".rstrip() + _gain(session, found, scale, unit)]


def _gain(session: Session, found: Contender | None, scale: float, unit: str) -> str:
    best = straightest_baseline(session)
    if found is None or best is None:
        return ""
    if found.searched:
        return f"; the search gains {scale * (best.score - found.score):.1f} {unit}".rstrip()
    trials = [one for one in contenders(session) if one.searched and one.score < found.score]
    if trials:
        trial = trials[0]
        return f"; not distinguishable from {trial.walk.name}, {scale * trial.score:.1f} {unit}".rstrip()
    return "; the search found none better"


def _less_lines(session: Session) -> list[str]:
    """Why walks held less than possible, and how a trim works without a yaw."""
    caveats = dict.fromkeys(trial.outcome.get("hold_caveat") for trial in session.trials)
    lines = [f"walks held less than {session.spec.hold}: {caveat}" for caveat in caveats if caveat]
    if lines and session.spec.optimizer == TRIM:
        lines[-1] += "; without a yaw, --hold none learns a turn from the paths"
    return lines


def _gait_option(walk: TrialRecord | BaselineRecord) -> str:
    """Name of a fixed gait, else its code or slots, because `auto` depends on hold and turn."""
    if isinstance(walk, BaselineRecord) and walk.gait in NAMED_SLOTS:
        return walk.gait
    return ",".join(map(str, walk.slots)) if walk.code is None else str(walk.code)


def _walking(session: Session, walk: TrialRecord | BaselineRecord) -> str:
    spec = session.spec
    asked, failure = option_of(spec.broken)
    chosen = {
        asked.replace("_", "-"): failure,
        "gait": _gait_option(walk) if walk.stride is None else f"best:{session.name}",
        **_course_options(session, walk),
    }
    options = {
        **chosen,
        "body-raise": f"{spec.body_raise:g}" if spec.body_raise and walk.stride is None else None,
        "self-rotation": spec.self_rotation,
        **_where(spec),
    }
    return shlex.join(["hexctl", "run", *_as_words(options), *(["--insecure"] if spec.insecure else [])])


def _where(spec: SessionSpec) -> dict[str, object]:
    """Options of robot, world and connection that differ from their defaults."""
    usual = {field.name: field.default for field in fields(SessionSpec)}
    names = ("backend", "robot", "world", "seed", "connect", "link")
    unusual = {name: getattr(spec, name) for name in names if getattr(spec, name) != usual[name]}
    return {**unusual, "keys": spec.credentials}


def _as_words(options: Mapping[str, object]) -> list[str]:
    given = ((f"--{name}", str(value)) for name, value in options.items() if value is not None)
    return [word for pair in given for word in pair]


def _course_options(session: Session, walk: WalkRecord) -> dict[str, str]:
    """Hold, heading and trim of a walk, which are rounded to what is printed here."""
    heading, hold = f"{math.degrees(session.spec.heading_rad):g}", session.spec.hold
    trim_deg, turn_deg_s = (walk.outcome[name] for name in ("trim_deg", "turn_trim_deg_s"))
    options: dict[str, str] = {} if hold == RunSpec().hold else {"hold": hold}
    if trim_deg is not None:
        options |= {"trim": f"{trim_deg:.{TRIM_DIGITS}f}"}
    if turn_deg_s is not None:
        options |= {"turn-trim": f"{turn_deg_s:.{TRIM_DIGITS}f}"}
    return options if heading == "0" else {**options, "heading": heading}


def _why_none(session: Session) -> str:
    return ", ".join(dict.fromkeys(_status(trial) for trial in session.trials))
