"""The figures of merit of the documentation: one file, from which README and pages have them.

`python -m benchmarks.results` writes them into the pages: tables between `<!-- table NAME -->` and
`<!-- end -->`, and each number that a comment with its key follows, such as `0.25<!-- line.pose.mean -->`.
"""

import re
from collections.abc import Iterable, Iterator, Mapping
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

#: Rows of benchmarks in the table of the camera, and their keys.
CAMERA = {
    f"{benchmark}.{row}": f"camera.{name}.{column}"
    for benchmark, name in (
        ("see", "webcam"),
        ("see.noisy", "noisy"),
        ("cameras.480p", "small"),
        ("cameras.fisheye", "fisheye"),
    )
    for row, column in (("position_rms", "position"), ("yaw_rms", "heading"))
}


def results() -> dict[str, Any]:
    """Return the tables by name; each has `date`, `command`, `n`, `columns` and `rows`. Figures are text."""
    tables: dict[str, Any] = yaml.load(FILE.read_text(encoding="utf-8"), yaml.BaseLoader)
    return tables


def figure(tables: dict[str, Any], key: str) -> str:
    """Return the figure of a key without its standard error; a wrong key raises KeyError."""
    table, row, column = _split(key)
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


def put(figures: Mapping[str, str]) -> None:
    """Write figures by their keys into the file, with today's date, and write the pages.

    Raises KeyError for a key that the file does not have.
    """
    text = FILE.read_text(encoding="utf-8")
    for key, value in figures.items():
        name, row, column = _split(key)
        head, mark, rest = text.partition(f"\n{name}:\n")
        cell = rf"(?m)^(    {re.escape(row)}: .*[{{ ]{column}: )('[^']*'|[^,}}]*)"
        changed, count = re.subn(cell, rf"\g<1>{_quoted(value)}", rest, count=1)
        if not mark or not count:
            raise KeyError(key)
        text = head + mark + re.sub(r"(?m)^  date: .*$", f"  date: {date.today()}", changed, count=1)
    FILE.write_text(text, encoding="utf-8")
    write_pages()


def _quoted(value: str) -> str:
    """Return a figure as YAML; only text that is no figure needs quotes."""
    return value if re.fullmatch(r"[\w. ±%-]+", value) else f"'{value}'"


def _split(key: str) -> list[str]:
    """Return table, row and column of a key; only rows of benchmarks have dots in their names."""
    table, _, rest = key.partition(".")
    row, _, column = rest.rpartition(".")
    return [table, row, column]


def save_rows(rows: Iterable[Row]) -> None:
    """Write rows of benchmarks that a table has into the file, and write the pages."""
    shown = results()[PERFORMANCE]["rows"]
    figures: dict[str, str] = {}
    for row in rows:
        if row.name in shown:
            bar = "" if row.bar is None else f"{row.bar}{'' if row.holds else ', missed'}"
            figures |= {f"{PERFORMANCE}.{row.name}.value": row.shown, f"{PERFORMANCE}.{row.name}.bar": bar}
        elif row.name in CAMERA:
            figures[CAMERA[row.name]] = row.shown
    put(figures)


if __name__ == "__main__":
    write_pages()
