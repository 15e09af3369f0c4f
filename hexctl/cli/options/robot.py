"""Options that say what moves: backend, robot, world, seed."""

from typing import Annotated, Any

import typer

from hexctl.backends.robot_options import SEED
from hexctl.cli import completion
from hexctl.cli.values import number

WORLD_HELP = (
    "Simulated world: flat, slippery, slope, rough, a YAML file, or one of a family such as randomised:7."
)

SEED_HELP = f"Seed of everything random, a whole number, {SEED}: the same seed gives the same result."

ROBOTS = "ant, phantomx, pexod, phantomx-ax, makeyourpet, freenove-big, jethexa, lukas"

ROBOT_HELP = f"Robot: {ROBOTS}, or a path to a YAML file."


def robot_option(default: str, use: str = "") -> Any:
    """Option `--robot` of a command that has another default, or another use for it."""
    text = " ".join(filter(None, (ROBOT_HELP, use, f"(default: {default})")))
    return typer.Option("--robot", autocompletion=completion.robots, help=text)


RobotOption = Annotated[str, typer.Option("--robot", autocompletion=completion.robots, help=ROBOT_HELP)]

WorldOption = Annotated[
    str | None,
    typer.Option(
        "--world", autocompletion=completion.worlds, help=f"{WORLD_HELP} Only with sim. (default: flat)"
    ),
]

SeedOption = Annotated[int, number("--seed", SEED, SEED_HELP)]
