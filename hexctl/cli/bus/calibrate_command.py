"""`hexctl calibrate`: sign, offset and limits of each servo, one at a time."""

from dataclasses import fields
from typing import Annotated, Any

import typer

from hexctl.cli.console import DONE, INTERRUPTED, StopOnInterrupt, print_note
from hexctl.cli.signature import with_options
from hexctl.control.calibration.servo_calibration import CalibrationOptions
from hexctl.control.calibration.servo_calibration import calibrate as calibrate_servos
from hexctl.teleop.page_options import PagedCalibrationOptions


@with_options(PagedCalibrationOptions)
def calibrate(
    options: dict[str, Any],
    robot: Annotated[str, typer.Argument(help="Robot file (YAML) to write to; copy a shipped one first.")],
) -> None:
    """Find direction, offset and limits of each servo, and write them to the robot file.

    Hold the robot so that its legs hang free. Servos with feedback lose their torque and are moved by hand;
    others are moved one at a time, slowly. Every joint is saved when it is done; Ctrl-C ends it, and --joints
    does the rest. With --page a browser shows the robot, and asks in place of this terminal.
    """
    from hexctl.cli.prompts import CalibrationPrompt, check_answerable

    asked = PagedCalibrationOptions(**options)
    if asked.page is None:
        check_answerable("calibrate")
    with StopOnInterrupt(plain=True) as interrupt:
        if asked.page is None:
            given = {field.name: options[field.name] for field in fields(CalibrationOptions)}
            result = calibrate_servos(robot, CalibrationPrompt(), stop_requested=interrupt.requested, **given)
        else:
            from hexctl.teleop.calibration_page import calibrate_on_page

            result = calibrate_on_page(robot, asked, say=print_note, stop_requested=interrupt.requested)
        if interrupt.requested():
            print_note("")  # the prompt is still on the line
        saved = f"saved {', '.join(result.saved)} in {result.path}" if result.saved else "nothing was changed"
        before = "" if result.backup is None else f"; as it was before: {result.backup}"
        print_note(saved + before)
        raise typer.Exit(INTERRUPTED if interrupt.requested() else DONE)
