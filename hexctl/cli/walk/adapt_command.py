"""`hexctl adapt`: find a gait for a failed leg."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import fields
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.adapt.adapt_options import BEFORE_SEARCH, AdaptOptions
from hexctl.backends.robot_options import RobotOptions
from hexctl.cli import completion
from hexctl.cli.console import (
    ABORTED,
    DONE,
    INTERRUPTED,
    StopOnInterrupt,
    code_of_stop,
    in_flags,
    note_no_window,
    print_message,
    print_result,
)
from hexctl.cli.results.view_command import view_afterwards
from hexctl.cli.settings import given, runs_folder
from hexctl.cli.shared_options import (
    ArenaOption,
    JsonOption,
    QuietOption,
    TrialRecoverOption,
    arena_fields,
    chosen_recovery,
)
from hexctl.cli.signature import with_options
from hexctl.cli.walk.diagnose_command import diagnose_first
from hexctl.errors import HexctlError, InputError, argument
from hexctl.robot.failure_grammar import AUTO_LEG, read_failures_before
from hexctl.robot.plugins import custom_failure

if TYPE_CHECKING:
    from hexctl.adapt.adaptation import Adaptation, AdaptationResult
    from hexctl.adapt.sessions.search_session import Session
    from hexctl.adapt.sessions.session_spec import SessionSpec
    from hexctl.robot.failure import Failure

#: Options that go with --resume.
WITH_RESUME = ("--resume", "--budget", "--trust", "--view", "--no-record", "--quiet", "--json")


NoBaselineOption = Annotated[
    bool,
    typer.Option(
        "--no-baseline",
        hidden=True,
        help="Leave out the walks before the first trial with gaits that need no search.",
    ),
]
ResumeOption = Annotated[
    str | None,
    typer.Option(
        "--resume",
        autocompletion=completion.sessions,
        help="Continue this session, by its name in hexctl sessions list; --budget lets one whose budget is "
        "spent walk more. (default: begin a new one)",
    ),
]
TrustOption = Annotated[
    bool,
    typer.Option("--trust", hidden=True, help="With --resume: trust code and robot that the session names."),
]
ViewOption = Annotated[
    bool,
    typer.Option(
        "--view", help="Show a real robot's trials in Rerun while they run, and the session at its end."
    ),
]
NoRecordOption = Annotated[
    bool, typer.Option("--no-record", help="Leave no recordings; the session is stored all the same.")
]


@with_options(AdaptOptions, rare=("objective", "ask", "hold"))
def adapt(
    search: dict[str, Any],
    context: typer.Context,
    no_baseline: NoBaselineOption = False,
    recover: TrialRecoverOption = False,
    arena: ArenaOption = None,
    resume: ResumeOption = None,
    trust: TrustOption = False,
    view: ViewOption = False,
    no_record: NoRecordOption = False,
    quiet: QuietOption = False,
    as_json: JsonOption = False,
) -> None:
    """Find a gait for a failed leg in few trials; each is kept and recorded.

    A trial walks one of the 120 gaits and is scored by how far off the line it ends. Ctrl-C ends a session,
    --resume continues it. Exit codes: 0 done, 2 bad input, 3 fault
    of robot, link or recording, 4 stopped or no valid trial, 130 interrupted.
    """
    if view and no_record:
        raise InputError("--no-record: got --view too; allowed: one or the other")
    if resume is not None:
        typed = given(context)
        _check_resumed_alone(resume, typed)
        prepare = partial(_resumed, resume, typed.get("--budget"), trust)
    else:
        if trust:
            raise InputError("--trust: used without --resume; allowed: with --resume SESSION")
        if search["failed_leg"] is None and not search["failure"]:
            raise InputError("--failed-leg: is missing; allowed: 1..6, auto (or --resume SESSION)")
        if search["failed_leg"] == AUTO_LEG:
            search["failed_leg"], search["failure"] = None, _diagnosed(search)
        search["recovery"] = chosen_recovery(recover=recover, recovery=search["recovery"])
        asked = search | arena_fields(arena, search["robot"]) | {"baseline": not no_baseline}
        prepare = partial(_begun, asked)
    with StopOnInterrupt() as interrupt:  # loading takes a second
        make, spec = prepare()
        shown = {"record": not no_record, "view": view, "quiet": quiet, "as_json": as_json}
        searched = _search(make, spec, interrupt, **shown)
    if not isinstance(searched, int):
        searched = _end(searched, view=view, as_json=as_json, resumed=resume is not None)
    raise typer.Exit(searched)


def _diagnosed(search: Mapping[str, Any]) -> "Failure":
    """The failure that a diagnosis finds before the search; raises InputError if no leg has failed."""
    from hexctl.runs.run_spec import RunSpec

    where = {field.name: search[field.name] for field in fields(RobotOptions)}
    broken = read_failures_before(search["failure"], None, BEFORE_SEARCH)
    found = diagnose_first(RunSpec(**where | {"failed_leg": None, "failure": broken}))
    if found.failure is None:
        raise InputError("--failed-leg: got auto, and no leg has failed; allowed: 1..6")
    return found.failure


def _check_resumed_alone(resume: str, typed: Mapping[str, Any]) -> None:
    """Raise InputError for options that a resumed session would silently ignore."""
    others = [flag for flag in typed if flag not in WITH_RESUME]
    if others:
        raise InputError(
            f"--resume: got {', '.join(others)} too, but a session continues as it was begun; "
            f"allowed: --resume {resume} alone, or with --budget"
        )


def _begun(asked: dict[str, Any]) -> "tuple[Callable[..., Adaptation], SessionSpec]":
    from hexctl.adapt.adaptation import Adaptation
    from hexctl.adapt.search import new_spec
    from hexctl.cli.prompts import check_answerable

    spec = new_spec(**asked, folder=runs_folder(), note=print_message)
    if spec.ask:
        check_answerable()
    return partial(Adaptation, spec), spec


def _resumed(name: str, budget: int | None, trust: bool) -> "tuple[Callable[..., Adaptation], SessionSpec]":
    from hexctl.adapt.adaptation import Adaptation
    from hexctl.adapt.sessions.store import load_session

    try:
        session = load_session(name, folder=runs_folder())
    except InputError as error:
        named = error.worded(lambda what: "--resume" if what == "session" else argument(what))
        raise InputError(named) from error.__cause__
    return partial(Adaptation.resume, session, budget=budget, trust=trust), session.spec


def _search(
    make: "Callable[..., Adaptation]",
    spec: "SessionSpec",
    interrupt: StopOnInterrupt,
    *,
    record: bool,
    view: bool,
    quiet: bool,
    as_json: bool,
) -> "AdaptationResult | int":
    from hexctl.adapt.runner import NotBegunError, RobotStoppedError
    from hexctl.adapt.sessions.store import StoreError
    from hexctl.cli.prompts import TrialPrompt
    from hexctl.cli.render.session_summary import after_stop
    from hexctl.cli.render.session_tables import SessionTable
    from hexctl.recording.live import open_window

    begun: list[Session] = []
    with SessionTable(quiet=quiet or as_json) as table:

        def begin(session: "Session") -> None:
            begun.append(session)
            table.begin(session)

        adaptation = make(
            folder=runs_folder(),
            record=record,
            operator=TrialPrompt(spec, interrupt.requested) if spec.ask else None,
            live=partial(open_window, note_no_window) if view else None,
            note=print_message,
        )
        try:
            return adaptation.run(
                on_begin=begin,
                on_stored=table.add,
                stop_requested=interrupt.requested,
            )
        except RobotStoppedError as error:
            print_message(f"{in_flags(error)}; {after_stop(spec, error)}begin again")
            return _code_of_stop(error)
        except NotBegunError as error:
            print_message(str(error))
            return INTERRUPTED
        except (InputError, StoreError) as error:
            if not begun:
                raise
            raise type(error)(f"{in_flags(error)}; {_what_is_left(begun)}") from error.__cause__ or error
        except Exception as error:
            if not begun or (text := custom_failure(error)) is None:
                raise
            raise HexctlError(f"{text}; {_what_is_left(begun)}") from error
        except KeyboardInterrupt:
            print_message(f"interrupted without a soft stop; {_what_is_left(begun)}")
            return INTERRUPTED


def _what_is_left(begun: "Sequence[Session]") -> str:
    from hexctl.cli.render.session_summary import resume_command

    return f"continue with: {resume_command(begun[0])}" if begun else "nothing was recorded"


def _end(result: "AdaptationResult", *, view: bool, as_json: bool, resumed: bool) -> int:
    from hexctl.cli.render.session_summary import after_stop, resume_command

    session = result.session
    _print_end(result, as_json=as_json, resumed=resumed)
    if result.trouble is not None:
        then = f"{after_stop(session.spec, result.trouble)}continue with: {resume_command(session)}"
        print_message(f"{in_flags(result.trouble)}; nothing is lost: {then}")
        return _code_of_stop(result.trouble)
    if result.ended == "interrupted":
        return INTERRUPTED
    if view and result.trials:
        view_afterwards(session.name)
    return DONE if result.best is not None else ABORTED


def _print_end(result: "AdaptationResult", *, as_json: bool, resumed: bool) -> None:
    """A resumed session may have been finished before."""
    from hexctl.cli.render.session_summary import closing_parts, finished_line

    parts = [result.to_dict()] if as_json else closing_parts(result.session, result.ended)
    print_result(*parts)
    finished = finished_line(result.ended)
    if resumed and not result.walked and finished is not None:
        print_message(finished)


def _code_of_stop(error: HexctlError) -> int:
    return code_of_stop(str(getattr(error, "reason", "fault")))
