"""What README and docs tell a user to type works as it stands, page by page."""

import re
from pathlib import Path

import pytest
import typer

from hexctl.cli.main import app
from tests.docs.pages import LANGUAGES, PAGES, ROOT, blocks, commands, inline_commands, save_programs, tabs
from tests.docs.shell import Shell, of_hexctl, parse

#: The beginning of a line that somebody would type.
COMMAND = re.compile(r"\s*(\$ |# )?(hexctl|make|pip|python3?|git|sudo|mkdocs|dask)\s")


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize(
    ("page", "tab"),
    [
        pytest.param(page, tab, id="-".join(filter(None, (page.name, tab))))
        for page in PAGES
        if commands(page)
        for tab in tabs(page)
    ],
)
def test_the_commands_of_a_page(
    page: Path, tab: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A page with tabs is followed once in each of them."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(tmp_path)
    # For the programs it starts: no display, one thread.
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    save_programs(page, tmp_path)
    with Shell(tmp_path, page) as shell:
        for words in commands(page, tab):
            shell.do(words)


@pytest.mark.parametrize("page", [page for page in PAGES if commands(page)], ids=lambda page: page.name)
def test_each_command_is_one_that_hexctl_takes(page: Path) -> None:
    """Run are those of some pages by `.ci/run` and of all by `make test-all`."""
    for words in commands(page):
        for arguments in of_hexctl(words):
            parse(arguments)


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_no_command_escapes(page: Path) -> None:
    """Commands stand in `sh` blocks, where they are run."""
    for block in blocks(page):
        assert block.language in LANGUAGES, f"a block of {block.language!r}"
        if block.language != "sh":
            assert not [line for line in block.lines if COMMAND.match(line)], block.language


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_commands_in_the_text_exist_with_their_options(page: Path) -> None:
    for words in inline_commands(page, "hexctl"):
        assert_exists(words[1:])
    makefile = (ROOT / "Makefile").read_text(encoding="utf-8")
    for words in inline_commands(page, "make"):
        for target in (word for word in words[1:] if "=" not in word):
            assert re.search(rf"^{target}:", makefile, re.MULTILINE), f"make {target}"


def assert_exists(words: list[str]) -> None:
    """Check a command that may have placeholders: SESSION, FILE or three dots."""
    command = typer.main.get_command(app)
    while hasattr(command, "commands") and words and not words[0].startswith("-"):
        command = command.commands[words[0]]
        words = words[1:]
    known = {name for parameter in command.params for name in getattr(parameter, "opts", ())}
    known |= {"--help", "--version"}
    for word in words:
        assert not word.startswith("--") or word in known, f"{word} of {command.name}"
