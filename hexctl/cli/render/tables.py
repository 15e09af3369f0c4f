"""Tables without lines."""

from collections.abc import Iterable

from rich.table import Table
from rich.text import Text

#: Width of the labels of a summary.
LABEL_WIDTH = 9


def plain_table(*columns: str) -> Table:
    """Table without lines; the first column and one without a name are to the left, the others right."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=any(columns))
    for number, column in enumerate(columns):
        left = number == 0 or not column
        table.add_column(Text(column, style="bold"), justify="left" if left else "right", no_wrap=True)
    return table


def label_table(rows: Iterable[tuple[str, str | Text]]) -> Table:
    """Two columns, labels and texts; a long text is wrapped beside its label."""
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), show_header=False)
    table.add_column(no_wrap=True, min_width=LABEL_WIDTH)
    table.add_column(overflow="fold")
    for label, text in rows:
        table.add_row(Text(label), Text(text) if isinstance(text, str) else text)
    return table
