"""A command line that is not understood proposes what may have been meant."""

import pytest

from hexctl.cli.main import COMMANDS, exit_code
from hexctl.cli.suggestions import SYNONYMS


@pytest.mark.parametrize(
    ("words", "meant"),
    [
        (["walk"], "'run'"),
        (["stpo"], "'estop'"),
        (["run", "phantomx"], "--robot phantomx"),
        (["run", "mine.yaml"], "--robot mine.yaml"),
        (["adapt", "--failed-leg", "5", "lukas"], "--robot lukas"),
        (["drive", "wave"], "--gait wave"),
        (["run", "57"], "--gait 57"),
        (["run", "--recovery"], "--recover"),
        (["sessions", "rm", "x"], "'delete'"),
    ],
)
def test_what_may_have_been_meant_is_proposed(
    words: list[str], meant: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(words) == 2
    assert meant in capsys.readouterr().err


@pytest.mark.parametrize("words", [["xyzzy"], ["rm"], ["run", "xyzzy"], ["estop", "phantomx"]])
def test_nothing_is_proposed_for_what_means_nothing(
    words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(words) == 2
    assert "did you mean" not in capsys.readouterr().err.lower()


def test_proposed_commands_exist() -> None:
    meant = {command.split()[0] for command in SYNONYMS.values()}
    assert meant <= COMMANDS.keys() | {"list", "delete", "copy"}
    assert not SYNONYMS.keys() & COMMANDS.keys()
