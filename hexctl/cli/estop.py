"""`hexctl estop`: stop a robot from anywhere, without a lease; or clear the stop."""

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
    """Stop a robot on the network at once, from anywhere, whoever commands it.

    It holds its pose until the stop is cleared and somebody commands it anew.
    """
    from hexctl.cli.asking import stop_or_clear

    raise typer.Exit(
        stop_or_clear(
            clear=clear, endpoint=connect, credentials=keys, insecure=insecure, link=link, as_json=as_json
        )
    )
