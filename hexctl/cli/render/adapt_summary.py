"""The summary at the end of a session: what it found, how sure that is, and why it ended."""

import shlex

from rich.console import RenderableType
from rich.text import Text

from hexctl.adapt.optimizers.bayes import SURE
from hexctl.adapt.optimizers.shipped import TRIM
from hexctl.adapt.sessions.comparison import scores_without_search
from hexctl.adapt.sessions.recommendation import Contender, contenders, recommended, straightest_baseline
from hexctl.adapt.sessions.search_session import Session, trials_text
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.walk_records import BaselineRecord, ConfirmationRecord, TrialRecord
from hexctl.adapt.trial_loop import NOT_WORTH
from hexctl.cli.render.adapt_commands import gait_option, resume_command, stricter_command, walk_command
from hexctl.cli.render.adapt_table import in_cm, side_text, status_text, table_lines


def session_lines(session: Session) -> list[RenderableType]:
    """Lines of a complete session: its options, its walks, its outcome."""
    return [*table_lines(session), *closing_parts(session, session.ended)]


#: Why a search ended, in words.
ENDS = {
    "budget": "its budget is spent",
    "target": "its target is reached",
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
    found = recommended(session)
    known = [Text(line, style="green" if found else "red") for line in _found_lines(session, found)]
    return [*known, *_surety_lines(session, found), *_baseline_lines(session, found)]


def _ending(session: Session, ended: str | None) -> str:
    trials = trials_text(len(session.trials))
    if ended in (None, "interrupted"):
        return f"unfinished after {trials}{_others(session)}; continue with: {resume_command(session)}"
    return f"ended after {trials}{_others(session)}: {ENDS.get(ended, ended)}"


def finished_line(spec: SessionSpec, ended: str) -> str | None:
    """Message when a finished session is resumed, and how to walk more trials; None without an end."""
    if ended not in ENDS:
        return None
    more = {"budget": "; a greater --budget walks more", "exhausted": ""}
    then = more.get(ended, f"; another target takes a new session, such as {stricter_command(spec)}")
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
    ends = (
        f"{scale * known.get(walk.gait, walk.score):.1f}" if walk.valid else status_text(walk)
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


def _why_none(session: Session) -> str:
    return ", ".join(dict.fromkeys(status_text(trial) for trial in session.trials))
