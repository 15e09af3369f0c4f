"""A session as the viewer shows it: the overview first, each trial one click away."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_viewing import recordings_of, write_overview
from hexctl.adapt.sessions.store import SessionStore
from hexctl.adapt.sessions.walk_records import TrialRecord
from pictures.window import Window
from tests.adapt.walking import SPEC, result_of
from tests.viewer.checks import check_robot, check_session, check_trial, of_kind
from tests.viewer.conftest import Opener

pytestmark = pytest.mark.slow

#: Where the trials end, left of the line positive.
DEVIATIONS_M = (0.8, -0.5, 0.2, 1.2)


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory, trial: Path) -> tuple[Session, Path]:
    """A session and the folder of its recordings, whose name is one that URLs must quote."""
    store = SessionStore(tmp_path_factory.mktemp("a session") / "übung 1%")
    session = store.create(SPEC)
    folder = store.folder_of(session.name)
    for index, off_m in enumerate(DEVIATIONS_M, start=1):
        result = result_of(off_m)
        recording = folder / f"trial-{index:03d}.rrd"
        recording.hardlink_to(trial)
        record = TrialRecord(
            index=index,
            code=index,
            slots=(1, 2, 3, 4, 5, 6),
            score=abs(off_m),
            outcome=result.to_dict(),
            path_m=np.round(result.path_m[::10], 4).tolist(),
            recording=str(recording),
        )
        store.add(session, record, {})
    return session, folder


@pytest.fixture(scope="module")
def window(opened: Opener, session: tuple[Session, Path]) -> Iterator[Window]:
    with opened(write_overview(*session)) as window:
        window.await_shown()
        yield window


def test_a_session_opens_with_all_its_panels(window: Window) -> None:
    check_session(window)
    assert "why this gait" in [view.name for view in window.views]
    with pytest.raises(AssertionError, match="views are missing"):
        check_trial(window)


def test_trajectories_and_points_appear_trial_by_trial(window: Window) -> None:
    pictures = []
    for trial in (1, len(DEVIATIONS_M)):
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
