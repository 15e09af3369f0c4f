"""Printing to whoever reads; one that has gone, as `head` does, is no fault of ours."""

import os
import sys

import typer

from hexctl.errors import RobotFaultError


def say(text: str) -> None:
    """Print text on stdout."""
    try:
        typer.echo(text)
        sys.stdout.flush()
    except BrokenPipeError:
        # Python must not complain about the closed pipe again while it exits.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except OSError as error:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise RobotFaultError(f"the result cannot be printed: {error.strerror}") from error


def say_aside(text: str) -> None:
    """Print a line on stderr, for a person who watches."""
    typer.echo(text, err=True)
