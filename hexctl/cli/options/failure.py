"""Options that say what has failed, what will, and what is done about it."""

from typing import Annotated, Any

import typer

from hexctl.cli import completion
from hexctl.cli.values import number
from hexctl.errors import InputError
from hexctl.options import Range, listed

#: Ranges of options. Where the library has the same limit, a test holds both together.
LEG = Range(low=1, high=6, whole=True)

FAILURE_HELP = (
    "How it failed: locked (stiff), limp, missing, weak:FRACTION of its torque, 0..1 (0.3), "
    "stuck:JOINT:DEGREES with coxa, femur or tibia (coxa, 0), or unknown to the controller."
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


def complete_leg(incomplete: str) -> list[str]:
    """Legs and `auto`, which the shell offers."""
    return [*LEG.complete(incomplete), *(["auto"] if "auto".startswith(incomplete) else [])]


AUTO_LEG_HELP = f"{FAILED_LEG_HELP[:-1]}; auto: hexctl diagnose finds it."

FailedLegOption = Annotated[
    Any,
    typer.Option(
        "--failed-leg",
        parser=legs_or_auto,
        metavar="LEGS",
        autocompletion=complete_leg,
        help=f"{AUTO_LEG_HELP} Several with commas, such as 2,5, with one --failure or one for each. "
        "(default: none)",
    ),
]

FailureOption = Annotated[
    str | None,
    typer.Option("--failure", autocompletion=completion.failures, help=f"{FAILURE_HELP} (default: locked)"),
]

FailOption = Annotated[
    list[str] | None,
    typer.Option(
        "--fail",
        help="In a simulation, let a leg fail during the walk: LEG:FAILURE@SECONDS, such as 5:locked@8 or "
        "2:stuck:femur@4. Repeatable. (default: never)",
    ),
]

HealOption = Annotated[
    list[str] | None,
    typer.Option(
        "--heal",
        hidden=True,
        help="In a simulation, let a leg be whole again: LEG@SECONDS, such as 5@20. Repeatable. "
        "(default: never)",
    ),
]

RecoverOption = Annotated[
    bool,
    typer.Option(
        "--recover",
        help="Walk on without a leg that fails, on the same line: --policy glide.",
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
