"""`hexctl sessions`: list, show, compare and delete recorded sessions."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.console import LeftOut, print_message, print_result
from hexctl.cli.settings import Commands, runs_folder
from hexctl.cli.shared_options import JsonOption
from hexctl.errors import InputError
from hexctl.options import listed

if TYPE_CHECKING:
    from hexctl.adapt.sessions.search_session import Session

sessions = Commands()

NameArgument = Annotated[
    str,
    typer.Argument(
        autocompletion=completion.sessions,
        metavar="SESSION",
        help="Name of a session, as hexctl sessions list has it.",
    ),
]


@sessions.command("list")
def list_sessions(as_json: JsonOption = False) -> None:
    """List all sessions under runs/, newest last.

    Damaged sessions and trials are named on stderr, with exit code 3; the others are listed.
    """
    from hexctl.adapt.sessions.store import list_sessions as all_sessions
    from hexctl.cli.render.session_tables import sessions_table

    left_out = LeftOut()
    found = all_sessions(runs_folder(), on_damage=left_out.name)
    if as_json:
        print_result([{**session.as_json(), "trials": len(session.trials)} for session in found])
    elif not found and not left_out.count:
        print_result(f"no sessions under {runs_folder()}/ yet; hexctl adapt makes one")
    elif found:
        print_result(sessions_table(found))
    raise typer.Exit(left_out.code())


@sessions.command()
def show(
    name: NameArgument,
    pareto: Annotated[
        str | None,
        typer.Option(
            "--pareto",
            metavar="OBJECTIVES",
            help="Show the trials that no other one beats in all of these objectives, such as speed,cost. "
            "(default: all trials)",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Show a session's trials; damaged ones are named on stderr, with exit code 3."""
    from hexctl.adapt.sessions.store import load_session
    from hexctl.cli.render.session_summary import session_lines

    left_out = LeftOut()
    session = load_session(name, runs_folder(), on_damage=left_out.name)
    if pareto is not None:
        print_result(*_pareto(session, pareto, as_json=as_json))
    else:
        print_result(*([session.as_json()] if as_json else session_lines(session)))
    raise typer.Exit(left_out.code())


def _pareto(session: "Session", names_text: str, *, as_json: bool) -> list[Any]:
    from hexctl.adapt.objectives import OBJECTIVES, make_objective
    from hexctl.cli.render.session_tables import pareto_parts

    names = list(dict.fromkeys(listed(names_text)))
    if len(names) < 2:
        raise InputError(f"--pareto: got {names_text!r}; allowed: two or more of {', '.join(OBJECTIVES)}")
    objectives = [make_objective(name) for name in names]
    if not as_json:
        return pareto_parts(session, objectives)
    front = [
        {**trial.as_json(), "scores": dict(zip(names, scores, strict=True))}
        for trial, scores in session.pareto(objectives)
    ]
    return [{"session": session.name, "objectives": names, "trials": front}]


@sessions.command()
def compare(
    names: Annotated[
        list[str],
        typer.Argument(
            autocompletion=completion.sessions,
            metavar="SESSION",
            help="Names of two or more sessions, as hexctl sessions list has them.",
        ),
    ],
    out: Annotated[
        Path | None,
        typer.Option("--out", metavar="FILE", help="Write a plot too, a new .png file. (default: none)"),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Compare sessions: scores without a search, the best so far by trials, and what was found."""
    from hexctl.adapt.sessions.comparison import check_comparable, differences, draw_comparison
    from hexctl.adapt.sessions.store import load_session
    from hexctl.cli.render.session_tables import comparison_table

    left_out = LeftOut()
    found = [load_session(name, runs_folder(), on_damage=left_out.name) for name in names]
    check_comparable(found)
    if out is not None:
        draw_comparison(found, out)
    if as_json:
        written = {"out": None if out is None else str(out), "differences": differences(found)}
        print_result({"sessions": list(map(_compared, found)), **written})
        raise typer.Exit(left_out.code())
    print_result(comparison_table(found), *([] if out is None else [f"{out}"]))
    if unlike := differences(found):
        print_message(f"they differ in more than the search: {', '.join(unlike)}")
    raise typer.Exit(left_out.code())


def _compared(session: "Session") -> dict[str, Any]:
    """What `compare --json` prints about a session."""
    from hexctl.adapt.sessions.comparison import best_so_far, scores_without_search

    return {
        "session": session.name,
        "best_so_far": best_so_far(session),
        "without_search": scores_without_search(session),
        "recommended": session.as_json()["recommended"],
    }


@sessions.command()
def delete(
    name: NameArgument,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask. Its recordings are deleted too.")] = False,
) -> None:
    """Delete a session and its recordings."""
    from hexctl.adapt.sessions.search_session import trials_text
    from hexctl.adapt.sessions.store import StoreError, delete_session, load_session

    try:
        trials = trials_text(len(load_session(name, runs_folder()).trials))
    except StoreError as error:
        print_message(error)
        trials = "trials"
    if not yes and not _agreed(f"delete session {name}, its {trials} and the recordings?"):
        print_result("nothing deleted")
        return
    delete_session(name, runs_folder())
    print_result(f"deleted {name}")


def _agreed(request: str) -> bool:
    try:
        return typer.confirm(request)
    except typer.Abort:
        raise InputError("sessions delete: got no answer; allowed: y or n, or --yes to go without") from None
