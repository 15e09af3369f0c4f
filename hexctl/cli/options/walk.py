"""Options of a walk: gait, direction, duration, posture, feedback."""

from typing import Annotated, Literal

import typer

from hexctl.cli import completion
from hexctl.cli.values import Range, choice, in_lower_case, number

DURATION_S = Range(low=0, high=86_400, above=True, unit="s")

PACE_HZ = Range(low=0, high=10, above=True, unit="Hz")

STEP_FRACTION = Range(low=0, high=1, above=True)

TRIM_DEG = Range(low=-45, high=45)

POSTURE_FRACTION = Range(low=-0.2, high=0.2)

SWING = Range(low=0.1, high=0.5)

HEADING_DEG = Range()

TURN_DEG_S = Range(low=-360, high=360, unit="deg/s")

SelfRotation = Literal["rear", "front", "none"]

AutoRotation = Literal["auto", "rear", "front", "none"]

Hold = Literal["auto", "line", "heading", "none"]

SELF_ROTATION_HELP = (
    "Turn before the walk until the failed leg points to the rear or the front of the way, or none: no turn."
)


def gait_text(text: str) -> str:
    """A gait as hexctl writes it; slots of a gait with a name, which results print too, are that gait."""
    if "," in text:
        from hexctl.gait.gait import NAMED_SLOTS

        slots = "".join(text.split())
        named = [name for name, one in NAMED_SLOTS.items() if ",".join(map(str, one)) == slots]
        return named[0] if named else text
    return in_lower_case(text) or text


_SLOTS_HELP = "or when in the cycle legs 1..6 step, six slots such as 5,1,2,4,3,6."

GaitOption = Annotated[
    str,
    typer.Option(
        "--gait",
        callback=gait_text,
        autocompletion=completion.gaits,
        help="Gait: demo, tripod, wave, ripple; auto, the one that stands safest; best, the fastest by a "
        "prior for the failed leg, or best:SESSION, that of a session; a code, 1..720, or 1..120 "
        f"with a failed leg; {_SLOTS_HELP}",
    ),
]

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

DurationOption = Annotated[float, number("--duration", DURATION_S, "Seconds to walk, {}.")]

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
        STEP_FRACTION,
        "Length of a step as a fraction of the robot's size, {}. (default: the robot's)",
    ),
]

HeightOption = Annotated[
    float | None,
    number(
        "--height",
        STEP_FRACTION,
        "Height of a step as a fraction of the robot's size, {}. (default: the robot's)",
    ),
]

SelfRotationOption = Annotated[SelfRotation, choice("--self-rotation", SelfRotation, SELF_ROTATION_HELP)]

WalkRotationOption = Annotated[
    AutoRotation,
    choice(
        "--self-rotation",
        AutoRotation,
        f"{SELF_ROTATION_HELP} auto: none with --gait auto or best where the line is held, else rear.",
    ),
]

BodyRaiseOption = Annotated[
    float | None,
    number(
        "--body-raise",
        POSTURE_FRACTION,
        "How much higher the body stands, as a fraction of the robot's size, {}. (default: 0; with "
        "--gait auto 0.012 off a locked leg that does not trail)",
    ),
]

StanceShiftOption = Annotated[
    str | None,
    typer.Option(
        "--stance-shift",
        help="How far the body stands forward and to the left over its feet, as fractions of the robot's "
        "size, such as 0.02,-0.01. (default: 0,0)",
    ),
]

TuckOption = Annotated[
    str | None,
    typer.Option("--tuck", help="Legs held up in the air, of 1..6, with commas. (default: none)"),
]

SwingShareOption = Annotated[
    float | None,
    number(
        "--swing-share",
        SWING,
        "How long a foot is in the air, as a fraction of the cycle, {}. (default: 1/3)",
    ),
]

ThenOption = Annotated[
    list[str] | None,
    typer.Option(
        "--then",
        help="Change the gait in stride, to one that --gait takes, such as wave@10: from 10 s on; may be "
        "given several times, with times that ascend. "
        "(default: never)",
    ),
]

HoldOption = Annotated[
    Hold,
    choice(
        "--hold",
        Hold,
        "Feedback keeps the walk on its line, by position and yaw, or keeps its heading, by yaw alone; none: "
        "open loop, as in the paper; auto is the best that the robot's state allows.",
    ),
]

TrimOption = Annotated[
    float | None,
    number(
        "--trim",
        TRIM_DEG,
        "With --hold heading, course correction in degrees, {}, counter-clockwise: after a walk that ended E "
        "to the left after S, -atan(E / S) more. (default: 0)",
    ),
]
