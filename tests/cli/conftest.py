"""Every command runs in an empty folder."""

from pathlib import Path

import pytest

from tests.cli.kits import Kit


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Kit, "made", [])
