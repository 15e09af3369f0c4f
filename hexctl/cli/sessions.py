"""`hexctl sessions`: list, show, export and delete recorded sessions."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import JsonOption

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
    from hexctl.cli.sessioning import list_all

    list_all(as_json=as_json)


@sessions.command()
def show(name: NameArgument, as_json: JsonOption = False) -> None:
    """Show a session's trials."""
    from hexctl.cli.sessioning import show_one

    show_one(name, as_json=as_json)


@sessions.command()
def export(
    name: NameArgument,
    path: Annotated[Path, typer.Argument(metavar="FILE", help="New file, .csv or .parquet.")],
) -> None:
    """Write a session's trials to a CSV or Parquet file."""
    from hexctl.cli.sessioning import export_one

    export_one(name, path)


@sessions.command()
def delete(
    name: NameArgument,
    yes: Annotated[bool, typer.Option("--yes", help="Do not ask. Its recordings are deleted too.")] = False,
) -> None:
    """Delete a session and its recordings."""
    from hexctl.cli.sessioning import delete_one

    delete_one(name, yes=yes)
