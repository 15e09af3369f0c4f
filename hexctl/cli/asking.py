"""What `hexctl status` and `hexctl estop` do: ask every robot on a link, and show its answer."""

import json
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

import zenoh
from rich.console import Console
from rich.live import Live

from hexctl.backends.zenoh.client import ask, ask_until
from hexctl.cli.console import DONE, StopOnInterrupt, print_note, print_result
from hexctl.cli.statustext import status_table
from hexctl.errors import InputError, RobotFaultError
from hexctl.wire.links import KeyMap, Link, Role, load_link
from hexctl.wire.session import open_session

#: In place of a robot's name: whichever robot is on the link.
ANY_ROBOT = "*"

#: How long a robot may take to answer.
PATIENCE_S = 2.0

WATCH_PERIOD_S = 0.25


def show_status(*, watch: bool, as_json: bool, **options: Any) -> int:
    """Print what the robots on a link say of themselves and return the exit code."""
    if watch and as_json:
        raise InputError("--watch: got --json too; allowed: one or the other")
    with _session(Role.VIEWER, **options) as (session, keys, link):
        answers = ask_until(session, keys.describe, timeout_s=PATIENCE_S)
        if not answers:
            raise _silence(link)
        if watch:
            _watch(session, keys)
        elif as_json:
            print_result(json.dumps(_statuses(answers)[0]))
        else:
            Console().print(status_table(_statuses(answers)))
    return DONE


def stop_or_clear(*, clear: bool, as_json: bool, **options: Any) -> int:
    """Stop the robots on a link, or clear their stops, and return the exit code.

    Raises RobotFaultError unless a robot has confirmed it.
    """
    with _session(Role.CONTROLLER, **options) as (session, keys, link):
        wanted = {"op": "clear" if clear else "stop"}
        answers = ask_until(session, keys.estop, wanted, timeout_s=PATIENCE_S)
        if not answers:
            raise _silence(link)
    stopped = _confirmed(answers, clear=clear)
    if as_json:
        print_result(json.dumps({"stopped": stopped}))
    elif stopped is None:
        print_result("cleared; the robot moves when somebody commands it")
    else:
        print_result(f"stopped ({stopped}); hexctl estop --clear when it may move again")
    if clear and stopped is not None:
        print_note(f"hexctl: the robot stopped again at once: {stopped}")
    return DONE


def _confirmed(answers: list[dict[str, Any]], *, clear: bool) -> str | None:
    """Return why the robots are stopped now, None where all are free.

    Raises RobotFaultError unless every one of them has done what was asked.
    """
    for answer in answers:
        if "stopped" not in answer or (answer["stopped"] is None and not clear):
            raise RobotFaultError(f"a robot did not do it: {answer.get('error', answer)}")
    return next((str(answer["stopped"]) for answer in answers if answer["stopped"] is not None), None)


@contextmanager
def _session(
    role: Role, *, endpoint: str | None, credentials: Path | None, insecure: bool, link: str | None
) -> Iterator[tuple[zenoh.Session, KeyMap, Link]]:
    settings = load_link(link, endpoint=endpoint, credentials=credentials, insecure=insecure)
    keys = KeyMap.of(ANY_ROBOT).renamed(dict(settings.names))
    with open_session(settings, role, keys) as session:
        yield session, keys, settings


def _silence(link: Link) -> RobotFaultError:
    return RobotFaultError(
        f"no robot answers at {link.endpoint}; is hexctl serve running there, and may this end ask?"
    )


def _statuses(answers: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [answer.get("status", {}) for answer in answers]


def _watch(session: zenoh.Session, keys: KeyMap) -> None:
    """Show the status again and again until interrupted: in place on a screen, one after the other else."""
    console = Console()
    with StopOnInterrupt() as interrupt, ExitStack() as stack:
        live = stack.enter_context(Live(console=console, auto_refresh=False)) if console.is_terminal else None
        while not interrupt.requested():
            answers = ask(session, keys.describe, timeout_s=PATIENCE_S)
            shown = status_table(_statuses(answers)) if answers else "the robot is silent"
            if live is not None:
                live.update(shown, refresh=True)
            else:
                console.print(shown)
            time.sleep(WATCH_PERIOD_S)
