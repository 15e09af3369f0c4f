"""The option `--recover`, a short form of `--policy glide`."""

from typing import Annotated, Any

import typer

from hexctl.errors import InputError


def _recover(text: str, *, rare: bool) -> Any:
    return typer.Option("--recover", rich_help_panel="Failure", hidden=rare, help=f"{text}: --policy glide.")


RecoverOption = Annotated[
    bool,
    _recover("Walk on without a leg that fails, on the same line, the default in simulation", rare=False),
]
TrialRecoverOption = Annotated[
    bool, _recover("If another leg fails during a trial, walk the trial to its end without it", rare=True)
]


def recovery_policy(*, recover: bool, policy: str | None) -> str | None:
    """The policy of `--recover` and `--policy`; raises InputError if they contradict."""
    if recover and policy not in (None, "glide"):
        raise InputError(f"--policy: got {policy} with --recover, which is glide; allowed: one or the other")
    return "glide" if recover else policy
