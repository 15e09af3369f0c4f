"""Sessions as text: the table that grows trial by trial, the summary at the end, one line each in a list."""

import math
import shlex
import sys
from collections.abc import Sequence
from functools import lru_cache
from pathlib import Path
from typing import Self

import typer

from hexctl.adapt.loop import NOT_WORTH
from hexctl.adapt.objectives import INVALID_SCORE, Objective
from hexctl.adapt.optimizers.bayes import SURE
from hexctl.adapt.optimizers.shipped import BAYES, TRIM
from hexctl.adapt.runner import LegFailedError
from hexctl.adapt.sessions.session import (
    BASELINE_INDEX,
    MILESTONES_M,
    BaselineRecord,
    Session,
    SessionSpec,
    TrialRecord,
    WalkRecord,
    trials_text,
)
from hexctl.cli.console import FAULT, code_of_stop, make_bar, print_above
from hexctl.cli.progress import WithBar
from hexctl.control.assessment.cause import CAUSES
from hexctl.errors import HexctlError, InputError
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.record.run_spec import RunSpec
from hexctl.robot.loader import load_robot

HEADER = "trial  code  slots        deviation     distance  status        best"
TRIM_HEADER = "      trim"
EXPECTED = "  expected, 9 of 10"

#: Says whose uncertainty a ± is.
BY_ITSELF = "by the simulation's own uncertainty"


class SessionTable(WithBar):
    """Prints a line per trial on stdout, and a progress bar with the time left on stderr.

    Silent when told so; the bar is shown only where both are terminals.
    """

    def __init__(self, *, quiet: bool) -> None:
        self._quiet = quiet
        self._bar = make_bar(quiet=True)

    def __enter__(self) -> Self:
        return self  # the bar begins with the table

    def begin(self, session: Session) -> None:
        """Print the head of the table, the trials that a resumed session has, and open the bar."""
        if self._quiet:
            return
        typer.echo(opening_line(session))
        typer.echo(header_line(session))
        for line in [*map(baseline_line, session.baseline), *_trial_lines(session)]:
            typer.echo(line)
        # A bar and a question would write over one another.
        self._bar = make_bar(quiet=session.spec.ask or not sys.stdout.isatty())
        self._task = self._bar.add_task(
            "trials (Ctrl-C stops, --resume continues)",
            total=session.spec.budget,
            completed=len(session.trials),
        )
        self._bar.start()

    def add(self, session: Session, trial: TrialRecord) -> None:
        """Print a trial and move the bar."""
        if self._quiet:
            return
        print_above(self._bar, trial_line(session, trial), err=False)
        self._bar.update(self._task, completed=len(session.trials))

    def add_baseline(self, session: Session, walk: BaselineRecord) -> None:
        """Print a walk with a gait that the robot would use anyway; it moves no bar."""
        if not self._quiet:
            print_above(self._bar, baseline_line(walk), err=False)


def _trial_lines(session: Session) -> list[str]:
    return [trial_line(session, trial) for trial in session.trials]


def session_lines(session: Session) -> list[str]:
    """Lines of a whole session: its options, its baseline, every trial, its outcome."""
    lines = [*map(baseline_line, session.baseline), *_trial_lines(session)]
    return [opening_line(session), header_line(session), *lines, closing_lines(session, session.ended)]


def pareto_lines(session: Session, objectives: Sequence[Objective]) -> list[str]:
    """Table of the valid trials that no other one beats in all of some objectives."""
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
    trim = TRIM_HEADER if session.spec.hold == "heading" or session.spec.optimizer == TRIM else ""
    return HEADER + trim + (EXPECTED if session.spec.prior and session.spec.hold == "none" else "")


def opening_line(session: Session) -> str:
    """Options of a session."""
    spec = session.spec
    believing = f" with the prior {Path(spec.prior).name}" if spec.prior else ""
    return (
        f"session {session.name}: {subject(spec)}, {spec.optimizer}{believing}, "
        f"{trials_text(spec.budget)} of {spec.duration_s:g} s{_hold(spec)}{_objective(spec)}{_target(spec)}"
        f"{_uncertainty(spec)}"
    )


def _target(spec: SessionSpec) -> str:
    """A target that needs its unit: a share of the distance, in metres too, or one that is not in metres."""
    told = spec.target_m is not None and (spec.target_share is not None or spec.objective_unit != "m")
    return f", target {spec.target_text}" if told else ""


def _uncertainty(spec: SessionSpec) -> str:
    """The ± of all deviations, where it is known."""
    if not spec.uncertainty_text:
        return ""
    return f", deviations ± {spec.uncertainty_text}{_by_itself(spec)}"


