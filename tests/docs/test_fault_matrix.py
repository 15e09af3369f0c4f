"""The page of the fault matrix gets its tables from the results when the site is built."""

import importlib.util

import pytest

from tests.docs.pages import ROOT


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
