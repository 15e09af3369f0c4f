"""Options that say what has failed, what will, and what is done about it."""

from typing import Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.values import listed, number
from hexctl.errors import InputError
from hexctl.options import Range

#: Ranges of options. Where the library has the same limit, a test holds both together.
LEG = Range(low=1, high=6, whole=True)

ALL_LEGS = "1,2,3,4,5,6"

FAILURE_HELP = (
    "What is wrong with the failed leg: locked (holds its stance), limp (no torque), missing, "
    "weak:FRACTION of its torque, 0..1 (0.3), stuck:JOINT:DEGREES with coxa, femur or tibia (coxa, 0), or "
    "unknown: the controller is not told, and a simulation draws one of these with the seed."
)

FAILED_LEG_HELP = f"Leg that failed, {LEG}, counter-clockwise from the front."

#: Failed leg `auto`: a diagnosis finds it.
AUTO_LEG = 0


def leg_or_auto(text: str | int) -> int:
    """Number of a leg, or `AUTO_LEG` for `auto`."""
    try:
        return AUTO_LEG if text == "auto" else int(LEG.parse(text))
    except ValueError:
        raise typer.BadParameter(f"got {text}; allowed: {LEG}, auto") from None


def legs_or_auto(text: str | tuple[int, ...]) -> tuple[int, ...]:
    """Numbers of legs with commas, or `AUTO_LEG` alone for `auto`."""
    if not isinstance(text, str):
        return text
    try:
        return (AUTO_LEG,) if text == "auto" else tuple(int(LEG.parse(part)) for part in listed(text) or [""])
    except ValueError:
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


def recovery_policy(*, recover: bool, policy: str | None) -> str | None:
    """The policy of `--recover` and `--policy`; raises InputError where they contradict one another."""
    if recover and policy not in (None, "glide"):
        raise InputError(f"--policy: got {policy} with --recover, which is glide; allowed: one or the other")
    return "glide" if recover else policy
