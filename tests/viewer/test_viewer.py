"""Trials and sessions as the viewer shows them: in a window, live, and in a browser.

Without a screen these tests are skipped; with HEXCTL_REQUIRE_ALL set, as .ci/run has it, they fail.
"""

import json
import os
import re
import signal
import time
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import pytest
from playwright.sync_api import Error as PlaywrightError
from playwright.sync_api import Page

from faults.process import children_of
from hexctl import palette
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_viewing import recordings_of, write_overview
from hexctl.adapt.sessions.store import load_session
from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.recording import style
from hexctl.recording.recording import Recording
from hexctl.robot.failure import Failure
from pictures.chromium import chromium
from pictures.needed import MissingProgramError
from pictures.picture import Color, Picture
from pictures.screen import strange_home, virtual_screen
from pictures.window import Window, open_window
from tests.export.conftest import session_in
from tests.recording.test_viewer import ROBOT, rows_at
from tests.robots import shipped
from tests.server.processes import Program, program, wait_until
from tests.trials import walk as walk_alone

SIZE = (1000, 640)

#: Walks this long; with settling and turning, and before it stops.
WALK_S = 3.0
Opener = Callable[..., AbstractContextManager[Window]]


def give_up(error: MissingProgramError) -> None:
    """Skip a test that cannot see anything, or fail it where it must."""
    if os.environ.get("HEXCTL_REQUIRE_ALL"):
        pytest.fail(str(error))
    pytest.skip(str(error))


@dataclass(frozen=True)
class Place:
    """A screen, and an environment whose home folder is not the user's."""

    screen: str
    home: dict[str, str]


@pytest.fixture(scope="session")
def home() -> Iterator[dict[str, str]]:
    with strange_home() as variables:
        yield variables


@pytest.fixture(scope="session")
def place(home: dict[str, str]) -> Iterator[Place]:
    try:
        with virtual_screen(SIZE) as screen:
            yield Place(screen, home)
    except MissingProgramError as error:
        give_up(error)


@pytest.fixture(scope="session")
def opened(place: Place) -> Opener:
    """What opens recordings in a viewer."""

    def open_recordings(*paths: Path) -> AbstractContextManager[Window]:
        return open_window(paths, SIZE, place.screen, place.home)

    return open_recordings


