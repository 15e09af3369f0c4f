"""`hexctl sim fail` and `heal`: let legs of a served simulation fail and heal in mid-walk."""

import json
from collections.abc import Callable
from typing import TYPE_CHECKING, Annotated, Any

import typer

from hexctl.cli.output_options import JsonOption
from hexctl.cli.signature import with_options
from hexctl.cli.values import checked
from hexctl.robot.failure_grammar import parse_leg
from hexctl.wire.links import LinkOptions

if TYPE_CHECKING:
    from hexctl.client.remote import RemoteRobots


@with_options(LinkOptions)
def fail(
    place: dict[str, Any],
    failure: Annotated[
        str,
        typer.Argument(
            metavar="LEG:KIND",
            help="Which leg, and how: 5:locked, 5:limp, 5:limp:femur, 5:missing, 5:weak:0.3, 5:stuck:femur "
            "(jams where it is).",
            show_default=False,
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Let a leg of a simulated robot fail now; its walk has to detect that.

    The walk stops then, or changes gait if it was begun with --recover.
    """
    _change(lambda robots: robots.fail(failure), place, as_json=as_json)


@with_options(LinkOptions)
def heal(
    place: dict[str, Any],
    leg: Annotated[
        int,
        typer.Argument(
            parser=checked(parse_leg), metavar="LEG", help="Which leg that failed, 1..6.", show_default=False
        ),
    ],
    as_json: JsonOption = False,
) -> None:
    """Let a leg of a simulated robot work again."""
    _change(lambda robots: robots.heal(leg), place, as_json=as_json)


def _change(
    change: "Callable[[RemoteRobots], list[dict[str, Any]]]",
    place: dict[str, Any],
    *,
    as_json: bool,
) -> None:
    from hexctl.cli.console import print_note, print_result
    from hexctl.client.remote import remote_robots
    from hexctl.wire.links import Role, load_link

    with remote_robots(load_link(**place), Role.CONTROLLER) as robots:
        answers = change(robots)
    failures = [str(failure) for answer in answers for failure in answer["failures"]]
    for note in sorted({str(answer["note"]) for answer in answers if "note" in answer}):
        print_note(f"hexctl: {note}")
    if as_json:
        print_result(json.dumps({"failures": failures, "robots": answers}))
    else:
        print_result(f"failed now: {', '.join(failures) or 'none'}")
