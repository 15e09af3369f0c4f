"""`hexctl ports`: serial ports of this computer."""

from dataclasses import asdict
from typing import Annotated

import typer

from hexctl.backends.serial_ports import SerialPort, serial_ports, unplugged_port
from hexctl.cli.console import INTERRUPTED, StopOnInterrupt, print_message, print_note, print_result
from hexctl.cli.shared_options import JsonOption

#: Time to pull the cable of an adapter.
FIND_TIMEOUT_S = 60.0


def ports(
    find: Annotated[
        bool, typer.Option("--find", help="Find the port of an adapter: pull its cable when asked to.")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """List serial ports with a device, and their adapters."""
    from hexctl.cli.render.tables import row_table

    found = [_found_port()] if find else serial_ports()
    rows = [asdict(each) for each in found if each is not None]
    if as_json:
        print_result(rows)
        return
    print_result(row_table(rows) if rows else "no serial ports")
    if not any(row["vendor"] for row in rows):
        print_message("no USB serial adapter found: plug it in, with a cable that carries data")


def _found_port() -> "SerialPort | None":
    before = serial_ports()
    print_note(f"{len(before)} ports; now pull the cable of the adapter (Ctrl-C ends it)")
    with StopOnInterrupt(plain=True) as interrupt:
        found = unplugged_port(before, timeout_s=FIND_TIMEOUT_S, stop_requested=interrupt.requested)
        if interrupt.requested():
            raise typer.Exit(INTERRUPTED)
    print_note("found it; plug it in again")
    return found
