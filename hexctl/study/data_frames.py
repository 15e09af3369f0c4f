"""Helpers for the data frames of experiments."""

import math
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pandas import DataFrame


def where(rows: "DataFrame", **values: object) -> "DataFrame":
    """Return the rows in which columns have given values."""
    for column, value in values.items():
        rows = rows[rows[column] == value]
    return rows


def records(rows: "DataFrame") -> list[dict[str, Any]]:
    """Return the rows as plain JSON values."""
    return [{str(name): json_value(value) for name, value in row.items()} for row in rows.to_dict("records")]


def json_value(value: Any) -> Any:
    """Return a value of a frame for JSON: null for an unknown or infinite number."""
    value = value.item() if hasattr(value, "item") else value
    return None if isinstance(value, float) and not math.isfinite(value) else value
