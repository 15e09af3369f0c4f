"""Options that several commands share, each defined once: its name, help, range, completion and check.

Light to import: `hexctl --help` needs only these.
"""

from pathlib import Path
from typing import Annotated, Any, Literal

import typer

from hexctl.cli import completion
from hexctl.cli.values import Range, choice, in_lower_case, listed, number
from hexctl.errors import InputError

#: Ranges of options. Where the library has the same limit, a test holds both together.
LEG = Range(low=1, high=6, whole=True)
SEED = Range(low=0, whole=True)
DURATION_S = Range(low=0, high=86_400, above=True, unit="s")
PACE_HZ = Range(low=0, high=10, above=True, unit="Hz")
STEP_FRACTION = Range(low=0, high=1, above=True)
TRIM_DEG = Range(low=-45, high=45)
POSTURE_FRACTION = Range(low=-0.2, high=0.2)
SWING = Range(low=0.1, high=0.5)
HEADING_DEG = Range()
TURN_DEG_S = Range(low=-360, high=360, unit="deg/s")
JOBS = Range(low=1, high=1024, whole=True)

ALL_LEGS = "1,2,3,4,5,6"

SelfRotation = Literal["rear", "front", "none"]
AutoRotation = Literal["auto", "rear", "front", "none"]
Hold = Literal["auto", "line", "heading", "none"]

WORLD_HELP = (
    "Simulated world: flat, slippery, slope, rough, a YAML file, or one of a family such as randomised:7."
)
FAILURE_HELP = (
    "What is wrong with the failed leg: locked (holds its stance), limp (no torque), missing, "
    "weak:FRACTION of its torque, 0..1 (0.3), stuck:JOINT:DEGREES with coxa, femur or tibia (coxa, 0), or "
    "unknown: the controller is not told, and a simulation draws one of these with the seed."
)
FAILED_LEG_HELP = f"Leg that failed, {LEG}, counter-clockwise from the front."
SELF_ROTATION_HELP = (
    "Turn before the walk until the failed leg points to the rear or the front of the way, or none: no turn."
)
SEED_HELP = f"Seed of everything random, a whole number, {SEED}: the same seed gives the same result."
ROBOT_HELP = (
    "Robot: ant, phantomx, pexod, phantomx-ax, makeyourpet, freenove-big, jethexa, lukas, or a path to a "
    "YAML file."
)

# What moves, and where.

