"""The option `--recover`, a short form of `--policy glide`."""

from typing import Annotated

import typer

from hexctl.errors import InputError

RecoverOption = Annotated[
    bool,
    typer.Option(
        "--recover",
        rich_help_panel="Failure",
        help="Walk on without a leg that fails, on the same line: --policy glide, the default in simulation.",
    ),
]


def recovery_policy(*, recover: bool, policy: str | None) -> str | None:
    """The policy of `--recover` and `--policy`; raises InputError where they contradict one another."""
    if recover and policy not in (None, "glide"):
        raise InputError(f"--policy: got {policy} with --recover, which is glide; allowed: one or the other")
    return "glide" if recover else policy
