"""Connect a run while Ctrl-C requests a soft stop."""

from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from hexctl.cli.console import INTERRUPTED, StopOnInterrupt, print_message
from hexctl.errors import RobotFaultError
from hexctl.wire.links import load_link

if TYPE_CHECKING:
    from hexctl.runs.run import Run
    from hexctl.runs.run_spec import RunSpec


@contextmanager
def connected(run: "Run") -> Iterator[StopOnInterrupt]:
    """Connect a run and print its notes; ends the command if it is interrupted before that.

    If robot or link fail later, a message names the recording.
    """
    with ExitStack() as stack:
        interrupt = stack.enter_context(StopOnInterrupt())
        try:
            stack.enter_context(run)
        except RobotFaultError:
            if interrupt.requested():
                raise _never_commanded() from None
            raise
        for note in run.notes:
            print_message(note)
        try:
            yield interrupt
        except RobotFaultError:
            if run.recording_path is not None:
                again = "" if run.spec.record is None else "; to repeat it, give another --record"
                print_message(f"recorded until then: {run.recording_path}{again}")
            raise


def check_commanded(outcome: Mapping[str, Any]) -> None:
    """End the command if it was interrupted before the first command to the robot."""
    if outcome["stopped"] == "requested" and not outcome["ticks"]:
        raise _never_commanded()


def _never_commanded() -> typer.Exit:
    print_message("interrupted before the robot was commanded: nothing was recorded")
    return typer.Exit(INTERRUPTED)


def clear_command(spec: "RunSpec") -> str | None:
    """Command that clears a stop of the served robot, None if this process moves it.

    It is read before a walk, which may outlast a link file.
    """
    if spec.backend != "zenoh":
        return None
    keys = None if spec.credentials is None else Path(spec.credentials)
    return load_link(spec.link, connect=spec.connect, credentials=keys, insecure=spec.insecure).clear_command
