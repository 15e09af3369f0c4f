"""`hexctl keys`: certificates for links beyond this computer, and the key of a servo board."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli.options import Range, number

keys = typer.Typer(help="Make and show certificates for robots beyond this computer.", no_args_is_help=True)

FolderArgument = Annotated[Path, typer.Argument(metavar="FOLDER", help="Folder of the certificates.")]

DAYS = Range(low=1, high=3650, whole=True)

DaysOption = Annotated[int, number("--days", DAYS, "Days that the certificates are valid, {}.")]


@keys.command()
def new(
    folder: FolderArgument = Path("keys"),
    host: Annotated[
        list[str] | None,
        typer.Option(
            "--host",
            help="Name or address under which clients reach the robot; repeat it for more. "
            "(default: this computer's name; loopback is always in)",
        ),
    ] = None,
    days: DaysOption = 825,
) -> None:
    """Make an authority, and certificates for a robot, its controllers and its viewers."""
    from hexctl.cli.keymaking import make

    make(folder, hosts=host or [], days=days)


@keys.command()
def renew(folder: FolderArgument = Path("keys"), days: DaysOption = 825) -> None:
    """Make the certificates of a folder valid anew, for the same hosts; needs the folder's authority."""
    from hexctl.cli.keymaking import renew as make_valid

    make_valid(folder, days=days)


@keys.command()
def mavlink(folder: FolderArgument = Path("keys")) -> None:
    """Make mavlink.key, the secret that lets a servo board and its controller sign their frames."""
    from hexctl.cli.keymaking import make_signing_key

    make_signing_key(folder)


@keys.command()
def show(folder: FolderArgument = Path("keys")) -> None:
    """Show whose certificates a folder holds, for which hosts, and until when."""
    from hexctl.cli.keymaking import show_all

    show_all(folder)
