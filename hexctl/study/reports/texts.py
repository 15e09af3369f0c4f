"""Texts of the reports, which are in `hexctl/study/templates/texts.yaml`."""

from functools import cache
from importlib import resources
from typing import Any

import yaml

from hexctl.study.reports.report_page import Block, Bullets, Section


@cache
def texts(name: str) -> Any:
    """Return a part of the file, such as `assumptions`."""
    file = resources.files("hexctl.study") / "templates" / "texts.yaml"
    return yaml.safe_load(file.read_text(encoding="utf-8"))[name]


def reading(name: str, *more: Block, **values: object) -> Section:
    """Return the part of a report that says how to read it; `values` stand in its texts."""
    bullets = [text.format(**values) for text in texts("reading")[name]]
    return Section("How to read this", [Bullets(bullets), *more])
