"""Options that say what has failed, what will, and what is done about it."""

from typing import Annotated

import typer

from hexctl.cli import completion
from hexctl.errors import InputError
from hexctl.options import Range

#: Ranges of options. Where the library has the same limit, a test holds both together.
LEG = Range(low=1, high=6, whole=True)

ALL_LEGS = "1,2,3,4,5,6"

#: The kinds of failures that studies give to each leg of `--legs`.
KIND_HELP = (
    "How each leg failed: locked (stiff), limp, missing, weak:FRACTION of its torque, 0..1 (0.3), "
    "stuck:JOINT:DEGREES with coxa, femur or tibia (coxa, 0), or unknown to the controller."
)

FAILED_LEG_HELP = f"Legs that failed, {LEG}, with commas: short for --failure LEG:locked."

FAILURE_HELP = (
    "How a leg failed: LEG:KIND, such as 5:limp, 5:limp:femur, 5:weak:0.3, 5:missing, 5:locked, "
    "5:stuck:coxa:30 (jammed at 30 degrees) or 5:unknown. Repeatable."
)

FailedLegOption = Annotated[
    str | None,
    typer.Option(
        "--failed-leg",
        metavar="LEGS",
        autocompletion=LEG.complete,
        hidden=True,
        help=f"{FAILED_LEG_HELP} A simulation breaks them, and the drive knows of it. (default: none)",
    ),
]

LegsOption = Annotated[str, typer.Option("--legs", help=f"Failed legs, of {LEG}, with commas.")]

FailureOption = Annotated[
    list[str] | None,
    typer.Option(
        "--failure",
        autocompletion=completion.failures,
        help=f"{FAILURE_HELP} With @SECONDS a simulated leg fails during the drive, such as 5:stuck:coxa@8. "
        "(default: none)",
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
    str | None,
    typer.Option(
        "--failed-leg",
        metavar="LEGS",
        autocompletion=LEG.complete,
        help=f"{FAILED_LEG_HELP} Only with sim. (default: none)",
    ),
]

SimFailureOption = Annotated[
    list[str] | None,
    typer.Option(
        "--failure",
        autocompletion=completion.failures,
        help=f"{FAILURE_HELP} Only with sim. (default: none)",
    ),
]


def recovery_policy(*, recover: bool, policy: str | None) -> str | None:
    """The policy of `--recover` and `--policy`; raises InputError where they contradict one another."""
    if recover and policy not in (None, "glide"):
        raise InputError(f"--policy: got {policy} with --recover, which is glide; allowed: one or the other")
    return "glide" if recover else policy
