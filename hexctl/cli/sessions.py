"""`hexctl sessions`: list, show, export and delete recorded sessions."""

import json
from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.console import RUNS, print_result
from hexctl.cli.options import JsonOption
from hexctl.errors import InputError

sessions = typer.Typer(help="List, show, export and delete sessions of hexctl adapt.", no_args_is_help=True)

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
    """List all sessions under runs/, newest last."""
    from hexctl.adapt.store import list_sessions as all_sessions
    from hexctl.cli.render_adapt import session_line

    found = all_sessions(RUNS)
    if as_json:
        print_result(json.dumps([{**session.as_json(), "trials": len(session.trials)} for session in found]))
    elif not found:
        print_result(f"no sessions under {RUNS}/ yet; hexctl adapt makes one")
    else:
        print_result("\n".join(session_line(session) for session in found))


@sessions.command()
def show(name: NameArgument, as_json: JsonOption = False) -> None:
    """Show a session's trials."""
    from hexctl.adapt.store import load_session
    from hexctl.cli.render_adapt import session_lines

    session = load_session(name, RUNS)
    print_result(json.dumps(session.as_json()) if as_json else "\n".join(session_lines(session)))


@sessions.command()
def export(
    name: NameArgument,
    path: Annotated[Path, typer.Argument(metavar="FILE", help="New file, .csv or .parquet.")],
) -> None:
    """Write a session's trials to a CSV or Parquet file."""
    from hexctl.adapt.store import export_session

    export_session(name, path, RUNS)
    print_result(f"{path}")


@sessions.command()
def delete(
    name: NameArgument,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask. Its recordings are deleted too.")] = False,
) -> None:
    """Delete a session and its recordings."""
    from hexctl.adapt.store import delete_session, load_session

    trials = len(load_session(name, RUNS).trials)
    if not yes and not _agreed(f"delete session {name}, its {trials} trials and their recordings?"):
        print_result("nothing deleted")
        return
    delete_session(name, RUNS)
    print_result(f"deleted {name}")


def _agreed(request: str) -> bool:
    """Ask; raises InputError without an answer."""
    try:
        return typer.confirm(request)
    except typer.Abort:
        raise InputError("sessions delete: got no answer; allowed: y or n, or --yes to go without") from None
