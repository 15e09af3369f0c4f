"""The viewer in a browser, as `hexctl view --web` serves it."""

import re
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from pictures.browser import Browser, browser
from pictures.needed import MissingProgramError
from pictures.picture import Picture
from tests.server.processes import program
from tests.viewer.checks import check_robot
from tests.viewer.conftest import give_up

pytestmark = pytest.mark.slow

SIZE = (800, 500)

#: A browser without a screen prefers light pages. Text and feet are white, and nothing large.
WHITE, WHITE_SHARE = (255, 255, 255), 0.05

#: How long a page may take that draws three dimensions without a graphics card.
PATIENCE_S = 90.0


@pytest.fixture
def page(home: dict[str, str]) -> Iterator[Browser]:
    try:
        with browser(SIZE, Path(home["HOME"])) as opened:
            yield opened
    except MissingProgramError as error:
        give_up(error)


def seen(page: Browser) -> Picture:
    """The page once it shows a robot, or as it is after the timeout."""
    until_s = time.monotonic() + PATIENCE_S
    while True:
        now = page.picture()
        try:
            assert now is not None, "there is no page"
            check_robot(now)
        except AssertionError:
            if time.monotonic() > until_s:
                raise
            time.sleep(0.2)
        else:
            return now


def test_a_browser_shows_the_robot(page: Browser, trial: Path, tmp_path: Path, home: dict[str, str]) -> None:
    empty = page.picture()
    assert empty is not None
    with pytest.raises(AssertionError, match="blank"):
        check_robot(empty)
    with program(tmp_path, "view", "hexctl", "view", "--web", str(trial), **home) as viewer:
        viewer.wait_for("in a browser")
        address = re.search(r"http://\S+", viewer.said())
        assert address is not None
        page.go(address[0])
        shown = seen(page)
        assert not shown.blank
        assert shown.share(WHITE, near=10) < WHITE_SHARE, "light lines are drawn on white"
        viewer.signal(signal.SIGINT)
        assert viewer.wait() == 0