@pytest.fixture(scope="session")
def trial(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The recording of a short walk with leg 5 failed."""
    robot, failure = shipped(), Failure(leg=5)
    plan = TrialPlan(gait=make_gait(robot, "57", failed_legs=(5,)), failures=(failure,), duration_s=WALK_S)
    path = tmp_path_factory.mktemp("trial") / "trial.rrd"
    with (
        SimServos(robot, failures=failure) as servos,
        Recording(path, robot, plan, title="seen") as recording,
    ):
        recording.finish(run_trial(Guard(servos), plan, recorders=(recording,)), {})
    return path


#: Solids are shaded: how far their colours may be off.
SHADED = 60

#: Shares of a view that its subject covers at least.
BODY_SHARE, LEG_SHARE, LANE_SHARE, LINE_SHARE, TEXT_SHARE = 0.003, 0.0005, 0.25, 0.0002, 0.005
TEXT_COLOR: Color = (230, 230, 230)


def check_views(window: Window, kinds: dict[str, int]) -> None:
    """Fail unless there are views of all kinds, and none of them complains."""
    views = window.views
    found = [view.view_class for view in views]
    missing = {kind: count - found.count(kind) for kind, count in kinds.items() if found.count(kind) < count}
    assert not missing, f"views are missing: {missing}, there are {found}"
    troubles = {view.name: view.reports for view in views if view.reports}
    assert not troubles, f"views complain: {troubles}"
    assert not window.picture().blank, "the window is blank"


def of_kind(window: Window, kind: str) -> Picture:
    """The picture of the first view of a kind that is on the screen."""
    views = [view for view in window.views if view.view_class == kind]
    seen = next(filter(None, map(window.part, views)), None)
    assert seen is not None, f"no view of kind {kind} is on the screen"
    return seen


def check_robot(scene: Picture) -> None:
    """Fail unless a robot with a failed leg is in a picture of a scene."""
    assert not scene.blank, "the scene is blank"
    assert scene.share(palette.BODY_COLOR, SHADED) > BODY_SHARE, "no trunk is seen"
    assert scene.share(palette.FAILED_COLORS["femur"], SHADED) > LEG_SHARE, "no failed leg is seen"


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
    """Robot, lanes of phases and contacts, text, plots; and the eye is not too close to the robot."""
    check_views(trial_window, {"3D": 1, "StateTimeline": 1, "TextDocument": 1, "TimeSeries": 3})
    whole = trial_window.picture()
    for color in (style.DEVIATION_COLOR, *(palette.JOINT_COLORS[joint][1] for joint in ("coxa", "femur"))):
        assert whole.share(color) > LINE_SHARE, "no curve is seen"
    scene = of_kind(trial_window, "3D")
    check_robot(scene)
    assert scene.share(palette.BODY_COLOR, SHADED) < 0.12, "feet may be outside the picture"
    assert of_kind(trial_window, "StateTimeline").filled > LANE_SHARE
    assert of_kind(trial_window, "TextDocument").share(TEXT_COLOR) > TEXT_SHARE


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


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, trial: Path) -> tuple[Session, Path]:
    """A session and the folder of its recordings, whose name is one that URLs must quote."""
    folder = tmp_path_factory.mktemp("a session") / "übung 1%"
    name, kept = session_in(folder, trial, (0.8, -0.5, 0.2, 1.2))
    return load_session(name, folder), kept


@pytest.fixture(scope="module")
def session_window(opened: Opener, session: tuple[Session, Path]) -> Iterator[Window]:
    with opened(write_overview(*session)) as window:
        window.await_shown()
        yield window


@pytest.mark.slow
def test_a_session_opens_with_all_its_panels(session_window: Window) -> None:
    """Trajectories from above, the curve, the table."""
    check_views(session_window, {"2D": 1, "TimeSeries": 1, "TextDocument": 1})
    above = of_kind(session_window, "2D")
    assert above.share(palette.LINE_COLOR) > LINE_SHARE, "no line of travel is seen"
    assert above.share(palette.BEST_COLOR) > LINE_SHARE, "no best trajectory is seen"
    assert of_kind(session_window, "TimeSeries").share(palette.BEST_COLOR) > LINE_SHARE
    assert of_kind(session_window, "TextDocument").share(TEXT_COLOR) > TEXT_SHARE


@pytest.mark.slow
def test_a_link_leads_to_the_robot_in_the_same_window(
    session_window: Window, session: tuple[Session, Path]
) -> None:
    session_window.open(recordings_of(*session)[2].resolve().as_uri())
    session_window.await_view("robot")
    session_window.show_time(1.0)
    session_window.picture()
    check_robot(of_kind(session_window, "3D"))


@pytest.fixture
def page() -> Iterator[Page]:
    try:
        with chromium() as browser:
            yield browser.new_page(viewport={"width": 800, "height": 500}, color_scheme="light")
    except MissingProgramError as error:
        give_up(error)


def loaded(page: Page, address: str) -> bool:
    """Whether a page loads; its server may come up after it has told its address."""
    with suppress(PlaywrightError):
        page.goto(address, wait_until="commit")
        return True
    return False


@pytest.mark.slow
def test_a_browser_shows_the_robot(page: Page, trial: Path, tmp_path: Path, home: dict[str, str]) -> None:
    """On a dark page, though a browser without a screen prefers light ones: text and feet are white."""

    def robot() -> Picture | None:
        with suppress(AssertionError):
            now = Picture.from_png(page.screenshot())
            check_robot(now)
            return now
        return None

    with program(tmp_path, "view", "hexctl", "view", "--web", str(trial), **home) as viewer:
        viewer.wait_for("in a browser")
        address = re.search(r"http://\S+", viewer.said())
        assert address is not None
        wait_until(partial(loaded, page, address[0]), "the page of the viewer")
        # Three dimensions without a graphics card take long.
        shown: Picture = wait_until(robot, "a robot on the page", 90.0)
        assert shown.share((255, 255, 255), near=10) < 0.05, "light lines are drawn on white"
        viewer.signal(signal.SIGINT)
        assert viewer.wait() == 0


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
