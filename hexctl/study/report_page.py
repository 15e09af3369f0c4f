"""A report as one HTML page that needs no other file: sections of text, tables and pictures."""

import base64
import re
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any, ClassVar

import yaml

from hexctl.palette import GREY, VERDICT_COLORS

#: File in `hexctl/study/templates`.
TEMPLATE = "report.html"


@dataclass(frozen=True)
class Bullets:
    """A list of short texts."""

    texts: Sequence[str]

    kind: ClassVar = "bullets"


@dataclass(frozen=True)
class Table:
    """A table of text, sortable by each named column; cells that begin with a verdict are coloured."""

    header: Sequence[str]
    rows: Sequence[Sequence[str]]

    kind: ClassVar = "table"

    @classmethod
    def of(cls, rows: Iterable[Any], columns: Mapping[str, Callable[[Any], str]]) -> "Table":
        """Return the table of some rows: under each title its text of a row."""
        return cls(tuple(columns), [[text(row) for text in columns.values()] for row in rows])


@dataclass(frozen=True)
class Picture:
    """An SVG file, embedded, with what the paper shows and how to read it here."""

    file: Path
    paper: str
    here: str

    kind: ClassVar = "picture"

    @property
    def name(self) -> str:
        """Name of the file without its ending."""
        return self.file.stem

    @property
    def base64(self) -> str:
        """Content of the file in base 64."""
        return base64.b64encode(self.file.read_bytes()).decode()


#: A text is a paragraph.
Block = str | Bullets | Table | Picture


@dataclass(frozen=True)
class Section:
    """A part of the page; without a heading and an entry in the contents if the title is empty."""

    title: str
    blocks: Sequence[Block]

    @property
    def anchor(self) -> str:
        """Target of links to this section."""
        return re.sub(r"[^a-z0-9]+", "-", self.title.lower()).strip("-")


def markdown(table: Table) -> list[str]:
    """Return a table as lines of Markdown."""
    lines = [table.header, ["---"] * len(table.header), *table.rows]
    return ["| " + " | ".join(cell.replace("|", "\\|") for cell in line) + " |" for line in lines]


def render_page(heading: str, sections: Iterable[Section]) -> str:
    """Return a page as HTML, all text escaped; the contents follow the first sections without a title."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("hexctl.study"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    colors = {"grey": GREY, "yes": VERDICT_COLORS["holds"], "no": VERDICT_COLORS["does not hold"]}
    return environment.get_template(TEMPLATE).render(
        heading=heading,
        sections=list(sections),
        colors={name: " ".join(map(str, color)) for name, color in colors.items()},
    )


@cache
def texts(name: str) -> Any:
    """Return a part of `hexctl/study/templates/texts.yaml`, such as `claims`."""
    file = resources.files("hexctl.study") / "templates" / "texts.yaml"
    return yaml.safe_load(file.read_text(encoding="utf-8"))[name]


def reading(name: str, **values: object) -> Section:
    """Return the part of a report on how to read it; `values` fill its texts."""
    bullets = [text.format(**values) for text in texts("reading")[name]]
    return Section("How to read this", [Bullets(bullets)])
