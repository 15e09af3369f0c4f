"""Small pieces of HTML; every text is escaped."""

import base64
from collections.abc import Iterable, Sequence
from html import escape
from pathlib import Path

STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; color: #222; max-width: 1180px;
        margin: 2em auto; padding: 0 1em }
h1 { font-size: 1.6em } h2 { font-size: 1.25em; margin-top: 2em; border-bottom: 1px solid #ccc }
table { border-collapse: collapse; font-size: 13px; margin: 1em 0 }
th, td { border: 1px solid #ddd; padding: .3em .6em; text-align: left; vertical-align: top }
th { background: #f3f4f6 } td.yes { background: #d9f0dd } td.no { background: #f9d6d2 }
figure { margin: 1.5em 0 } img { width: 100%; height: auto; border: 1px solid #eee }
figcaption { display: grid; grid-template-columns: 1fr 1fr; gap: 1.5em; font-size: 13px }
"""


def page(title: str, parts: Iterable[str]) -> str:
    """Return a whole page that needs nothing but itself."""
    head = f'<meta charset="utf-8"><title>{escape(title)}</title><style>{STYLE}</style>'
    return (
        f'<!doctype html>\n<html lang="en"><head>{head}</head><body>\n'
        + "\n".join(parts)
        + "\n</body></html>\n"
    )


def heading(text: str, level: int = 2) -> str:
    """Return a heading."""
    return f"<h{level}>{escape(text)}</h{level}>"


def paragraph(text: str) -> str:
    """Return a paragraph."""
    return f"<p>{escape(text)}</p>"


def bullets(texts: Iterable[str]) -> str:
    """Return a list."""
    return "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul>"


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """Return a table; cells that begin with `holds` or `does not hold` are coloured."""
    head = "".join(f"<th>{escape(cell)}</th>" for cell in header)
    body = "".join("<tr>" + "".join(_cell(cell) for cell in row) + "</tr>\n" for row in rows)
    return f"<table><thead><tr>{head}</tr></thead><tbody>\n{body}</tbody></table>"


def figure(image: Path, paper: str, here: str) -> str:
    """Return a PNG file, embedded, between what the paper says and how to read it."""
    data = base64.b64encode(image.read_bytes()).decode()
    captions = f"<div><b>Paper.</b> {escape(paper)}</div><div><b>Here.</b> {escape(here)}</div>"
    source = f'<img alt="{escape(image.stem)}" src="data:image/png;base64,{data}">'
    return f"<figure>{source}<figcaption>{captions}</figcaption></figure>"


def _cell(text: str) -> str:
    kind = {"holds": ' class="yes"', "does n": ' class="no"'}.get(text[:6].strip(), "")
    return f"<td{kind}>{escape(text)}</td>"
