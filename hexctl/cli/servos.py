"""`hexctl servos` and `hexctl ports`: look at servos on a bus, and at serial ports, without a robot file."""

import json
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from hexctl.cli.board import BAUD
from hexctl.cli.options import JsonOption, Range, choice, number

if TYPE_CHECKING:
    from rich.table import Table

servos = typer.Typer(
    help="Look at servos on a serial bus, before there is a robot file.", no_args_is_help=True
)

BusDriver = Literal["dynamixel", "feetech"]
SERVO_ID = Range(low=0, high=252, whole=True)

DriverOption = Annotated[
    str,
    choice(
        "--driver",
        BusDriver,
        "Whose protocol the servos speak: dynamixel or feetech. (default: none, it must be given)",
    ),
]
PortOption = Annotated[
    str,
    typer.Option(
        "--port", help="Serial device of the bus, such as /dev/ttyUSB0. (default: none, it must be given)"
    ),
]
BaudOption = Annotated[int, number("--baud", BAUD, "Bits per second, {}.")]


@servos.command()
def scan(
    driver: DriverOption, port: PortOption, baud: BaudOption = 1_000_000, as_json: JsonOption = False
) -> None:
    """Ask all ids which servos answer: model, position, voltage, temperature. Nothing moves."""
    from hexctl.backends.bus.scan import scan_bus
    from hexctl.backends.bus.servos import parse_bus_port
    from hexctl.cli.console import print_note, print_result

    path, speed = parse_bus_port(port, int(baud), driver=driver)
    found = scan_bus(path, driver, speed)
    if unknown := [each.servo_id for each in found if each.model is None]:
        print_note(f"{len(unknown)} servos are of a model that is not known: is {driver} the right driver?")
    if as_json:
        print_result(json.dumps([each.to_json() for each in found]))
        return
    none = f"no servo answers on {path} at {speed} baud"
    print_result(_table([each.to_json() for each in found], none))


@servos.command("set-id")
def set_id(
    new_id: Annotated[
        int,
        typer.Argument(
            parser=SERVO_ID.parse,
            metavar="ID",
            help="The id to give, a whole number 0..252.",
            show_default=False,
        ),
    ],
    driver: DriverOption,
    port: PortOption,
    baud: BaudOption = 1_000_000,
    as_json: JsonOption = False,
) -> None:
    """Give the only servo on the bus another id; with more than one nothing is changed."""
    from hexctl.backends.bus.scan import set_servo_id
    from hexctl.cli.console import print_result

    servo = set_servo_id(port, driver, int(baud), int(new_id)).to_json()
    print_result(json.dumps(servo)) if as_json else print_result(_table([servo], ""))


def ports(as_json: JsonOption = False) -> None:
    """List serial ports, with the adapters behind them."""
    from serial.tools.list_ports import comports

    from hexctl.cli.console import print_result

    found: list[dict[str, Any]] = [
        {
            "port": each.device,
            "adapter": each.description,
            "vendor": None if each.vid is None else f"{each.vid:04x}:{each.pid:04x}",
            "serial_number": each.serial_number,
        }
        for each in sorted(comports())
        if each.vid is not None or "tty" in each.device
    ]
    if as_json:
        print_result(json.dumps(found))
        return
    print_result(_table(found, "no serial ports; is the adapter plugged in?"))


def _table(rows: list[dict[str, Any]], empty: str) -> "Table | str":
    """Rows as a table, or what is said of none."""
    from hexctl.cli.render import plain_table

    if not rows:
        return empty
    table = plain_table(*rows[0])
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    return table
