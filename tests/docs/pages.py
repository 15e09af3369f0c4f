"""README and docs as tests read them: blocks between fences, and the commands in them and in the text."""

import re
import shlex
import textwrap
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

#: The reference, made from docstrings.
REFERENCE = sorted((ROOT / "docs" / "api").glob("*.md"))
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(page for page in sorted((ROOT / "docs").rglob("*.md")) if page not in REFERENCE),
]

#: Commands are in `sh` blocks only; `hex` are bytes, `diagram` is drawn.
LANGUAGES = ("sh", "python", "yaml", "json", "toml", "bibtex", "hex", "diagram", "nft")

#: A block between fences, indented in a list or a tab.
FENCED = re.compile(r"^( *)```(\S*)\n(.*?)^\1```$", re.DOTALL | re.MULTILINE)
#: The label of a tab; its content is indented by four spaces.
TAB = re.compile(r'^=== "([^"\n]+)"$', re.MULTILINE)
INLINE = re.compile(r"`([^`\n]+)`")


@dataclass(frozen=True, slots=True)
class Block:
    """A fenced block of a page."""

    page: Path
    language: str
    text: str

    @property
    def lines(self) -> list[str]:
        return [line for line in self.text.splitlines() if line.strip()]


def blocks(page: Path, language: str | None = None) -> list[Block]:
    """Return the blocks of a page, of one language or all."""
    return _blocks_in(page, page.read_text(encoding="utf-8"), language)


def _blocks_in(page: Path, text: str, language: str | None) -> list[Block]:
    found = FENCED.findall(text)
    return [Block(page, name, textwrap.dedent(part)) for _, name, part in found if language in (None, name)]


def tabs(page: Path) -> list[str]:
    """Return the labels of the tabs of a page; one that is empty for a page without tabs."""
    return list(dict.fromkeys(TAB.findall(page.read_text(encoding="utf-8")))) or [""]


def seen_in_tab(text: str, tab: str) -> str:
    """Return the text that a reader of one tab sees: without the content of the other tabs."""
    seen, label = [], tab
    for line in text.splitlines():
        if (begins := TAB.match(line)) is not None:
            label = begins[1]
        elif line and not line.startswith("    "):
            label = tab
        if label == tab:
            seen.append(line)
    return "\n".join(seen) + "\n"


def commands(page: Path, tab: str | None = None) -> list[list[str]]:
    """Return the words of every command in the `sh` blocks of a page, in order, or as one tab shows them."""
    text = page.read_text(encoding="utf-8")
    shown = text if tab is None else seen_in_tab(text, tab)
    lines = [line for block in _blocks_in(page, shown, "sh") for line in block.lines]
    parts = [part for line in lines for part in line.split("&&")]
    return [words for part in parts if (words := shlex.split(part, comments=True))]


def inline_commands(page: Path, program: str) -> list[list[str]]:
    """Return the words of a program's commands in the running text of a page."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    return [span.split() for span in INLINE.findall(text) if span.split()[0] == program and " " in span]


def save_programs(page: Path, folder: Path) -> None:
    """Save the Python of a page under the names that its text gives, each the block nearest to its name."""
    text = page.read_text(encoding="utf-8")
    programs = [found for found in FENCED.finditer(text) if found[2] == "python"]
    for name in re.finditer(r"[Ss]aved? (?:it |this )?as `(\w+\.py)`", text):
        near = min(programs, key=lambda block: max(block.start() - name.end(), name.start() - block.end()))
        (folder / name[1]).write_text(textwrap.dedent(near[3]), encoding="utf-8")
