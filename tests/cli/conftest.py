"""Every command runs in an empty folder; `call` calls it as a user does."""

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import pytest

from hexctl.cli.main import exit_code
from tests.cli.kits import Kit


class Output(NamedTuple):
    """Output of a command."""

    out: str
    err: str

    @property
    def line(self) -> str:
        """The only line on stderr."""
        (line,) = self.err.splitlines()
        return line

    @property
    def refusal(self) -> str:
        """The only line of all that was printed, which is on stderr."""
        assert self.out == ""
        return self.line

    @property
    def json(self) -> Any:
        """The one line on stdout, in strict JSON."""
        (line,) = self.out.splitlines()
        return json.loads(line, parse_constant=lambda name: pytest.fail(name))

    @property
    def quiet_json(self) -> Any:
        """Its JSON; nothing else is printed."""
        assert self.err == ""
        return self.json


#: Calls hexctl with a command line, and with more words as they are; it must end with a code.
Call = Callable[..., Output]


@pytest.fixture
def call(capsys: pytest.CaptureFixture[str]) -> Call:
    """Call a command; what it prints is returned."""

    def called(line: str, *words: str, code: int = 0) -> Output:
        capsys.readouterr()
        ended = exit_code([*line.split(), *words])
        printed = Output(*capsys.readouterr())
        assert ended == code, printed.err
        return printed

    return called


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Kit, "made", [])
