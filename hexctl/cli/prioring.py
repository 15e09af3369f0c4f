"""Which prior a session believes, from what was asked for; and what priors there are."""

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

from hexctl.adapt.prior.find import Serves, check_prior, find_prior, named_prior, prior_files, shipped_priors
from hexctl.adapt.prior.prior import PriorKey, load_prior
from hexctl.adapt.registry import BAYES
from hexctl.adapt.search import DEFAULT_TARGET_M
from hexctl.adapt.session import SessionSpec
from hexctl.cli import console
from hexctl.cli.console import RUNS
from hexctl.cli.prioradvice import how_to_get_one
from hexctl.errors import InputError

#: Where `hexctl prior build` puts what it built.
PRIORS = RUNS / "priors"


def with_prior(
    spec: SessionSpec,
    question: PriorKey,
    *,
    serves: Serves,
    optimizer: str | None,
    wanted: str | None,
    note: Callable[[str], None],
) -> SessionSpec:
    """Return the spec with optimizer and prior chosen.

    Args:
        spec: what was asked for otherwise.
        question: what a prior must answer.
        serves: says whether a prior of some legs serves this one.
        optimizer: as it was asked for, None for whatever fits.
        wanted: `auto`, `none` or a path; None is `auto`.
        note: is told why a session goes without a prior that nobody refused.

    Raises InputError for what contradicts itself, and for a prior that does not fit.
    """
    if not _may_believe(spec, optimizer, wanted):
        return spec
    reason = _other_objective(spec)
    if not reason and wanted not in (None, "auto"):
        path = named_prior(str(wanted), _folders())
        check_prior(path, question, serves=serves)
        return _believing(spec, path)
    if not reason:
        found = find_prior(question, _folders(), serves=serves)
        if found.path is not None:
            return _believing(spec, found.path)
        reason = found.reason
    if optimizer == BAYES or wanted not in (None, "auto") or spec.early_stop:
        raise InputError(f"prior: there is none for these trials ({reason}){how_to_get_one(spec)}")
    note(
        f"hexctl: no prior for these trials ({reason}); searching with {spec.optimizer} instead"
        f"{how_to_get_one(spec)}"
    )
    return spec


def _may_believe(spec: SessionSpec, optimizer: str | None, wanted: str | None) -> bool:
    """Return whether a prior is wanted, if there is one; raises InputError for what contradicts itself."""
    unasked_count = spec.count_repeats and optimizer is None and wanted is None
    if optimizer not in (None, BAYES) or wanted == "none" or unasked_count:
        if optimizer == BAYES:
            raise InputError("--prior: got none with --optimizer bayes; allowed: auto or a file")
        _refuse_without_bayes(spec, wanted)
        return False
    if spec.count_repeats:
        raise InputError(
            "--count-repeats: got it with bayes; allowed: without, bayes repeats a gait when that tells most"
        )
    return True


def _believing(spec: SessionSpec, path: Path) -> SessionSpec:
    target_m = DEFAULT_TARGET_M if spec.target_m is None else spec.target_m
    digest = load_prior(path).digest()
    return replace(spec, optimizer=BAYES, target_m=target_m, prior=str(path), prior_digest=digest)


def _other_objective(spec: SessionSpec) -> str:
    if spec.objective == "final":
        return ""
    return f"priors are for the objective final, not {spec.objective}"


def _refuse_without_bayes(spec: SessionSpec, wanted: str | None) -> None:
    """Refuse options that only bayes follows."""
    if wanted not in (None, "none"):
        raise InputError(f"--prior: got {wanted} with --optimizer {spec.optimizer}; allowed: with bayes")
    if spec.early_stop:
        raise InputError("--early-stop: got it without a prior; allowed: with bayes and a prior")


def show(file: str | None, *, as_json: bool) -> None:
    """Print what one prior, or each that would be found, is for."""
    paths = [named_prior(file, _folders())] if file is not None else prior_files(_folders())
    summaries = [{"prior": str(path), **summary_of(path)} for path in paths if file or _readable(path)]
    if as_json:
        console.print_result(json.dumps(summaries))
    else:
        console.print_result("\n".join(_line(summary) for summary in summaries) or "no priors yet")


def _folders() -> list[Path]:
    """Return where priors are, those built here first."""
    return [PRIORS, shipped_priors()]


def _readable(path: Path) -> bool:
    """Return whether a file is a prior; says so of one that is not."""
    try:
        load_prior(path)
    except InputError as error:
        console.print_note(f"hexctl: passed over: {error}")
        return False
    return True


def summary_of(path: Path) -> dict[str, Any]:
    """Return what a prior is for as plain JSON values; raises InputError for a damaged one."""
    prior = load_prior(path)
    return {
        **prior.question.as_json(),
        "legs": list(prior.legs),
        "stances": prior.sag_rad is not None,
        "worlds": prior.worlds,
        "bytes": path.stat().st_size,
    }


def _line(summary: dict[str, Any]) -> str:
    legs = ",".join(str(leg) for leg in summary["legs"])
    return (
        f"{summary['prior']}: {summary['robot']}, legs {legs} {summary['failure']}, self-rotation "
        f"{summary['self_rotation']}, {summary['duration_s']:g} s, {summary['worlds']} worlds a leg"
        f"{'' if summary['stances'] else ', without stances'}"
    )
