"""Where nothing can be shown, the tests say why and what to do; where they must see, they fail."""

import shutil
from pathlib import Path

import pytest

from pictures.browser import browser
from pictures.needed import PACKAGES, MissingProgramError
from pictures.screen import virtual_screen
from tests.viewer.conftest import REQUIRED, give_up

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def test_what_is_missing_is_named_with_the_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with (
        pytest.raises(MissingProgramError, match=r"Xvfb is missing.*apt-get install"),
        virtual_screen((64, 64)),
    ):
        pass
    with pytest.raises(MissingProgramError, match="chromium is missing"), browser((64, 64), tmp_path):
        pass


def test_ci_never_skips(monkeypatch: pytest.MonkeyPatch) -> None:
    error = MissingProgramError("a viewer")
    monkeypatch.delenv(REQUIRED, raising=False)
    with pytest.raises(pytest.skip.Exception, match="a viewer"):
        give_up(error)
    monkeypatch.setenv(REQUIRED, "1")
    with pytest.raises(pytest.fail.Exception, match="a viewer"):
        give_up(error)
    assert f"{REQUIRED}=1" in (ROOT / ".ci" / "run").read_text()
    assert {"xvfb", "chromium", "mesa-vulkan-drivers"} <= set(PACKAGES.split())
