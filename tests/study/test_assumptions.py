"""What the paper leaves open: the documentation says it with the words of the report."""

from pathlib import Path

from hexctl.study.assumptions import assumptions_markdown

PAGE = Path(__file__).parents[2] / "docs" / "assumptions.md"


def test_the_page_has_the_table_of_the_report() -> None:
    assert assumptions_markdown() in PAGE.read_text(encoding="utf-8"), (
        "docs/assumptions.md differs from hexctl/study/assumptions.py: copy what assumptions_markdown() gives"
    )
