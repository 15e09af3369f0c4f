"""Options and words that several commands share. Light to import: `hexctl --help` needs only these."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completion

WORLD_HELP = (
    "Simulated world: flat, slippery, slope, rough, a YAML file, or one of a family such as randomised:7."
)
FAILURE_HELP = (
    "What is wrong with the failed leg: locked (holds its stance), limp (no torque), missing, "
    "weak:FRACTION of its torque, 0..1 (0.3), stuck:JOINT:DEGREES with coxa, femur or tibia (coxa, 0)."
)
FAILED_LEG_HELP = "Leg that failed, 1..6, counter-clockwise from the front."
SELF_ROTATION_HELP = (
    "Turn before the walk until the failed leg points to the rear or the front of the way, or none: no turn."
)
SEED_HELP = "Seed of everything random, a whole number, 0 or more: the same seed gives the same result."

RobotOption = Annotated[
    str,
    typer.Option(
        "--robot",
        autocompletion=completion.robots,
        help="Robot: ant, phantomx, pexod, or a path to a YAML file.",
    ),
]
GaitOption = Annotated[
    str,
    typer.Option(
        "--gait",
        autocompletion=completion.gaits,
        help="Gait: demo, tripod, wave, ripple; a code, 1..720, or 1..120 with a failed leg; "
        "or when in the cycle legs 1..6 step, six slots such as 5,1,2,4,3,6.",
    ),
]
PaceOption = Annotated[
    float | None,
    typer.Option("--pace", help="Gait cycles per second, above 0 up to 10. (default: the robot's)"),
]
AmplitudeOption = Annotated[
    float | None,
    typer.Option(
        "--amplitude",
        help="Length of a step as a fraction of the robot's size, above 0 up to 1. (default: the robot's)",
    ),
]
HeightOption = Annotated[
    float | None,
    typer.Option(
        "--height",
        help="Height of a step as a fraction of the robot's size, above 0 up to 1. (default: the robot's)",
    ),
]
TurnOption = Annotated[
    float | None,
    typer.Option(
        "--turn",
        help="Rate of turning in degrees per second, -360..360, counter-clockwise positive; alone it turns "
        "in place, with --heading it is blended with the walk. (default: 0)",
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option("--jobs", help="Threads that simulate, 1..1024. (default: all cores; with --dask 1)"),
]
DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask",
        help="Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT. (default: this computer)",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        help="Where the robot is. With --backend zenoh where hexctl serve listens, such as "
        "tcp/HOST:7447 or tls/HOST:7447 (default: tcp/127.0.0.1:7447); with mavlink the servo board's port, "
        "such as /dev/ttyACM0:115200 or udpout:HOST:PORT (default: udpout:127.0.0.1:14550).",
    ),
]
ZenohConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        help="Where hexctl serve listens, such as tcp/HOST:7447 or tls/HOST:7447. "
        "(default: tcp/127.0.0.1:7447)",
    ),
]
KeysOption = Annotated[
    Path | None,
    typer.Option(
        "--keys",
        help="Folder of certificates that hexctl keys new made; needed beyond this computer. (default: none)",
    ),
]
InsecureOption = Annotated[
    bool,
    typer.Option(
        "--insecure", help="Go without certificates beyond this computer: anybody there can move the robot."
    ),
]
LinkOption = Annotated[
    str | None,
    typer.Option(
        "--link",
        help="YAML file that says where a robot is, its certificates and the names of its messages "
        "(docs/protocol.md). (default: none)",
    ),
]
SeedOption = Annotated[int, typer.Option("--seed", help=SEED_HELP)]
SimWorldOption = Annotated[
    str | None,
    typer.Option(
        "--world", autocompletion=completion.worlds, help=f"{WORLD_HELP} Only with sim. (default: flat)"
    ),
]
SimFailedLegOption = Annotated[
    int | None,
    typer.Option(
        "--failed-leg",
        autocompletion=completion.legs,
        help=f"{FAILED_LEG_HELP} Only with sim. (default: none)",
    ),
]
SimFailureOption = Annotated[
    str | None,
    typer.Option(
        "--failure",
        autocompletion=completion.failures,
        help=f"{FAILURE_HELP} Only with sim. (default: locked)",
    ),
]
