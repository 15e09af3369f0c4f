"""README and docs as tests read them: blocks between fences, and the commands in them and in the text."""

import re
import shlex
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

FENCED = re.compile(r"^```(\S*)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
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
    found = FENCED.findall(page.read_text(encoding="utf-8"))
    return [Block(page, name, text) for name, text in found if language in (None, name)]


def commands(page: Path) -> list[list[str]]:
    """Return the words of every command in the `sh` blocks of a page, in order."""
    lines = [line for block in blocks(page, "sh") for line in block.lines]
    parts = [part for line in lines for part in line.split("&&")]
    return [words for part in parts if (words := shlex.split(part, comments=True))]


def inline_commands(page: Path, program: str) -> list[list[str]]:
    """Return the words of a program's commands in the running text of a page."""
    text = FENCED.sub("", page.read_text(encoding="utf-8"))
    return [span.split() for span in INLINE.findall(text) if span.split()[0] == program and " " in span]


def save_programs(page: Path, folder: Path) -> None:
    """Save the Python of a page under the names that its text gives, each the block nearest to its name."""
    text = page.read_text(encoding="utf-8")
    programs = [found for found in FENCED.finditer(text) if found[1] == "python"]
    for name in re.finditer(r"[Ss]aved? (?:it |this )?as `(\w+\.py)`", text):
        near = min(programs, key=lambda block: max(block.start() - name.end(), name.start() - block.end()))
        (folder / name[1]).write_text(near[2], encoding="utf-8")
