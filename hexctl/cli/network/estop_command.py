"""`hexctl estop`: stop a robot from anywhere, without a lease; or clear the stop."""

import os
import select
import signal
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from functools import partial
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.console import (
    FAULT,
    INTERRUPTED,
    in_flags,
    note_refusal,
    print_message,
    print_note,
    print_result,
)
from hexctl.cli.interrupts import NOT_CONFIRMED
from hexctl.cli.network.early_stop import take_stop
from hexctl.cli.shared_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.errors import InputError, RobotFaultError, printable
from hexctl.wire.connection_diagnosis import RefusalWatch
from hexctl.wire.links import Link, LinkOptions, Role, load_link

if TYPE_CHECKING:
    from hexctl.client.stop_client import ReadyStop, StopResult

#: Polling interval of keys and buttons.
LOOK_S = 0.01

#: How long `--json` waits for the robot's identity after the robot is at rest.
IDENTITY_S = 1.5


@with_options(LinkOptions)
def estop(
    place: dict[str, Any],
    clear: Annotated[
        bool, typer.Option("--clear", help="Clear the stop: the robot may be commanded again.")
    ] = False,
    ready: Annotated[
        bool,
        typer.Option(
            "--ready",
            help="Connect now, and stop the robot when a key of this terminal or a button of a gamepad is "
            "pressed, or when the terminal goes; Ctrl-C ends it without a stop.",
        ),
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Stop a robot on the network from anywhere, whichever client commands it.

    By datagram and by session at once, until it is at rest and stays so. It holds its pose until the stop is
    cleared and a client commands it again. A fault that persists is not cleared: exit code 3. In a
    terminal it then watches the robot until Ctrl-C, and reports if the stop is cleared.
    """
    if clear and ready:
        raise InputError("--ready cannot be combined with --clear")
    if clear:
        _clear(place, as_json=as_json)
        return
    with ExitStack() as opened:
        with _with_what_to_do(ready=ready):
            from hexctl.client.stop_client import ReadyStop

            begun = take_stop(place)
            stop = opened.enter_context(ReadyStop(**place, again=ready) if begun is None else begun)
            if ready:
                _wait_for_a_press(stop)
            # Not before the stop: the refusal is reported on the watch's thread.
            known, note = partial(_is_known, stop), partial(note_refusal, then=f". {NOT_CONFIRMED}")
            with RefusalWatch(stop.link.endpoint, note, answered=known):
                result = stop.wait_for_rest(identity_s=IDENTITY_S if as_json else 0.0)
        _print(result, stop.link, as_json=as_json)
        if not as_json and all(stream.isatty() for stream in (sys.stdin, sys.stdout, sys.stderr)):
            _watch(stop, result)


def _watch(stop: "ReadyStop", result: "StopResult") -> None:
    """Report if the stop is cleared or the robot moves, until Ctrl-C."""
    print_message("watching whether it stays stopped; Ctrl-C ends the watch, not the stop")
    with suppress(KeyboardInterrupt):
        for line in stop.watch(result):
            print_message(f"{time.strftime('%H:%M:%S')} {line}")


def _is_known(stop: "ReadyStop") -> bool:
    """An answer of a robot, or wrong certificates, explain more than a refused connection."""
    from hexctl.wire.certificates import find_credentials

    try:
        if stop.link.credentials is not None:
            find_credentials(stop.link.credentials, Role.CONTROLLER)
    except InputError:
        return True
    return bool(stop.reach.ways)


@contextmanager
def _with_what_to_do(*, ready: bool) -> Iterator[None]:
    """Append the operator's next step to each failure of a stop."""
    try:
        yield
    except (InputError, RobotFaultError) as error:
        why = in_flags(error)
        raise type(error)(f"{why}{'' if why.endswith('?') else '.'} {NOT_CONFIRMED}") from error.__cause__
    except KeyboardInterrupt:
        ended = "ended, which is no stop" if ready else "interrupted"
        print_message(f"{ended}. {NOT_CONFIRMED}")
        raise typer.Exit(INTERRUPTED) from None


def _print(result: "StopResult", link: "Link", *, as_json: bool) -> None:
    """The robot's identity is available only by session."""
    from hexctl.wire.description import RobotIdentity

    if as_json:
        print_result(
            {
                "stopped": result.stopped,
                "stop_id": result.stop_id,
                "at_rest": result.at_rest,
                "echoed": result.echoed,
                "kept": result.on_disk,
                "ways": result.ways,
                "took_s": round(result.took_s, 3),
                "rested_s": round(result.rested_s, 3),
                "robots": result.answers,
            }
        )
    else:
        told = f"stopped ({printable(str(result.stopped))}), {_rest_in_words(result)}"
        print_result(f"{told}; {link.clear_command} when it may move again")
    print_message(
        f"confirmed by {' and '.join(result.ways)}, stopped after {1000 * result.took_s:.0f} ms, "
        f"{'no new targets' if result.echoed else 'at rest'} after {1000 * result.rested_s:.0f} ms"
    )
    if result.stop_id is not None and not result.on_disk:
        print_message(
            "warning: the robot has not kept the stop on its disk; a restart of hexctl serve ends it"
        )
    for answer in result.answers:
        print_message(f"the robot is {RobotIdentity.of_answer(answer)}")
    if not result.answers:
        print_message(f"the robot is {result.robot}; it answered by datagram")


def _rest_in_words(result: "StopResult") -> str:
    if result.echoed:
        return "its targets no longer change (its servos do not report where they are: look at the robot)"
    return "at rest"


def _clear(place: dict[str, Any], *, as_json: bool) -> None:
    from hexctl.client.remote import remote_robots
    from hexctl.wire.description import RobotIdentity

    with remote_robots(load_link(**place), Role.CONTROLLER) as robots:
        answers, again = robots.clear(waiting=_note_wait), robots.link.clear_command
    refused = next((str(answer["error"]) for answer in answers if "error" in answer), None)
    stopped = next((str(answer["stopped"]) for answer in answers if answer["stopped"] is not None), None)
    if as_json:
        print_result({"stopped": stopped, "robots": answers})
    elif refused is not None:
        print_result(printable(f"not cleared, it is still stopped ({stopped}): {refused}"))
    elif stopped is not None:
        print_result(
            printable(f"not cleared, it is still stopped ({stopped}); remove the cause, then {again}")
        )
    elif all(answer.get("cleared") is None for answer in answers):
        print_result("no stop was in force; the robot moves when a client commands it")
    else:
        print_result("cleared; the robot moves when a client commands it")
    for answer in answers:
        if isinstance(meant := answer.get("cleared"), dict):
            print_note(printable(f"hexctl: the stop was {meant.get('id')}, {meant.get('since_s')} s before"))
        print_message(f"the robot is {RobotIdentity.of_answer(answer)}")
    if stopped is not None:
        raise typer.Exit(FAULT)


def _note_wait(by: str, wait_s: float) -> None:
    """Report a wait for a stop of which this user has no key."""
    print_message(
        f"{printable(by)} asked for the stop; this user can clear it in {wait_s:.0f} s. "
        "Waiting (Ctrl-C leaves it stopped)"
    )


def _wait_for_a_press(stop: "ReadyStop") -> None:
    """Report changes of the connection until a key or a button is pressed."""
    from hexctl.teleop.gamepad import StopButton
    from hexctl.teleop.keyboard import has_keys

    button, told, terminal = StopButton(), "", has_keys()
    if not terminal and not _has_gamepad():
        raise InputError("--ready: got no terminal to read keys from and no gamepad; allowed: either")
    began_s = time.monotonic()
    with _keys(terminal=terminal) as key_pressed:
        try:
            while not (key_pressed() or button.pressed()):
                reach = stop.reach
                line = f"{reach}; {_what_stops(keys=terminal, gamepads=button.connected)}"
                begun = told or reach.ways or time.monotonic() - began_s > 1
                if line != told and begun and _takes_text():
                    with suppress(OSError):
                        print_message(f"{time.strftime('%H:%M:%S')} {line}")
                    told = line
                time.sleep(LOOK_S)
            stop.press()
        finally:
            button.close()


def _what_stops(*, keys: bool, gamepads: int) -> str:
    """Keys and gamepads that stop the robot, for an operator: gamepads are plugged in and out."""
    ways = [*(["any key"] if keys else []), *(["any button of a gamepad"] if gamepads else [])]
    return f"{' or '.join(ways)} stops it" if ways else "NOTHING HERE STOPS IT: no gamepad is plugged in"


def _takes_text() -> bool:
    """Whether output is immediate: a blocked terminal must not delay keys."""
    try:
        return bool(select.select([], [sys.stderr], [], 0)[1])
    except (OSError, ValueError):
        return True  # not a file: it does not block


def _has_gamepad() -> bool:
    from hexctl.teleop.gamepad import find_stop_pads

    return bool(find_stop_pads())


@contextmanager
def _keys(*, terminal: bool) -> Iterator[Callable[[], bool]]:
    """Whether a key was pressed or the terminal closed; keys are unbuffered and unechoed."""
    if not terminal:
        yield lambda: False
        return
    from hexctl.teleop.keyboard import single_keys

    keys = sys.stdin.fileno()
    gone: list[int] = []
    hung_up = signal.signal(signal.SIGHUP, lambda *_: gone.append(1))

    def pressed() -> bool:
        if gone:
            return True
        try:
            ready, _, _ = select.select([keys], [], [], 0)
            if ready:
                os.read(keys, 256)  # a closed terminal returns no bytes
        except OSError:
            return True
        return bool(ready)

    try:
        with single_keys(keys):
            yield pressed
    finally:
        signal.signal(signal.SIGHUP, hung_up)