def _by_itself(spec: SessionSpec) -> str:
    """Whose uncertainty a ± is, and the walks it was measured on where they are others; empty without one."""
    if not spec.uncertainty_text:
        return ""
    return f" {BY_ITSELF}" + (f" ({spec.uncertainty_caveat})" if spec.uncertainty_caveat else "")


def subject(spec: SessionSpec) -> str:
    """Robot, world or backend, and failure."""
    where = f"in {spec.world}" if spec.world is not None else f"over {spec.backend}"
    return f"{_robot_name(spec.robot)} {where}, leg {spec.failed_leg} {spec.failure}"


def _hold(spec: SessionSpec) -> str:
    """What steered walks hold; empty where they are open loop."""
    return "" if spec.hold == "none" else f", hold {spec.hold}"


def _objective(spec: SessionSpec) -> str:
    return "" if spec.objective == "final" else f", best by the objective {spec.objective}"


@lru_cache
def _robot_name(file: str) -> str:
    """Name of a robot, or of its file where that no longer exists."""
    try:
        return load_robot(file).name
    except InputError:
        return Path(file).stem


def trial_line(session: Session, trial: TrialRecord) -> str:
    """Line of a trial in the table, with the best score up to it."""
    scores = [other.score for other in session.trials[: trial.index] if other.valid]
    best = f"{min(scores):.3f}" if scores else "-"
    before = session.trials[: trial.index - 1]
    again = any((other.code, _trim(other)) == (trial.code, _trim(trial)) for other in before)
    status = _status(trial) + (" (repeat)" if again and not session.spec.count_repeats else "")
    head = f"{trial.index:>5} {trial.code:>5}"
    return f"{head}  {_walk_text(trial, status)} {best:>6}{_trim(trial)}{_expected(trial)}{_cause(trial)}"


def baseline_line(walk: BaselineRecord) -> str:
    """Line of a walk with a gait that the robot would use anyway, trial 0."""
    text = _walk_text(walk, _status(walk))
    return f"{BASELINE_INDEX:>4} {walk.gait:>6}  {text} {'-':>6}{_trim(walk)}{_cause(walk)}"


def _walk_text(walk: WalkRecord, status: str) -> str:
    """Slots, deviation, distance and status, in their columns."""
    signed, distance_m = walk.outcome["deviation_m"]["signed"], walk.outcome["distance_m"]
    deviation = "-" if signed is None else _side(signed)
    distance = "-" if distance_m is None else f"{distance_m:.2f} m"
    slots = ",".join(str(slot) for slot in walk.slots)
    return f"{slots:<11}  {deviation:<12} {distance:>9}  {status:<12}"


def _status(walk: WalkRecord) -> str:
    """Status of a walk, with the reason where it was cut short for something other than its course."""
    status, stopped = walk.outcome["status"], walk.outcome.get("stopped")
    return f"cut ({stopped})" if status == "cut_short" and stopped else str(status)


def _trim(walk: WalkRecord) -> str:
    """Trim of a walk in its column, of its course or its turn; empty for a walk without one."""
    trim_deg, turn_deg_s = (walk.outcome.get(name) for name in ("trim_deg", "turn_trim_deg_s"))
    if turn_deg_s is not None:
        return f"  {turn_deg_s:>+6.3f}\N{DEGREE SIGN}/s"
    return "" if trim_deg is None else f"  {trim_deg:>+6.2f}\N{DEGREE SIGN}"


def _cause(walk: WalkRecord) -> str:
    """Likely cause of a walk without progress; empty without one."""
    cause = walk.outcome.get("cause")
    return "" if cause is None else f"  {cause}: {CAUSES.get(cause, '')}"


def _expected(trial: TrialRecord) -> str:
    """Interval in which the optimizer predicted the trial to end, from right to left; empty without one."""
    if trial.expected is None:
        return ""
    low_m, high_m = trial.expected["low_m"], trial.expected["high_m"]
    return f"  {_side(low_m)} to {_side(high_m)}"


def _side(signed_m: float) -> str:
    return f"{abs(signed_m):.3f} {'left' if signed_m > 0 else 'right'}"


#: Why a search ended, for people.
ENDS = {
    "budget": "its budget is spent",
    "target": "its target is reached",
    "confirmed": "it is sure of a gait",
    "exhausted": "every gait was tried",
    NOT_WORTH: "another trial is not worth it",
}


