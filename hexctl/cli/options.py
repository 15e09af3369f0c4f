"""Options that several commands share. Light to import: `hexctl --help` needs only these."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli import completing

RobotOption = Annotated[
    str,
    typer.Option(
        "--robot",
        autocompletion=completing.robots,
        help="Robot: ant, phantomx, pexod, or a path to a YAML file.",
    ),
]
GaitOption = Annotated[
    str,
    typer.Option(
        "--gait",
        autocompletion=completing.gaits,
        help="demo, tripod, wave, ripple; a code (1..720, with a failed leg 1..120) such as 57; "
        "or phase slots of legs 1..6 such as 5,1,2,4,3,6.",
    ),
]
PaceOption = Annotated[
    float | None, typer.Option("--pace", help="Gait cycles per second, up to 10. (default: the robot's)")
]
AmplitudeOption = Annotated[
    float | None,
    typer.Option(
        "--amplitude", help="Step amplitude as a fraction of the robot's size, 0..1. (default: the robot's)"
    ),
]
HeightOption = Annotated[
    float | None,
    typer.Option(
        "--height", help="Step height as a fraction of the robot's size, 0..1. (default: the robot's)"
    ),
]
TurnOption = Annotated[
    float | None,
    typer.Option(
        "--turn",
        help="Yaw rate in degrees per second, counter-clockwise positive; alone it turns in place, "
        "with --heading it is blended with the walk. (default: 0)",
    ),
]
JobsOption = Annotated[
    int | None,
    typer.Option("--jobs", help="Threads of each batch of gaits. (default: all cores; with --dask 1)"),
]
DaskOption = Annotated[
    str | None,
    typer.Option("--dask", help="Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        help="Where the robot is: for zenoh a Zenoh endpoint, for mavlink a port such as "
        "udpout:127.0.0.1:14550 or /dev/ttyACM0:115200. (default: tcp/127.0.0.1:7447, "
        "udpout:127.0.0.1:14550)",
    ),
]
ZenohConnectOption = Annotated[
    str | None,
    typer.Option("--connect", help="Zenoh endpoint where the robot listens. (default: tcp/127.0.0.1:7447)"),
]
KeysOption = Annotated[
    Path | None,
    typer.Option("--keys", help="Folder that hexctl keys new made, for a link beyond this computer."),
]
InsecureOption = Annotated[
    bool, typer.Option("--insecure", help="Let a link beyond this computer do without certificates.")
]
LinkOption = Annotated[
    str | None,
    typer.Option("--link", help="Link file (YAML) with endpoint, certificates and key names of a robot."),
]
