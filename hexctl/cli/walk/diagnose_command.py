"""`hexctl diagnose`: find the failed leg at rest."""

import sys
from dataclasses import fields, replace
from typing import TYPE_CHECKING, Any, NamedTuple

import typer

from hexctl.backends.robot_options import RecordedOptions
from hexctl.cli.console import (
    DONE,
    INTERRUPTED,
    code_of,
    print_message,
    print_result,
)
from hexctl.cli.shared_options import JsonOption, NoRecordOption, record_folder
from hexctl.cli.signature import with_options
from hexctl.cli.walk.connected_run import check_commanded, connected
from hexctl.errors import InputError, RecordingError
from hexctl.types import JOINT_KINDS

if TYPE_CHECKING:
    from rich.table import Table

    from hexctl.robot.failure import Failure
    from hexctl.runs.diagnosis import AskOperator, DiagnosisResult
    from hexctl.runs.run_spec import RunSpec


@with_options(RecordedOptions, rare=("record",))
def diagnose(
    where: dict[str, Any],
    no_record: NoRecordOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find which leg and joint failed, and how, in 12 s of small motions at rest.

    The robot stands on its feet, with room around it. With sim, --failed-leg and --failure choose the
    simulated failure, unknown to the diagnosis. Exit codes: 0 done, whatever was found, 2 bad input, 3 fault
    of robot or link, 4 fell or was stopped, 130 interrupted.
    """
    from hexctl.runs.run_spec import RunSpec

    spec = RunSpec(**where, record_folder=record_folder(where["record"], no_record=no_record))
    done, code = diagnosed(spec)
    print_result(*([done.outcome] if as_json else summary(done.outcome)))
    if done.diagnosis.source == "none" and not done.diagnosis.unfinished and _operator() is None:
        print_message("on a terminal, hexctl diagnose asks the operator which legs move as they should")
    if (error := done.recording_error) is not None:
        raise RecordingError(f"the diagnosis is done, its recording is not whole: {error}") from error
    raise typer.Exit(code)


def diagnosed(spec: "RunSpec") -> "tuple[DiagnosisResult, int]":
    """Run `DiagnosisRun`; return its result and the exit code."""
    from hexctl.runs.diagnosis import DiagnosisRun

    run = DiagnosisRun(spec)
    with connected(run) as interrupt:
        done = run.diagnose(ask=_operator(), stop_requested=interrupt.requested)
        check_commanded(done.outcome)
        return done, INTERRUPTED if interrupt.requested() else code_of(done.trial)


def diagnose_first(spec: "RunSpec") -> "FirstDiagnosis":
    """Diagnosis before a walk for `--failed-leg auto`, reported on stderr.

    The failures of the spec are simulated, and unknown to the diagnosis. Raises InputError if it found
    nothing or more than one leg, Exit if it was stopped.
    """
    _check_simulated(spec)
    others = ("record", "record_folder", "failed_leg", "failure")
    names = [field.name for field in fields(RecordedOptions) if field.name not in others]
    options = {name: getattr(spec, name) for name in names}
    done, code = diagnosed(type(spec)(failure=spec.failures, **options))
    if code != DONE:
        print_message("the diagnosis was stopped, and so is what was to follow")
        raise typer.Exit(code)
    for note in done.diagnosis.notes:
        print_message(note)
    print_message(f"diagnosis: {done.diagnosis.verdict}")
    if done.diagnosis.source == "none":
        raise InputError("--failed-leg: got auto, which could not be found out; allowed: 1..6")
    failures = done.diagnosis.failures
    if len(failures) > 1:
        raise InputError(
            f"--failed-leg: got auto, which is {done.diagnosis.verdict}; allowed: one failed leg, or "
            f"hexctl run --failed-leg {','.join(str(one.leg) for one in failures)}"
        )
    return FirstDiagnosis(failures[0] if failures else None, spec.failures, done)


class FirstDiagnosis(NamedTuple):
    """Result of a diagnosis before a walk; `broken` is what the simulation breaks."""

    failure: "Failure | None"
    broken: "tuple[Failure, ...]"
    result: "DiagnosisResult"

    def walk_spec(self, spec: "RunSpec") -> "RunSpec":
        """Spec of the walk, whose controller knows the finding."""
        comes = [event for event in spec.events if event.failure is not None]
        return replace(spec, failed_leg=None, failure=(*filter(None, (self.failure,)), *comes))


def _check_simulated(spec: "RunSpec") -> None:
    for failure in () if spec.simulated else spec.failures:
        raise InputError(
            f"--failure: got {failure.typed} with --failed-leg auto and --backend {spec.backend}; "
            "allowed: with sim, which breaks it"
        )


def _operator() -> "AskOperator | None":
    if not (sys.stdin and sys.stdin.isatty()):
        return None
    from hexctl.cli.prompts import LegPrompt

    return LegPrompt().moved


def summary(outcome: dict[str, Any]) -> list[Any]:
    """Outcome of a diagnosis, the object of `hexctl diagnose --json`, as text and a table."""
    from hexctl.cli.render.tables import label_table

    where = f"in world {outcome['world']}" if outcome["world"] else f"on {outcome['backend']}"
    stopped = f" ({outcome['stopped']})" if outcome["stopped"] else ""
    rows = [
        *([] if outcome["status"] == "ok" else [("status", outcome["status"] + stopped)]),
        *[("note", note) for note in outcome["notes"]],
        ("verdict", outcome["verdict"]),
        *([("recording", outcome["recording"])] if outcome["recording"] else []),
    ]
    return [f"{outcome['robot']} {where}", "", _leg_table(outcome), "", label_table(rows)]


def _leg_table(outcome: dict[str, Any]) -> "Table":
    from hexctl.cli.render.tables import plain_table

    table = plain_table("leg", *JOINT_KINDS, "load", "verdict", "")
    for leg in outcome["legs"]:
        gains = [_number(leg["gains"][kind]) for kind in JOINT_KINDS]
        verdict = leg["failure"] or ("-" if outcome["source"] == "none" or not leg["tested"] else "good")
        table.add_row(str(leg["leg"]), *gains, _number(leg["load"]), verdict, leg["evidence"])
    return table


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:.2f}"
