"""`hexctl view`: open recordings and sessions in Rerun."""

from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.options import InsecureOption, KeysOption, LinkOption


def view(
    names: Annotated[
        list[str] | None,
        typer.Argument(
            metavar="[RECORDING|SESSION]...",
            autocompletion=completion.viewable,
            help="Recordings (.rrd) or names of sessions. (default: the newest under runs/)",
        ),
    ] = None,
    web: Annotated[
        bool, typer.Option("--web", help="Serve the viewer to a browser on this computer, until Ctrl-C.")
    ] = False,
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            help="Watch the robot at this Zenoh endpoint instead, such as tcp/127.0.0.1:7447, without "
            "commanding it.",
        ),
    ] = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
) -> None:
    """Open recordings or whole sessions in the Rerun viewer and wait until it is closed; or watch a robot."""
    from hexctl.errors import InputError

    if connect is None and link is None:
        if keys is not None or insecure:
            raise InputError("--keys, --insecure: got one without --connect or --link; allowed: with a robot")
        from hexctl.cli.viewing import open_all

        raise typer.Exit(open_all(names or [], web=web))
    if names:
        raise InputError(f"view: got {names[0]!r} with a robot; allowed: recordings, or --connect, not both")
    from hexctl.cli.watching import watch

    raise typer.Exit(watch(web=web, endpoint=connect, credentials=keys, insecure=insecure, link=link))
