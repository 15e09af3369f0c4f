"""`hexctl view`: open recordings and sessions in Rerun."""

from typing import Annotated

import typer


def view(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RECORDING|SESSION]...",
            help="Recordings (.rrd) or names of sessions. (default: the newest under runs/)",
        ),
    ] = None,
) -> None:
    """Open recordings or whole sessions in the Rerun viewer and wait until it is closed."""
    from hexctl.cli.viewing import open_all

    raise typer.Exit(open_all(names or []))
