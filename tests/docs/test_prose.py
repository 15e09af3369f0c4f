"""Pages are short and in plain English: numbers of words, lengths of sentences, and banned phrases.

Words are `wc -w`: tables and code included.
"""

import re
from datetime import date
from itertools import chain
from pathlib import Path

import pytest

from benchmarks import reality, results
from tests.docs.pages import PAGES, ROOT

DOCS = ROOT / "docs"

#: Phrases that read as if translated; `on the mean` is *on average*, `greatest` is *maximum*, and so on.
BANNED = re.compile(
    r"which nothing tells|\bis told\b|\bare told\b|\bis said\b|\bof (?:one's|your|its|my) own\b|\bof ours\b"
    r"|\bon the mean\b|nine of ten|\buntold\b|\banew\b|\blet go of\b|\bhas gone\b|\bhave gone\b|\bwalks on\b"
    r"|\bmended?\b|\bsomebody\b|\bnobody\b|\bstrangers?\b|\bgreatest\b|\bbeside\b|\bwhat there is\b"
    r"|\bthat there (?:is|are)\b|\bgot it with\b",
    re.IGNORECASE,
)

MARKED = [
    pytest.param(page, id=str(page.relative_to(ROOT)))
    for page in (ROOT / "CHANGELOG.md", *PAGES, *sorted((DOCS / "api").glob("*.md")))
]


def words(page: Path) -> int:
    return len(page.read_text(encoding="utf-8").split())


def prose(text: str) -> str:
    """The sentences of a page: without front matter, code, tables, headings, pictures and links' targets."""
    text = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    text = re.sub(r"^( *)```.*?^\1```$", " ", text, flags=re.DOTALL | re.MULTILINE)
    lines = [line for line in text.splitlines() if not re.match(r"\s*(\||#|!\[|<|---|===)", line)]
    text = re.sub(r"`[^`]*`", "X", "\n".join(lines))
    text = re.sub(r"!?\[([^\]]*)\]\([^)]*\)", r"\1", text)
    return re.sub(r"^\s*[-*\d.]+\s+", "", text, flags=re.MULTILINE)


def sentence_lengths(text: str) -> list[int]:
    """Words of each sentence; of a heading or a list's item without a verb, too, from three words on."""
    parts = re.split(r"(?<=[.!?:])\s+|\n\s*\n", text)
    lengths = [len(re.findall(r"[A-Za-z][\w'-]*", part)) for part in parts]
    return [length for length in lengths if length >= 3]


@pytest.mark.parametrize("page", MARKED)
def test_a_page_is_short(page: Path) -> None:
    assert words(page) <= (720 if page.name == "README.md" else 2_300)


def test_all_pages_together_are_short() -> None:
    pages = [page for page in DOCS.rglob("*.md") if page.parent.name != "dev"]
    assert sum(map(words, pages)) <= 37_500  # with pages for play and policies


@pytest.mark.parametrize("page", MARKED)
def test_a_page_is_in_plain_english(page: Path) -> None:
    """Sentences are short, semicolons few; errors stand on the results page only; no phrase is banned."""
    whole = page.read_text(encoding="utf-8")
    text = prose(whole)
    lengths = sentence_lengths(text)
    assert sum(lengths) <= 16 * max(1, len(lengths))
    count = len(re.findall(r"[A-Za-z][\w'-]*", text))
    assert text.count(";") <= max(3, 2 * count / 1000)
    assert "±" not in whole or page.relative_to(ROOT).as_posix() == "docs/results/results.md"
    assert [found[0] for found in BANNED.finditer(re.sub(r"\s+", " ", text))] == []


def test_docstrings_have_few_banned_phrases() -> None:
    texts = (path.read_text(encoding="utf-8") for path in sorted((ROOT / "hexctl").rglob("*.py")))
    docstrings = chain.from_iterable(re.findall(r'"""(.*?)"""', text, re.DOTALL) for text in texts)
    found = [each[0] for text in docstrings for each in BANNED.finditer(re.sub(r"`[^`]*`", "X", text))]
    assert len(found) <= 1, found  # only ever lowered


TABLES = results.results()

#: Comments that name a figure, wherever they stand.
MARK = re.compile(r"<!-- ?(\w+\.\w+\.\w+) ?-->")


@pytest.mark.parametrize("page", results.pages(), ids=lambda page: page.name)
def test_a_page_has_the_figures_of_the_file(page: Path) -> None:
    text = page.read_text(encoding="utf-8")
    assert len(MARK.findall(text)) == len(results.MARKED.findall(text)), "a comment without a number"
    assert results.updated(text, TABLES) == text, "python -m benchmarks.results writes the figures"


def test_each_table_stands_on_a_page_and_says_how_it_was_measured() -> None:
    shown = {found[1] for page in results.pages() for found in results.TABLE.findall(page.read_text("utf-8"))}
    assert shown == {*TABLES}
    for name, table in TABLES.items():
        assert date.fromisoformat(table["date"]), name
        assert table["n"], name
        assert table["command"], name
        extra = {key for row in table["rows"].values() for key in row} - {*table["columns"], "name", "unit"}
        assert not extra, name
    assert list(TABLES[reality.TABLE]["rows"]) == list(reality.ITEMS)


def test_a_number_is_replaced_by_that_of_its_key() -> None:
    tables = {"line": {"rows": {"pose": {"mean": "0.25 ± 0.02"}}}}
    page = "It ends 7.1 cm<!-- line.pose.mean --> off, 3 cm of 4."
    assert results.updated(page, tables) == "It ends 0.25 cm<!-- line.pose.mean --> off, 3 cm of 4."