BackendOption = Annotated[
    str,
    typer.Option(
        "--backend",
        callback=in_lower_case,
        autocompletion=completion.backends,
        help="What moves: sim (simulation), zenoh (a robot that hexctl serve puts on the network), "
        "mavlink (a servo board), dynamixel, feetech or lx16a (servos on a serial bus), servo2040 "
        "or pca9685 (boards of hobby servos), mock (no robot), or package.module:Class (your own servos).",
    ),
]


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
ConnectOption = Annotated[
    str | None,
    typer.Option(
        "--connect",
        help="Where the robot is. With --backend zenoh where hexctl serve listens, such as "
        "tcp/HOST:7447 or tls/HOST:7447 (default: tcp/127.0.0.1:7447); with mavlink the servo board's port, "
        "such as /dev/ttyACM0:115200 or udpout:HOST:PORT (default: udpout:127.0.0.1:14550); with dynamixel, "
        "feetech and lx16a that of the bus, such as /dev/ttyUSB0:1000000 (default: that of the robot file); "
        "with servo2040 that of the board, such as /dev/ttyACM0, and with pca9685 the I2C bus, such as 1 or "
        "/dev/i2c-1 (default: that of the robot file).",
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
        "--insecure",
        help="Go without certificates beyond this computer: every client there can move the robot.",
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

# How it walks.

_SLOTS_HELP = "or when in the cycle legs 1..6 step, six slots such as 5,1,2,4,3,6."
GaitOption = Annotated[
    str,
    typer.Option(
        "--gait",
        callback=in_lower_case,
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
        callback=in_lower_case,
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

# What has failed.

#: Failed leg `auto`: a diagnosis finds it.
AUTO_LEG = 0


def leg_or_auto(text: str | int) -> int:
    """Number of a leg, or `AUTO_LEG` for `auto`."""
    try:
        return AUTO_LEG if text == "auto" else int(LEG.parse(text))
    except typer.BadParameter:
        raise typer.BadParameter(f"got {text}; allowed: {LEG}, auto") from None


def legs_or_auto(text: str | tuple[int, ...]) -> tuple[int, ...]:
    """Numbers of legs with commas, or `AUTO_LEG` alone for `auto`."""
    if not isinstance(text, str):
        return text
    try:
        return (AUTO_LEG,) if text == "auto" else tuple(int(LEG.parse(part)) for part in listed(text) or [""])
    except typer.BadParameter:
        raise typer.BadParameter(f"got {text}; allowed: {LEG}, several with commas, auto") from None


def listed_legs(text: str, flag: str = "--legs") -> tuple[int, ...]:
    """Legs of a text such as `2,5`, ascending; raises InputError for anything but numbers."""
    try:
        return tuple(sorted(int(part) for part in listed(text)))
    except ValueError:
        raise InputError(f"{flag}: got {text!r}; allowed: numbers {LEG} with commas, such as 2,5") from None


def complete_leg(incomplete: str) -> list[str]:
    """Legs and `auto`, which the shell offers."""
    return [*LEG.complete(incomplete), *(["auto"] if "auto".startswith(incomplete) else [])]


AUTO_LEG_HELP = (
    f"{FAILED_LEG_HELP[:-1]}; or auto: hexctl diagnose finds it first. With auto, --failure is what a "
    "simulation breaks, as 5:limp."
)
FailedLegOption = Annotated[
    Any,
    typer.Option(
        "--failed-leg",
        parser=legs_or_auto,
        metavar="LEGS",
        autocompletion=complete_leg,
        help=f"{AUTO_LEG_HELP} Several with commas, such as 2,5, then with one --failure for all or one for "
        "each (limp,locked). (default: none)",
    ),
]
LegsOption = Annotated[str, typer.Option("--legs", help=f"Failed legs, of {LEG}, with commas.")]
FailureOption = Annotated[
    str | None,
    typer.Option("--failure", autocompletion=completion.failures, help=f"{FAILURE_HELP} (default: locked)"),
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
FailOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fail",
        help="With sim, let a leg fail during the walk, untold: LEG:FAILURE@SECONDS, such as 5:locked@8 or "
        "2:stuck:femur@4, FAILURE as with --failure but unknown; a joint sticks where it is. May be given "
        "several times. (default: never)",
    ),
]
HealOption = Annotated[
    list[str] | None,
    typer.Option(
        "--heal",
        help="With sim, let a leg be whole again: LEG@SECONDS, such as 5@20. May be given several times. "
        "(default: never)",
    ),
]
RecoverOption = Annotated[
    bool,
    typer.Option(
        "--recover",
        help="Walk on without a leg that fails: glide to a gait for the others, on the same line. It is "
        "--policy glide.",
    ),
]
PolicyOption = Annotated[
    str | None,
    typer.Option(
        "--policy",
        help="What to do about a leg that is noticed to have failed: walk-on, stop, glide, or "
        "package.module:Class. (default: walk-on with sim, else stop)",
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
SimFailedLegOption = Annotated[
    int | None, number("--failed-leg", LEG, f"{FAILED_LEG_HELP} Only with sim. (default: none)")
]
SimFailureOption = Annotated[
    str | None,
    typer.Option(
        "--failure",
        autocompletion=completion.failures,
        help=f"{FAILURE_HELP} Only with sim. (default: locked)",
    ),
]

# How a simulation is spread, and what is printed.

JobsOption = Annotated[
    int | None,
    number("--jobs", JOBS, "Threads that simulate, {}. (default: all cores; with --dask 1)"),
]
DaskOption = Annotated[
    str | None,
    typer.Option(
        "--dask",
        help="Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT. (default: this computer)",
    ),
]
JsonOption = Annotated[bool, typer.Option("--json", help="Print one JSON object on stdout and nothing else.")]


def recovery_policy(*, recover: bool, policy: str | None) -> str | None:
    """The policy of `--recover` and `--policy`; raises InputError where they contradict one another."""
    if recover and policy not in (None, "glide"):
        raise InputError(f"--policy: got {policy} with --recover, which is glide; allowed: one or the other")
    return "glide" if recover else policy
