"""Choice of a session's prior: none, the requested one, or the first that fits."""

import shlex
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from hexctl.adapt.optimizers.bayes import REAL_NOISE_M, SIMULATED_NOISE_M
from hexctl.adapt.optimizers.shipped import BAYES, NAMES, TRIM
from hexctl.adapt.prior.prior import KIND, PRIOR_DURATION_S, SCORES, in_whole_steps
from hexctl.adapt.prior.prior_files import check_prior, find_prior, named_prior
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.setting import Note, Setting
from hexctl.errors import InputError, argument

#: The paper's finer deviation: the target of `bayes` unless told otherwise.
DEFAULT_TARGET_M = 0.025


def choose_prior(
    spec: SessionSpec,
    setting: Setting,
    choice: str | None,
    *,
    free: bool,
    folders: list[Path],
    note: Note,
) -> SessionSpec:
    """Spec with its optimizer and prior: `trim`, or `bayes` if a prior is wanted and fits.

    Args:
        spec: of a session, without a prior.
        choice: `auto`, `none`, or the path or name of a prior; None is `auto`.
        free: whether no optimizer was requested; then, and with trim, a missing prior is no error.
        folders: searched for priors, in this order.
        note: called with the reason if a session has no prior.

    Raises InputError for options that contradict one another, and for a prior that does not fit.
    """
    named = choice not in (None, "auto")
    if not _wants_prior(spec, choice, free):
        return spec
    robot, plan = setting.robot, setting.plan
    reason = "" if spec.optimizer == TRIM and spec.hold == "none" else _other_objective(spec)
    if not reason and named:
        path = named_prior(str(choice), folders)
        check_prior(path, robot, plan)
        return _with_prior(spec, path)
    if not reason:
        found = find_prior(robot, plan, folders)
        if found.path is not None:
            return _with_prior(spec, found.path)
        reason = found.reason
    needed, build = spec.optimizer == BAYES and not free, _how_to_build(spec)
    if needed or named or spec.early_stop or spec.worth_m is not None:
        raise InputError(f"{argument('prior')}: there is none for these trials ({reason}){build}")
    if spec.hold == "none" or spec.optimizer != TRIM:
        note(f"no prior for these trials ({reason}); searching with {spec.optimizer} instead{build}")
    return spec


def _how_to_build(spec: SessionSpec) -> str:
    """The command that builds a prior for a session's trials, as the end of a sentence; empty if none can."""
    long_enough = spec.duration_s >= PRIOR_DURATION_S.low and in_whole_steps(spec.duration_s)
    if _other_objective(spec) or spec.heading_rad or not long_enough:
        return ""
    hold = "line" if spec.hold == "auto" else spec.hold
    rotation = "none" if hold == "line" else "rear"
    values = (
        ("robot", spec.robot, "ant"),
        ("failure", str(spec.broken), "locked"),
        ("hold", hold, "none"),
        ("self-rotation", spec.self_rotation, rotation),
        ("duration", f"{spec.duration_s:g}", "30"),
    )
    words = [f" --{flag} {shlex.quote(text)}" for flag, text, usual in values if text != usual]
    return f"; this makes one: hexctl prior build{''.join(words)}"


def _other_objective(spec: SessionSpec) -> str:
    """Why the objective cannot have a prior; empty if it can."""
    steered = spec.hold != "none"
    if spec.objective in (SCORES if steered else ("final",)):
        return ""
    of_steered = f"of steered walks are for {', '.join(SCORES)}"
    if steered:
        return f"priors {of_steered}, not {spec.objective}"
    others = f"; those {of_steered}" if spec.objective in SCORES else ""
    return f"priors are for the objective final, not {spec.objective}, with hold none{others}"


def _wants_prior(spec: SessionSpec, choice: str | None, free: bool) -> bool:
    """Whether to search for a prior; raises InputError for contradicting options."""
    believes = spec.optimizer == BAYES and not free
    repeats = spec.count_repeats and free and choice is None
    wants = (free or believes or spec.optimizer == TRIM) and choice != "none" and not repeats
    refuse(_believing(spec) if wants else _unbelieving(spec, choice, believes))
    return wants


#: Contradictions of options: whether they contradict one another, what was got, and what is allowed instead.
Contradictions = Iterator[tuple[bool, str, str]]


def refuse(contradictions: Contradictions) -> None:
    """Raise InputError for the first contradiction."""
    for contradicts, got, allowed in contradictions:
        if contradicts:
            raise InputError(f"{got}; allowed: {allowed}")


def _unbelieving(spec: SessionSpec, choice: str | None, believes: bool) -> Contradictions:
    """Contradictions of the options of a session without a prior."""
    prior, optimizer, early, worth = map(argument, ("prior", "optimizer", "early_stop", "worth_m"))
    yield believes, f"{prior}: got none with {optimizer} bayes", "auto or a file"
    other = choice not in (None, "none")
    yield other, f"{prior}: got {choice} with {optimizer} {spec.optimizer}", "with trim or bayes"
    stops = spec.early_stop and spec.optimizer in NAMES
    yield stops, f"{early}: used without a prior", "with bayes and a prior"
    given = spec.worth_m is not None
    yield given, f"{worth}: got {spec.worth_m} without a prior", "with bayes and a prior"


def _believing(spec: SessionSpec) -> Contradictions:
    """Contradictions of the options of a session that is to have a prior."""
    repeats, early, worth = map(argument, ("count_repeats", "early_stop", "worth_m"))
    often = "without, as bayes repeats a gait when that is most informative"
    yield spec.count_repeats, f"{repeats}: used with bayes", often
    # Other objectives have no prior for steered walks, which is reported instead.
    steered = spec.hold != "none" and spec.optimizer != TRIM and spec.objective in SCORES
    scored = f"with {argument('objective')} {spec.objective}"
    ends = "with final, which can be predicted before the end of a walk"
    yield steered and spec.early_stop, f"{early}: used {scored}", ends
    got = f"{worth}: got {spec.worth_m} m {scored}"
    yield steered and bool(spec.worth_m), got, "0, to spend the budget whatever the gain"


def _with_prior(spec: SessionSpec, path: Path) -> SessionSpec:
    digest = str(KIND.read_head(path).get("digest", ""))
    kept = replace(spec, prior=str(path), prior_digest=digest)
    if spec.optimizer == TRIM:
        return kept
    kept = replace(kept, optimizer=BAYES)
    if spec.hold != "none":
        return kept
    noise_m = assumed_noise_m(spec)
    return replace(
        kept,
        target_m=DEFAULT_TARGET_M if spec.target_m is None else spec.target_m,
        worth_m=max(noise_m, spec.uncertainty_m) if spec.worth_m is None else spec.worth_m,
        noise_m=noise_m,
    )


def assumed_noise_m(spec: SessionSpec) -> float:
    """Standard deviation between trials of one gait that is assumed before any repeat."""
    if spec.noise_m is not None:
        return spec.noise_m
    return SIMULATED_NOISE_M if spec.simulated else REAL_NOISE_M