def end_of(session: Session) -> str:
    """Whether a session has ended, and why, in a few words."""
    if session.ended is None:
        return "unfinished"
    return f"ended: {ENDS.get(session.ended, session.ended)}"


def finished_line(ended: str) -> str | None:
    """What a session that is resumed after its end says, and how it walks more; None without an end."""
    if ended not in ENDS:
        return None
    more = {"budget": "; a greater --budget walks more", "exhausted": ""}
    then = more.get(ended, "; another target takes a new session")
    return f"the session is finished, {ENDS[ended]}: nothing to walk{then}"


def after_stop(spec: SessionSpec, error: HexctlError) -> str:
    """What is to be done about a stop before the search continues, as the beginning of a list.

    Nothing about a fault. This end's own guard starts afresh by itself.
    """
    reason = getattr(error, "reason", None)
    if reason is None or code_of_stop(reason) == FAULT:
        return ""
    if isinstance(error, LegFailedError):
        legs = ",".join(map(str, sorted({spec.failed_leg, *error.legs})))
        return f"mend the leg, or walk without it (hexctl run --failed-leg {legs}), "
    at = f" --connect {spec.connect}" if spec.connect else ""
    at += f" --keys {shlex.quote(str(spec.credentials))}" if spec.credentials else ""
    clear = f"clear the stop (hexctl estop --clear{at}), " if spec.backend == "zenoh" else ""
    return f"stand it up, {clear}" if reason == "fell" else clear


def closing_lines(session: Session, ended: str | None) -> str:
    """Summary at the end of a session; `ended` is None for one that can be resumed."""
    walked = f"after {trials_text(len(session.trials))}, {session.walked_s:.0f} s walked"
    why = "unfinished" if ended is None else f"ended: {ended}"
    lines = [f"{why} {walked}", *_milestone_lines(session), *_baseline_lines(session)]
    lines += [*_surety_lines(session), *_indistinct_lines(session)]
    lines += _less_lines(session)
    if ended in (None, "interrupted"):
        lines.append(f"continue with: hexctl adapt --resume {session.name}")
    walk = session.best_walk
    if walk is not None:
        lines.append(f"walk on with: {_walking(session, walk)}")
    if any(trial.recording for trial in session.trials):
        lines.append(f"look at it with: hexctl view {session.name}")
    return "\n".join(lines)


def _less_lines(session: Session) -> list[str]:
    """Why walks held less than they should have, and what a search for a trim can do without a yaw."""
    caveats = dict.fromkeys(trial.outcome.get("hold_caveat") for trial in session.trials)
    lines = [f"walks held less than {session.spec.hold}: {caveat}" for caveat in caveats if caveat]
    if lines and session.spec.optimizer == TRIM:
        lines[-1] += "; --optimizer trim --hold none learns a turn from the ends alone"
    return lines


def _gait_option(walk: TrialRecord | BaselineRecord) -> str:
    """What `--gait` takes for a walk: the name of a fixed gait, else its code or slots.

    `auto` goes by its code: which gait it is depends on the hold and the turn.
    """
    if isinstance(walk, BaselineRecord) and walk.gait in NAMED_SLOTS:
        return walk.gait
    return ",".join(map(str, walk.slots)) if walk.code is None else str(walk.code)


def _walking(session: Session, walk: TrialRecord | BaselineRecord) -> str:
    """Command that walks with the gait of a walk, and its trim where it has one."""
    spec, usual = session.spec, SessionSpec()
    chosen = {
        "failed-leg": spec.failed_leg,
        "gait": _gait_option(walk),
        **_course_options(session, walk),
    }
    where = ("backend", "robot", "world", "failure", "seed", "connect", "link")
    unusual = {name: getattr(spec, name) for name in where if getattr(spec, name) != getattr(usual, name)}
    options = {
        **chosen,
        "body-raise": f"{spec.body_raise:g}" if spec.body_raise else None,
        "self-rotation": spec.self_rotation,
        **unusual,
        "keys": spec.credentials,
    }
    given = [(f"--{name}", str(value)) for name, value in options.items() if value is not None]
    words = [word for pair in given for word in pair]
    return shlex.join(["hexctl", "run", *words, *(["--insecure"] if spec.insecure else [])])


