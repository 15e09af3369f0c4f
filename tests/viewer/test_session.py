"""A session as the viewer shows it: the overview first, each trial one click away."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from hexctl.adapt.overview import recordings_of, write_overview
from hexctl.adapt.session import Session
from hexctl.adapt.store import SessionStore
from hexctl.cli.main import exit_code
from pictures.window import Window
from tests.viewer.checks import check_robot, check_session, check_trial, of_kind
from tests.viewer.conftest import WALK_S, Opener

TRIALS = 4


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> tuple[Session, Path]:
    """Return a session of short walks and its folder, whose name is one that URLs must quote."""
    folder = tmp_path_factory.mktemp("a session") / "übung 1%"
    folder.mkdir()
    options = {
        "--failed-leg": "5",
        "--budget": str(TRIALS),
        "--optimizer": "random",
        "--duration": str(WALK_S),
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert exit_code(["adapt", "--json", *(word for pair in options.items() for word in pair)]) == 0
    with SessionStore(folder / "runs") as store:
        (name,) = store.names()
        return store.load(name), store.folder_of(name)


@pytest.fixture(scope="module")
def window(opened: Opener, session: tuple[Session, Path]) -> Iterator[Window]:
    with opened(write_overview(*session)) as window:
        window.await_shown()
        yield window


def test_a_session_opens_with_all_its_panels(window: Window) -> None:
    check_session(window)
    with pytest.raises(AssertionError, match="views are missing"):
        check_trial(window)


def test_trajectories_and_points_appear_trial_by_trial(window: Window) -> None:
    pictures = []
    for trial in (1, TRIALS):
        window.show_trial(trial)
        window.picture()
        pictures.append((of_kind(window, "2D"), of_kind(window, "TimeSeries")))
    for first, last in zip(*pictures, strict=True):
        assert last.difference(first) > 1e-4


def test_a_link_leads_to_the_robot_in_the_same_window(window: Window, session: tuple[Session, Path]) -> None:
    window.open(recordings_of(*session)[2].resolve().as_uri())
    window.await_view("robot")
    window.show_time(1.0)
    window.picture()
    check_robot(of_kind(window, "3D"))
