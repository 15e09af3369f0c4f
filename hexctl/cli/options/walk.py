"""Options of a walk: gait, direction, duration, posture, feedback."""

from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.cli.values import number
from hexctl.control.trial_plan import DURATION_S, TURN_DEG_S
from hexctl.gait.gait import PACE_HZ, STEP, gait_text

SELF_ROTATION_HELP = (
    "Turn before the walk until the failed leg points to the rear or the front of the way, or none: no turn."
)


_SLOTS_HELP = "or when in the cycle legs 1..6 step, six slots such as 5,1,2,4,3,6."

CheckedGaitOption = Annotated[
    str,
    typer.Option(
        "--gait",
        callback=gait_text,
        autocompletion=completion.gaits,
        help="Gait: demo, tripod, wave, ripple; auto, the one that stands safest; a code, 1..720; "
        f"{_SLOTS_HELP}",
    ),
]

TrialDurationOption = Annotated[float, number("--duration", DURATION_S, "Seconds that each gait walks, {}.")]

TurnOption = Annotated[
    float | None,
    number(
        "--turn",
        TURN_DEG_S,
        "Rate of turning in degrees per second, {}, counter-clockwise positive; alone it turns "
        "in place, with --heading it is blended with the walk. (default: 0)",
    ),
]

PaceOption = Annotated[
    float | None, number("--pace", PACE_HZ, "Gait cycles per second, {}. (default: the robot's)")
]

AmplitudeOption = Annotated[
    float | None,
    number(
        "--amplitude",
        STEP,
        "Length of a step as a fraction of the robot's size, {}. (default: the robot's)",
    ),
]

HeightOption = Annotated[
    float | None,
    number(
        "--height",
        STEP,
        "Height of a step as a fraction of the robot's size, {}. (default: the robot's)",
    ),
]
