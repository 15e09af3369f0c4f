"""The summary at the end of a session: what it found, how sure that is, why it ended, and what to do next."""

import math
import shlex
from collections.abc import Mapping
from dataclasses import fields

from rich.console import RenderableType
from rich.text import Text

from hexctl.adapt.optimizer import TRIM_DIGITS
from hexctl.adapt.optimizers.bayes import SURE
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.runner import LegFailedError
from hexctl.adapt.sessions.comparison import scores_without_search
from hexctl.adapt.sessions.search_session import Contender, Session, trials_text
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, ConfirmationRecord, TrialRecord, WalkRecord
from hexctl.adapt.trial_loop import NOT_WORTH
from hexctl.cli.console import FAULT, code_of_stop
from hexctl.cli.render.session_tables import in_cm, side_text, status_text, table_lines
from hexctl.control.telemetry_watch import hot_servos
from hexctl.errors import HexctlError
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.options import options_of
from hexctl.robot.failure_grammar import option_of
from hexctl.runs.run_spec import RunSpec


def session_lines(session: Session) -> list[RenderableType]:
    """Lines of a complete session: its options, its walks, its outcome."""
    return [*table_lines(session), *closing_parts(session, session.ended)]


#: Why a search ended, in words.
ENDS = {
    "budget": "its budget is spent",
    "target": "a trial reached its target",
    "confirmed": "it is sure of a gait",
    "exhausted": "every gait was tried",
    NOT_WORTH: "another trial would gain too little",
}


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
    found = session.recommended
    known = [Text(line, style="green" if found else "red") for line in _found_lines(session, found)]
    return [*known, *_surety_lines(session, found), *_baseline_lines(session, found)]


def _ending(session: Session, ended: str | None) -> str:
    trials = trials_text(len(session.trials))
    if ended in (None, "interrupted"):
        return f"unfinished after {trials}{_others(session)}; continue with: {resume_command(session)}"
    return f"ended after {trials}{_others(session)}: {ENDS.get(ended, ended)}"


def finished_line(ended: str) -> str | None:
    """Message when a finished session is resumed, and how to walk more trials; None without an end."""
    if ended not in ENDS:
        return None
    more = {"budget": "; a greater --budget walks more", "exhausted": ""}
    then = more.get(ended, "; for another --target, begin a new session")
    return f"the session is finished, {ENDS[ended]}: nothing to walk{then}"


def _others(session: Session) -> str:
    count = len(session.baseline)
    others = f" and {count} baseline {'walk' if count == 1 else 'walks'}" if count else ""
    finer = f" and {len(session.confirmations)} to confirm" if session.confirmations else ""
    return f"{others}{finer}, {session.walked_s:.0f} s walked"


def _commands(session: Session) -> list[str]:
    walk, lines = session.best_walk, []
    if walk is not None:
        lines.append(f"walk on with: {walk_command(session, walk)}")
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
    return [f"found: {name} ends {side_text(signed).strip()} of its line"]


def _name(walk: TrialRecord | BaselineRecord) -> str:
    if isinstance(walk, TrialRecord):
        return f"gait {walk.code}, trial {walk.index},"
    option = gait_option(walk)
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
    valid = [
        f"{walk.gait} {scale * known.get(walk.gait, walk.score):.1f}"
        for walk in session.baseline
        if walk.valid
    ]
    others = [f"{walk.gait} {status_text(walk)}" for walk in session.baseline if not walk.valid]
    walks = [*([f"{', '.join(valid)} {unit}".rstrip()] if valid else []), *others]
    return [f"without a search: {', '.join(walks)}" + _gain(session, found, scale, unit)]


def _gain(session: Session, found: Contender | None, scale: float, unit: str) -> str:
    best = session.straightest_baseline
    if found is None or best is None:
        return ""
    if found.searched:
        return f"; the search gains {scale * (best.score - found.score):.1f} {unit}".rstrip()
    trials = [one for one in session.contenders() if one.searched and one.score < found.score]
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


def _why_none(session: Session) -> str:
    return ", ".join(dict.fromkeys(status_text(trial) for trial in session.trials))


def resume_command(session: Session) -> str:
    """Command that continues a session of this user."""
    trust = " --trust" if session.spec.foreign_parts else ""
    return f"hexctl adapt --resume {shlex.quote(session.name)}{trust}"


def after_stop(spec: SessionSpec, error: HexctlError) -> str:
    """Steps for a stop before the search continues, as the beginning of a list; empty for a fault.

    The local guard's stop does not outlast the session.
    """
    reason = getattr(error, "reason", None)
    if reason is None or code_of_stop(reason) == FAULT:
        return ""
    if isinstance(error, LegFailedError) and hot_servos(reason):
        return "let its servo cool down, "
    if isinstance(error, LegFailedError):
        legs = ",".join(map(str, sorted({spec.broken.leg, *error.legs})))
        return f"repair the leg, or walk without it (hexctl run --failed-leg {legs}), "
    at = f" --connect {shlex.quote(spec.connect)}" if spec.connect else ""
    at += f" --keys {shlex.quote(str(spec.credentials))}" if spec.credentials else ""
    clear = f"clear the stop (hexctl estop --clear{at}), " if spec.backend == "zenoh" else ""
    return f"stand it up, {clear}" if reason == "fell" else clear


def gait_option(walk: TrialRecord | BaselineRecord) -> str:
    """Name of a fixed gait, else its code or slots, because `auto` depends on hold and turn."""
    if isinstance(walk, BaselineRecord) and walk.gait in NAMED_SLOTS:
        return walk.gait
    return ",".join(map(str, walk.slots)) if walk.code is None else str(walk.code)


def walk_command(session: Session, walk: TrialRecord | BaselineRecord) -> str:
    """Command that walks as a trial did."""
    spec = session.spec
    asked, failure = option_of(spec.broken)
    options = {
        asked.replace("_", "-"): failure,
        "gait": gait_option(walk) if walk.stride is None else f"best:{session.name}",
        **_course_options(session, walk),
        "body-raise": spec.body_raise or None if walk.stride is None else None,
        **_walk_options(spec),
        "self-rotation": spec.self_rotation,
    }
    return shlex.join(["hexctl", "run", *_as_words(options)])


def _walk_options(spec: SessionSpec) -> dict[str, object]:
    """Options of both `hexctl run` and `hexctl adapt`, if they are no defaults, without the failure."""
    usual = {field.name: field.default for field in fields(SessionSpec)}
    shared = {
        option.flag: getattr(spec, option.name)
        for option in options_of(RunSpec)
        if getattr(spec, option.name, option.default) not in (option.default, usual.get(option.name))
        and option.name not in ("failure", "body_raise")
    }
    if "heading" in shared:
        shared["heading"] = math.degrees(spec.heading_rad)
    return shared


def _as_words(options: Mapping[str, object]) -> list[str]:
    words = []
    for name, value in options.items():
        text = f"{value:g}" if isinstance(value, float) else str(value)
        words += [] if value is None else [f"--{name}"] if value is True else [f"--{name}", text]
    return words


def _course_options(session: Session, walk: WalkRecord) -> dict[str, str | None]:
    """Hold and trim of a walk, which are rounded to what is printed here."""
    hold = session.spec.hold
    options: dict[str, str | None] = {"hold": None if hold == RunSpec().hold else hold}
    for name, outcome in (("trim", "trim_deg"), ("turn-trim", "turn_trim_deg_s")):
        value = walk.outcome[outcome]
        options[name] = None if value is None else f"{value:.{TRIM_DIGITS}f}"
    return options
