"""Trials and sessions as the viewer shows them: in a window, side by side, live, and in a browser."""

import json
import os
import re
import shutil
import signal
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest

from faults.process import children_of
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_viewing import recordings_of, write_overview
from hexctl.adapt.sessions.store import load_session
from hexctl.recording.side_by_side import write_together
from pictures.browser import Browser, browser
from pictures.needed import MissingProgramError
from pictures.picture import Picture
from pictures.screen import virtual_screen
from pictures.window import Window
from tests.export.conftest import session_in
from tests.recording.test_live import ROBOT, rows_at
from tests.server.processes import Program, program, wait_until
from tests.trials import walk as walk_alone
from tests.viewer.checks import check_robot, check_session, check_trial, check_whole, of_kind
from tests.viewer.conftest import WALK_S, Opener, Place, give_up

#: When the robot stands, and when it is about to stop.
BEGUN_S, WALKED_S = 0.5, 5.0 + WALK_S


@pytest.fixture(scope="module")
def trial_window(opened: Opener, trial: Path) -> Iterator[Window]:
    """A viewer that shows the trial, in mid-walk."""
    with opened(trial) as window:
        window.await_shown()
        window.show_time(WALKED_S)
        yield window


@pytest.mark.slow
def test_a_trial_opens_with_all_its_panels(trial_window: Window) -> None:
    check_trial(trial_window)
    check_whole(of_kind(trial_window, "3D"))


@pytest.mark.slow
def test_the_robot_moves_with_the_time_cursor(trial_window: Window) -> None:
    pictures = []
    for time_s in (BEGUN_S, WALKED_S):
        trial_window.show_time(time_s)
        trial_window.picture()
        pictures.append(of_kind(trial_window, "3D"))
        check_robot(pictures[-1])
    begun, walked = pictures
    assert walked.difference(begun) > 0.01


#: Where the trials end, left of the line positive.
DEVIATIONS_M = (0.8, -0.5, 0.2, 1.2)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, trial: Path) -> tuple[Session, Path]:
    """A session and the folder of its recordings, whose name is one that URLs must quote."""
    folder = tmp_path_factory.mktemp("a session") / "übung 1%"
    name, kept = session_in(folder, trial, DEVIATIONS_M)
    return load_session(name, folder), kept


@pytest.fixture(scope="module")
def session_window(opened: Opener, session: tuple[Session, Path]) -> Iterator[Window]:
    with opened(write_overview(*session)) as window:
        window.await_shown()
        yield window


@pytest.mark.slow
def test_a_session_opens_with_all_its_panels(session_window: Window) -> None:
    check_session(session_window)


@pytest.mark.slow
def test_a_link_leads_to_the_robot_in_the_same_window(
    session_window: Window, session: tuple[Session, Path]
) -> None:
    session_window.open(recordings_of(*session)[2].resolve().as_uri())
    session_window.await_view("robot")
    session_window.show_time(1.0)
    session_window.picture()
    check_robot(of_kind(session_window, "3D"))


@pytest.mark.slow
def test_two_walks_are_seen_in_one_scene_with_the_list_of_recordings(
    opened: Opener, trial: Path, tmp_path: Path
) -> None:
    scene, copy, _ = write_together([trial, trial], tmp_path)
    with opened(scene) as window:
        window.await_view("walks side by side")
        window.await_shown()
        window.show_time(5.0 + WALK_S)
        whole = window.picture()
        drawn = of_kind(window, "3D")
        check_robot(drawn)
        # The list is at the left, where a single recording has its scene.
        assert drawn.pixels.shape[1] < 0.65 * whole.pixels.shape[1]
        window.open(copy.as_uri())
        window.await_view("robot")
        window.show_time(1.0)  # one that plays never comes to rest
        window.picture()
        assert of_kind(window, "3D").pixels.shape[1] < 0.65 * whole.pixels.shape[1]


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
    """The page once it shows a robot."""

    def found() -> Picture | None:
        now = page.picture()
        with suppress(AssertionError):
            assert now is not None, "there is no page"
            check_robot(now)
            return now
        return None

    shown: Picture = wait_until(found, "a robot on the page", PATIENCE_S)
    return shown


@pytest.mark.slow
def test_a_browser_shows_the_robot(page: Browser, trial: Path, tmp_path: Path, home: dict[str, str]) -> None:
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


@pytest.mark.slow
def test_what_is_missing_is_named_with_the_packages(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(shutil, "which", lambda _: None)
    with (
        pytest.raises(MissingProgramError, match="Xvfb"),
        virtual_screen((64, 64)),
    ):
        pass
    with pytest.raises(MissingProgramError, match="chromium"), browser((64, 64), tmp_path):
        pass


def viewer_of(walk: Program) -> int:
    """The process of the window that a walk has opened."""

    def found() -> int | None:
        assert walk.process.poll() is None, walk.said()
        for child in children_of(walk.process.pid):
            with suppress(OSError):  # it has ended meanwhile
                if Path(f"/proc/{child}/comm").read_text() == "rerun\n":
                    return child
        return None

    return int(wait_until(found, "the viewer"))


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_window_that_dies_or_hangs_loses_no_tick(how: signal.Signals, place: Place, tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    walking = ("run", "--realtime", "--view", "--json", "--duration", str(WALK_S), "--record", str(path))
    with program(tmp_path, "walk", "hexctl", *walking, **place.home, DISPLAY=place.screen) as walk:
        viewer = viewer_of(walk)
        try:
            wait_until(path.is_file, "the recording")
            time.sleep(1.0)
            os.kill(viewer, how)
            walk.wait_for("realtime_factor")
        finally:
            with suppress(ProcessLookupError):
                os.kill(viewer, signal.SIGKILL)
        assert walk.wait() == 0
    outcome = json.loads(next(line for line in walk.said().splitlines() if line.startswith("{")))
    assert outcome["status"] == "ok"
    assert outcome["ticks"] == len(walk_alone(duration_s=WALK_S).log)
    assert rows_at(path, ROBOT) == outcome["ticks"]
