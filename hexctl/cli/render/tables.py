"""Tables without lines: of labels, of values, and of servos and serial ports."""

from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from rich.cells import cell_len
from rich.console import Console, ConsoleOptions, RenderableType, RenderResult
from rich.table import Table
from rich.text import Text

from hexctl.errors import printable

#: Width of the labels of a summary.
LABEL_WIDTH = 9


#: Least width of a column whose texts wrap.
WRAPPED_WIDTH = 20


class PlainTable(Table):
    """A table of literal texts: no markup, no emoji, nothing unprintable.

    Columns that do not wrap are never cut: on a narrow terminal lines are longer than it.
    """

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row of texts or renderables."""
        for column, cell in zip(self.columns, cells, strict=False):
            if column.no_wrap and isinstance(cell, str):
                column.min_width = max(column.min_width or 0, cell_len(printable(cell)))
        super().add_row(*(_shown(cell) if isinstance(cell, str) else cell for cell in cells), **options)

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        """Render at least as wide as its columns that are never cut."""
        gap = self.padding[1] + self.padding[3]
        least = sum((column.min_width or 1) + gap for column in self.columns)
        return super().__rich_console__(console, options.update_width(max(options.max_width, least)))


def _shown(text: str) -> Text:
    return Text("\n".join(map(printable, text.split("\n"))))


def plain_table(*columns: str) -> PlainTable:
    """Table without lines; the first column and unnamed ones are left-aligned, the others right-aligned.

    Texts of unnamed columns wrap.
    """
    table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(columns))
    for number, column in enumerate(columns):
        left = number == 0 or not column
        table.add_column(
            Text(printable(column), style="bold"),
            justify="left" if left else "right",
            no_wrap=bool(column),
            min_width=cell_len(column) or WRAPPED_WIDTH,
        )
    return table


def label_table(rows: Iterable[tuple[str, str | Text]]) -> PlainTable:
    """Two columns, labels and texts; a long text is wrapped in its column."""
    table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(no_wrap=True, min_width=LABEL_WIDTH)
    table.add_column(overflow="fold")
    for label, text in rows:
        table.add_row(label, text)
    return table


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
    """One or more rows under the names of their values; names without any value are left out."""
    names = [name for name in rows[0] if any(row[name] not in (None, "") for row in rows)]
    table = plain_table(*names)
    table.padding = (0, 1, 0, 0)
    for row in rows:
        table.add_row(*("" if row[name] is None else str(row[name]) for name in names))
    return table
