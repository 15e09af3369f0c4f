"""The figures of merit of the documentation: one file, from which README and pages have them.

`python -m benchmarks.results` writes them into the pages: tables between `<!-- table NAME -->` and
`<!-- end -->`, and each number that a comment with its key follows, such as `0.25<!-- line.pose.mean -->`.
"""

import re
from collections.abc import Iterable, Iterator
from datetime import date
from pathlib import Path
from typing import Any

import yaml

from benchmarks.rows import Row

ROOT = Path(__file__).resolve().parents[1]
FILE = ROOT / "docs" / "results" / "results.yaml"

#: A number or a count ("288 of 288") and the comment with its key.
MARKED = re.compile(r"(\d[\d.,]*(?: of \d[\d,]*)?)(?P<mark> ?(?:%|cm|s)?<!-- ?(?P<key>\w+\.\w+\.\w+) ?-->)")
TABLE = re.compile(r"(<!-- table (\w+) -->\n).*?(<!-- end -->)", re.DOTALL)

#: The table of measured rows of benchmarks.
PERFORMANCE = "performance"


def results() -> dict[str, Any]:
    """Return the tables by name; each has `date`, `command`, `n`, `columns` and `rows`. Figures are text."""
    tables: dict[str, Any] = yaml.load(FILE.read_text(encoding="utf-8"), yaml.BaseLoader)
    return tables


def figure(tables: dict[str, Any], key: str) -> str:
    """Return the figure of a key without its standard error; a wrong key raises KeyError."""
    table, row, column = key.split(".")
    found: str = tables[table]["rows"][row][column]
    return found.partition(" ± ")[0]


def table_lines(table: dict[str, Any]) -> Iterator[str]:
    """Yield the lines of a table in Markdown, and what it was measured with."""
    columns = table["columns"]
    yield f"| |{'|'.join(columns.values())}|"
    yield f"|---{'|--:' * len(columns)}|"
    for row in table["rows"].values():
        yield f"|{row['name']}|{'|'.join(_cell(row, column) for column in columns)}|"
    yield ""
    yield f"{table['date']}, {table['n']}: `{table['command']}`"


def _cell(row: dict[str, Any], column: str) -> str:
    """Return a figure with the unit of its row; a limit has the same one."""
    unit = f" {row['unit']}" if "unit" in row and column in row and column != "bar" else ""
    return f"{row.get(column, '')}{unit}".replace("<=", "≤").replace(">=", "≥")


def updated(text: str, tables: dict[str, Any]) -> str:
    """Return a page with the figures of the file."""

    def table(found: re.Match[str]) -> str:
        lines = "\n".join(table_lines(tables[found[2]]))
        return f"{found[1]}{lines}\n{found[3]}"

    marked = MARKED.sub(lambda found: f"{figure(tables, found['key'])}{found['mark']}", text)
    return TABLE.sub(table, marked)


def pages() -> list[Path]:
    """Return README and all pages."""
    return [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]


def write_pages() -> None:
    """Bring the figures of all pages up to date."""
    tables = results()
    for page in pages():
        text = page.read_text(encoding="utf-8")
        if (new := updated(text, tables)) != text:
            page.write_text(new, encoding="utf-8")


def save_rows(rows: Iterable[Row]) -> None:
    """Put rows that the performance table has into the file, with today's date, and write the pages."""
    head, mark, table = FILE.read_text(encoding="utf-8").partition(f"\n{PERFORMANCE}:\n")
    for row in rows:
        bar = "" if row.bar is None else f"{row.bar}{'' if row.holds else ', missed'}"
        line = rf"(?m)^(    {re.escape(row.name)}: .*?value: )[^,]+(.*bar: ).*}}$"
        table = re.sub(line, rf"\g<1>{row.shown}\g<2>'{bar}'}}", table)
    dated = re.sub(r"(?m)^  date: .*$", f"  date: {date.today()}", table)
    FILE.write_text(head + mark + dated, encoding="utf-8")
    write_pages()


if __name__ == "__main__":
    write_pages()