def _course_options(session: Session, walk: WalkRecord) -> dict[str, str]:
    """Options of the hold and the trim of a gait; a turn with a heading goes with the walk."""
    heading, hold = f"{session.spec.heading_deg:g}", session.spec.hold
    trim_rad, turn_rad_s = session.trim_rad(walk.slots), session.turn_trim_rad_s(walk.slots)
    if turn_rad_s is not None:
        return {"hold": "none", "heading": heading, "turn": f"{math.degrees(turn_rad_s):.3f}"}
    options = {} if hold == RunSpec().hold else {"hold": hold}
    if trim_rad is not None:
        options = {"hold": "heading", "trim": f"{math.degrees(trim_rad):.2f}"}
    return options if heading == "0" else {**options, "heading": heading}


def _baseline_lines(session: Session) -> list[str]:
    """What the gaits that the robot would use anyway made of it."""
    walks = [
        f"{walk.gait} {session.spec.uncertain_text(walk.score) if walk.valid else _status(walk)}"
        for walk in session.baseline
    ]
    return [f"without a search: {', '.join(walks)}{_compared(session)}"] if walks else []


def _compared(session: Session) -> str:
    """Gaits of the baseline that no trial is better than, that the best trial is or cannot be told from."""
    spec, best_m = session.spec, INVALID_SCORE if session.best is None else session.best.score
    valid = [walk for walk in session.baseline if walk.valid and session.trials]
    better = {walk.gait for walk in session.better_baseline}
    unbeaten = [walk.gait for walk in valid if walk.gait in better]
    same = [walk.gait for walk in valid if session.best is not None and walk.slots == session.best.slots]
    alike = [
        walk.gait
        for walk in valid
        if spec.uncertainty_text and walk.gait not in same and not spec.distinct(walk.score, best_m)
    ]
    text = f"; no trial is better than {_listed(unbeaten)}" if unbeaten else ""
    text += f"; the best trial walks the gait {_listed(same)}" if same else ""
    return text + (f"; the best trial is not distinguishable from {_listed(alike)}" if alike else "")


def _listed(names: Sequence[str]) -> str:
    """Names in a sentence: `auto`, `auto and demo`, `auto, demo and tripod`."""
    return " and ".join([", ".join(names[:-1]), names[-1]] if len(names) > 1 else names)


def _surety_lines(session: Session) -> list[str]:
    """Gait that the optimizer settles on, and its probability, where there is one."""
    settled = session.settled_on
    if settled is None:
        return []
    within, sure = f"within {settled['target_m']:g} m", 100 * settled["chance"]
    if sure < 1:
        return [f"no gait is known to end {within}"]
    return [f"sure to {sure:.0f} % that gait {settled['code']} ends {within}"]


def _indistinct_lines(session: Session) -> list[str]:
    """Why no gait can be confirmed, where the simulation is less certain than the target is small."""
    spec, greatest = session.spec, session.spec.greatest_chance
    if not session.trials or spec.optimizer != BAYES or greatest is None or greatest >= SURE:
        return []
    return [
        f"no gait can be confirmed within {spec.target_m:g} m: with the simulation's own uncertainty, "
        f"± {spec.uncertainty_m:.3f} m, even one that ends on the line is within it to "
        f"{100 * greatest:.0f} % only, not {100 * SURE:.0f} %"
    ]


def _why_none(session: Session) -> str:
    """Statuses of the trials of a session without a valid one."""
    return ", ".join(dict.fromkeys(_status(trial) for trial in session.trials))


def _milestone_lines(session: Session) -> list[str]:
    """Best trial, and the number of trials to each milestone."""
    best = session.best
    if not session.trials:
        return ["no valid trial yet: none has been walked"]
    if best is None:
        lines = [f"no valid trial yet: {_why_none(session)}"]
    else:
        slots = ",".join(str(slot) for slot in best.slots)
        score = session.spec.uncertain_text(best.score) + _by_itself(session.spec)
        lines = [f"best: trial {best.index}, code {best.code} (slots {slots}), {score}"]
    for milestone in MILESTONES_M if session.spec.objective_unit == "m" else ():
        reached = session.trials_to(milestone)
        plus_minus = f", ± {session.spec.uncertainty_text}" if session.spec.uncertainty_text else ""
        lines.append(
            f"within {milestone:g} m: "
            + (f"after {trials_text(reached)}{plus_minus}" if reached else "not reached")
        )
    return lines


def session_line(session: Session) -> str:
    """One line on a session: its name, what it searched, how far it came."""
    spec, best = session.spec, session.best
    outcome = f"best {spec.uncertain_text(best.score)} (code {best.code})" if best else "no valid trial"
    return (
        f"{session.name}  {subject(spec)}, {spec.optimizer}, {len(session.trials)} of "
        f"{trials_text(spec.budget)} of {spec.duration_s:g} s, {outcome}; {end_of(session)}"
    )
