"""`hexctl calibrate`: sign, offset and limits of each servo, one at a time."""

from typing import Annotated

import typer

from hexctl.cli.console import DONE, INTERRUPTED, StopOnInterrupt, print_note
from hexctl.cli.options.connection import CalibratedKeysOption, CalibratedPortOption, InsecureOption


def calibrate(
    robot: Annotated[str, typer.Argument(help="Robot file (YAML) to write to; copy a shipped one first.")],
    backend: Annotated[
        str | None,
        typer.Option(
            "--backend",
            help="The servos: mavlink (a servo board), a driver such as dynamixel or servo2040, or "
            "package.module:Class for servos of your own that have a servo map. (default: the driver of the "
            "robot file, or mavlink)",
        ),
    ] = None,
    connect: CalibratedPortOption = None,
    joints: Annotated[
        str | None,
        typer.Option(
            "--joints", help="Only these joints, such as leg1_coxa,leg2_tibia or leg3. (default: all 18)"
        ),
    ] = None,
    keys: CalibratedKeysOption = None,
    insecure: InsecureOption = False,
) -> None:
    """Find direction, offset and limits of each servo, and write them to the robot file.

    Hold the robot so that its legs hang free. Servos with feedback lose their torque and are moved by hand;
    others are moved one at a time, slowly. Every joint is saved when it is done; Ctrl-C ends it, and --joints
    does the rest.
    """
    from hexctl.cli.prompts import CalibrationPrompt
    from hexctl.control.calibration import calibrate as calibrate_servos

    with StopOnInterrupt(plain=True) as interrupt:
        result = calibrate_servos(
            robot,
            CalibrationPrompt(),
            backend=backend,
            joints=joints,
            connect=connect,
            credentials=keys,
            insecure=insecure,
            stop_requested=interrupt.requested,
        )
        if interrupt.requested():
            print_note("")  # the prompt is still on the line
        saved = f"saved {', '.join(result.saved)} in {result.path}" if result.saved else "nothing was changed"
        before = "" if result.backup is None else f"; as it was before: {result.backup}"
        print_note(saved + before)
        raise typer.Exit(INTERRUPTED if interrupt.requested() else DONE)
