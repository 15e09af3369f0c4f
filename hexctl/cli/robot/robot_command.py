"""`hexctl robot`, `gaits` and `worlds`: shipped names, and new robot files."""

import math
import shlex
from pathlib import Path
from typing import Annotated, Literal

import typer

from hexctl.cli import completion
from hexctl.cli.console import print_message, print_result
from hexctl.cli.settings import Commands
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import choice
from hexctl.errors import InputError, printable
from hexctl.files import write_new
from hexctl.options import listed
from hexctl.robot.configs import config_names, find_config, read_mapping

robot = Commands()

Forward = Literal["x", "y", "-x", "-y"]


#: Values of `--gait` that choose a gait for the robot.
CHOSEN = {
    "auto": "the most stable one for the robot, its failed legs and its direction",
    "best": "the best that a prior or a session knows for the failed leg",
}


@robot.command("list")
def list_robots(as_json: JsonOption = False) -> None:
    """List the shipped robots."""
    texts = {
        name: str(read_mapping(find_config("robots", name))["description"]) for name in config_names("robots")
    }
    _print_names(texts, "next: hexctl robot copy NAME FILE, to change one for your robot", as_json=as_json)


def worlds(as_json: JsonOption = False) -> None:
    """List the shipped simulated worlds."""
    texts = {}
    for name in config_names("worlds"):
        path = find_config("worlds", name)
        shown = f"{name}:NUMBER" if "ranges" in read_mapping(path) else name
        texts[shown] = _first_sentence(path.read_text(encoding="utf-8"))
    _print_names(texts, "--world also takes a YAML file with the differences from flat", as_json=as_json)


def gaits(as_json: JsonOption = False) -> None:
    """List the named gaits."""
    from hexctl.gait.gait import NAMED_SLOTS

    if as_json:
        print_result(NAMED_SLOTS)
        return
    rows = {
        name: f"legs 1 to 6 step in slots {','.join(map(str, slots))}" for name, slots in NAMED_SLOTS.items()
    }
    more = "--gait also takes a code, 1..720, or six slots such as 5,1,2,4,3,6"
    _print_names(rows | CHOSEN, more, as_json=False)


def _print_names(texts: dict[str, str], more: str, *, as_json: bool) -> None:
    from hexctl.cli.render.tables import label_table

    print_result(*([texts] if as_json else [label_table(texts.items()), "", more]))


def _first_sentence(text: str) -> str:
    comment = []
    for line in text.splitlines():
        if not line.startswith("#"):
            break
        comment.append(line.removeprefix("#").strip())
    return " ".join(comment).partition(". ")[0].removesuffix(".") + "."


@robot.command("copy")
def copy_robot(
    name: Annotated[
        str,
        typer.Argument(
            metavar="NAME",
            autocompletion=completion.robots,
            help="Shipped robot, as hexctl robot list has it.",
        ),
    ],
    file: Annotated[Path, typer.Argument(metavar="FILE", help="New robot file, .yaml.")],
) -> None:
    """Copy a shipped robot file, to change it for your own robot."""
    from hexctl.robot.loader import load_robot_file

    _write_new(file, load_robot_file(name).text_in(file.parent), "FILE")
    print_result(f"{file}", f"next: change its name and values, then hexctl check {shlex.quote(str(file))}")


@robot.command("import")
def import_robot(
    description: Annotated[
        Path,
        typer.Argument(metavar="DESCRIPTION", help="Robot description, URDF or MJCF; expand a xacro first."),
    ],
    output: Annotated[
        Path,
        typer.Option(
            "--output", "-o", metavar="FILE", help="New robot file, .yaml. (default: none, it is needed)"
        ),
    ],
    name: Annotated[
        str | None, typer.Option("--name", help="Name of the robot. (default: that in the description)")
    ] = None,
    foot: Annotated[
        str | None,
        typer.Option(
            "--foot",
            metavar="X,Y,Z",
            help="Place of a foot in the frame of the last link of its leg, in metres, such as 0,0,-0.13. "
            "(default: the far end of the leg)",
        ),
    ] = None,
    forward: Annotated[
        Forward | None,
        choice(
            "--forward",
            Forward,
            "Axis of the root along which the robot looks: x, y, -x or -y. (default: by the names of its "
            "legs, else x)",
        ),
    ] = None,
) -> None:
    """Make a robot file of a URDF or MJCF with six legs of three hinges."""
    from hexctl.control.checks.default_gait import walkable
    from hexctl.robot.formats.importing.robot_import import import_robot as imported_robot

    _check_yaml(output, "--output")
    imported = walkable(imported_robot(description, name=name, foot_m=_point(foot), forward=forward))
    _write_new(output, imported.text, "--output")
    if (own := imported.content["name"]) in config_names("robots"):
        print_message(f"{own} is also a shipped robot; --robot {own} is that one, not this file")
    for note in imported.notes:
        print_message(printable(note))
    lines = [f"{output}"]
    if imported.unknown:
        lines.append(f"to measure: {', '.join(imported.unknown)}")
        lines += [f"  {key}: {printable(why)}" for key, why in imported.reasons.items()]
    print_result("\n".join([*lines, f"next: hexctl check --robot {shlex.quote(str(output))}"]))


def _check_yaml(path: Path, option: str) -> None:
    if path.suffix not in (".yaml", ".yml"):
        raise InputError(f"{option}: got {path}; allowed: a name that ends in .yaml")


def _write_new(path: Path, text: str, option: str) -> None:
    _check_yaml(path, option)
    write_new(path, text, option)


def _point(text: str | None) -> tuple[float, float, float] | None:
    if text is None:
        return None
    try:
        x, y, z = map(float, listed(text))
    except ValueError:
        x = y = z = math.nan
    if not all(map(math.isfinite, (x, y, z))):
        raise InputError(f"--foot: got {text!r}; allowed: three numbers in m, such as 0,0,-0.13")
    return x, y, z
