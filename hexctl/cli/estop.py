"""`hexctl estop`: stop a robot from anywhere, without a lease; or clear the stop."""

import json
from typing import Annotated

import typer

from hexctl.cli.options import InsecureOption, JsonOption, KeysOption, LinkOption, ZenohConnectOption


def estop(
    clear: Annotated[
        bool, typer.Option("--clear", help="Clear the stop: the robot may be commanded again.")
    ] = False,
    connect: ZenohConnectOption = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
    as_json: JsonOption = False,
) -> None:
    """Stop a robot on the network from anywhere, whichever client commands it.

    It holds its pose until the stop is cleared and a client commands it again. A fault that is still there
    is not cleared: exit code 3.
    """
    from hexctl.cli.console import FAULT, print_note, print_result
    from hexctl.serve.remote import remote_robots
    from hexctl.wire.description import RobotIdentity
    from hexctl.wire.links import Role

    with remote_robots(
        Role.CONTROLLER, connect=connect, credentials=keys, insecure=insecure, link=link
    ) as robots:
        answers = robots.clear() if clear else robots.stop()
    refused = next((str(answer["error"]) for answer in answers if clear and "error" in answer), None)
    stopped = next((str(answer["stopped"]) for answer in answers if answer["stopped"] is not None), None)
    if as_json:
        print_result(json.dumps({"stopped": stopped, "robots": answers}))
    elif refused is not None:
        print_result(f"not cleared, it is still stopped ({stopped}): {refused}")
    elif clear and stopped is not None:
        print_result(f"not cleared, it is still stopped ({stopped}); see to it, then hexctl estop --clear")
    elif stopped is None:
        print_result("cleared; the robot moves when a client commands it")
    else:
        print_result(f"stopped ({stopped}); hexctl estop --clear when it may move again")
    for answer in answers:
        if isinstance(meant := answer.get("cleared"), dict):
            print_note(f"hexctl: the stop was {meant.get('id')}, {meant.get('since_s')} s before")
        print_note(f"hexctl: the robot is {RobotIdentity.of_answer(answer)}")
    if clear and stopped is not None:
        raise typer.Exit(FAULT)
