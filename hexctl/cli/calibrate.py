"""`hexctl calibrate`: sign, offset and limits of each servo, one at a time."""

from pathlib import Path
from typing import Annotated

import typer

from hexctl.cli.options import InsecureOption


def calibrate(
    robot: Annotated[str, typer.Argument(help="Robot file (YAML) to write to; copy a shipped one first.")],
    connect: Annotated[
        str | None,
        typer.Option(
            "--connect",
            help="Where the servo board is: udpout:HOST:PORT, or a serial device such as "
            "/dev/ttyACM0:115200. (default: udpout:127.0.0.1:14550)",
        ),
    ] = None,
    joints: Annotated[
        str | None,
        typer.Option(
            "--joints", help="Only these joints, such as leg1_coxa,leg2_tibia or leg3. (default: all 18)"
        ),
    ] = None,
    keys: Annotated[
        Path | None,
        typer.Option(
            "--keys",
            help="Folder with mavlink.key, the board's secret, for a board that "
            "obeys it only. (default: none)",
        ),
    ] = None,
    insecure: InsecureOption = False,
) -> None:
    """Find direction, offset and limits of each servo, and write them to the robot file.

    Hold the robot so that its legs hang free. Every joint done is saved at once; Ctrl-C ends it.
    """
    from hexctl.cli.calibrating import execute

    raise typer.Exit(execute(robot, connect=connect, joints=joints, keys=keys, insecure=insecure))
