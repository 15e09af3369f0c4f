"""`hexctl status`: what a robot on the network says of itself."""

from typing import Annotated

import typer

from hexctl.cli.options import InsecureOption, JsonOption, KeysOption, LinkOption, ZenohConnectOption


def status(
    connect: ZenohConnectOption = None,
    keys: KeysOption = None,
    insecure: InsecureOption = False,
    link: LinkOption = None,
    watch: Annotated[bool, typer.Option("--watch", help="Keep showing it, until Ctrl-C.")] = False,
    as_json: JsonOption = False,
) -> None:
    """Show who commands a robot on the network, why it is stopped, what was dropped."""
    from hexctl.cli.asking import show_status

    raise typer.Exit(
        show_status(
            endpoint=connect, credentials=keys, insecure=insecure, link=link, watch=watch, as_json=as_json
        )
    )
