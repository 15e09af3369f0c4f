"""Output about servos on a bus, and about serial ports."""

from collections.abc import Mapping, Sequence
from typing import Any

from hexctl.cli.render.tables import PlainTable, plain_table

#: Units of a servo's values; its position is raw.
UNITS = {"position": "counts", "voltage": "V", "temperature": "°C"}


def with_units(servo: Mapping[str, Any]) -> dict[str, Any]:
    """Values of a servo with units; its model's number only if the model has no name."""
    row = {
        name: value if value is None or name not in UNITS else f"{value} {UNITS[name]}"
        for name, value in servo.items()
        if name not in ("model_number", "protocol", "firmware", "variant")
    }
    if servo["model"] is None and servo["model_number"] is not None:
        row["model"] = f"number {servo['model_number']}"
    return row


def value_table(values: Mapping[str, Any]) -> PlainTable:
    """Names and values, one pair a line."""
    table = plain_table("what", "value")
    for name, value in values.items():
        shown = " ".join(map(str, value)) if isinstance(value, tuple) else value
        table.add_row(name, "" if shown is None else str(shown))
    return table


def row_table(rows: Sequence[Mapping[str, Any]]) -> PlainTable:
    """One or more rows under the names of their values."""
    table = plain_table(*rows[0])
    for row in rows:
        table.add_row(*("" if value is None else str(value) for value in row.values()))
    return table
