"""README and pages have the figures of docs/results/results.yaml, and `±` stands on the results page only."""

import importlib.util
import re
from datetime import date
from pathlib import Path

import pytest

from benchmarks import reality, results
from tests.docs.pages import ROOT

TABLES = results.results()

#: Comments that name a figure, wherever they stand.
MARK = re.compile(r"<!-- ?(\w+\.\w+\.\w+) ?-->")


@pytest.mark.parametrize("page", results.pages(), ids=lambda page: page.name)
def test_a_page_has_the_figures_of_the_file(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(MARK.findall(text)) == len(results.MARKED.findall(text)), "a comment without a number"
    assert results.updated(text, TABLES) == text, "python -m benchmarks.results writes the figures"


def test_each_table_says_how_it_was_measured() -> None:
    for name, table in TABLES.items():
        assert date.fromisoformat(table["date"]), name
        assert table["n"], name
        assert table["command"], name
        extra = {key for row in table["rows"].values() for key in row} - {*table["columns"], "name", "unit"}
        assert not extra, name


def test_the_table_of_reality_has_every_item() -> None:
    assert list(TABLES[reality.TABLE]["rows"]) == list(reality.ITEMS)


def test_every_table_stands_on_a_page() -> None:
    shown = {found[1] for page in results.pages() for found in results.TABLE.findall(page.read_text("utf-8"))}
    assert shown == {*TABLES}


def test_a_number_is_replaced_by_that_of_its_key() -> None:
    tables = {"line": {"rows": {"pose": {"mean": "0.25 ± 0.02"}}}}
    page = "It ends 7.1 cm<!-- line.pose.mean --> off, 3 cm of 4."
    assert results.updated(page, tables) == "It ends 0.25 cm<!-- line.pose.mean --> off, 3 cm of 4."


def test_the_matrix_is_made_from_the_results() -> None:
    pytest.importorskip("mkdocs", reason="the site needs the docs extra: pip install '.[docs]'")
    spec = importlib.util.spec_from_file_location("site_hooks", ROOT / "docs" / "site_hooks.py")
    assert spec is not None
    assert spec.loader is not None
    hooks = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(hooks)
    page = (ROOT / "docs" / "results" / "fault-matrix.md").read_text(encoding="utf-8")
    assert page.count("<!-- generated: fault_matrix -->") == 1
    assert "| controller killed | rests |" in hooks.fault_matrix()
