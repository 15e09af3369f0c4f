"""Tables without lines."""

from collections.abc import Iterable
from typing import Any

from rich.console import RenderableType
from rich.table import Table
from rich.text import Text

from hexctl.errors import printable

#: Width of the labels of a summary.
LABEL_WIDTH = 9


class PlainTable(Table):
    """A table of literal texts: no markup, no emoji, nothing unprintable."""

    def add_row(self, *cells: RenderableType | None, **options: Any) -> None:
        """Add a row of texts or renderables."""
        super().add_row(*(_shown(cell) if isinstance(cell, str) else cell for cell in cells), **options)


def _shown(text: str) -> Text:
    return Text("\n".join(map(printable, text.split("\n"))))


def plain_table(*columns: str) -> PlainTable:
    """Table without lines; the first column and unnamed ones are left-aligned, the others right-aligned."""
    table = PlainTable(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(columns))
    for number, column in enumerate(columns):
        left = number == 0 or not column
        table.add_column(
            Text(printable(column), style="bold"), justify="left" if left else "right", no_wrap=True
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
