"""`hexctl robot`: robot files from descriptions that others wrote."""

import math
from pathlib import Path
from typing import Annotated, Literal

import typer

from hexctl.cli.console import print_note, print_result
from hexctl.cli.settings import Commands
from hexctl.cli.values import choice, listed
from hexctl.errors import InputError

robot = Commands(help="Make robot files.", no_args_is_help=True)

Forward = Literal["x", "y", "-x", "-y"]


@robot.command("import")
def import_robot(
    urdf: Annotated[Path, typer.Argument(metavar="URDF", help="Robot description; expand a xacro first.")],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE", help="New robot file, .yaml. (default: none, it is needed)"
        ),
    ],
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the robot. (default: that in the URDF)")
    ] = None,
    foot: Annotated[
        str | None,
        typer.Option(
            "--foot",
            metavar="X,Y,Z",
            help="Place of a foot in the frame of the last link of its leg, in metres, such as 0,0,-0.13. "
            "(default: as the URDF tells)",
        ),
    ] = None,
    forward: Annotated[
        Forward, choice("--forward", Forward, "Axis of the root along which the robot looks: x, y, -x or -y.")
    ] = "x",
) -> None:
    """Make a robot file of a URDF with six legs of three hinges."""
    from hexctl.robot.formats.urdf_import import import_urdf

    if output.suffix not in (".yaml", ".yml"):
        raise InputError(f"--output: got {output}; allowed: a name that ends in .yaml")
    imported = import_urdf(urdf, name=name, foot_m=_point(foot), forward=forward)
    try:
        with output.open("x", encoding="utf-8") as file:
            file.write(imported.text)
    except FileExistsError:
        raise InputError(f"--output: {output} exists; allowed: a new file, nothing is replaced") from None
    except OSError as error:
        raise InputError(f"--output: {output} cannot be written ({error.strerror})") from error
    for note in imported.notes:
        print_note(f"hexctl: {note}")
    lines = [f"{output}"]
    if imported.unknown:
        lines.append(f"to measure: {', '.join(imported.unknown)}")
    print_result("\n".join([*lines, f"next: hexctl check --robot {output}"]))


def _point(text: str | None) -> tuple[float, float, float] | None:
    """Three numbers between commas."""
    if text is None:
        return None
    try:
        x, y, z = map(float, listed(text))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise InputError(f"--foot: got {text!r}; allowed: three numbers in m, such as 0,0,-0.13")
    return x, y, z
