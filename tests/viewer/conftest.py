"""A screen for the viewer, and recordings to be seen on it. Where there is none, these tests are skipped.

With HEXCTL_REQUIRE_VIEWER set, as .ci/run has it, they fail instead.
"""

import os
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager
from dataclasses import dataclass
from pathlib import Path

import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.control.guard import Guard
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import make_gait
from hexctl.recording.recording import Recording
from hexctl.robot.failure import Failure
from pictures.needed import MissingProgramError
from pictures.screen import strange_home, virtual_screen
from pictures.window import Window, open_window
from tests.robots import shipped

REQUIRED = "HEXCTL_REQUIRE_VIEWER"
SIZE = (1000, 640)

#: Walks this long; with settling and turning, and before it stops.
WALK_S = 3.0
Opener = Callable[..., AbstractContextManager[Window]]


def give_up(error: MissingProgramError) -> None:
    """Skip a test that cannot see anything, or fail it where it must."""
    if os.environ.get(REQUIRED):
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
    plan = TrialPlan(gait=make_gait(robot, "57", failed_legs=(5,)), belief=failure, duration_s=WALK_S)
    path = tmp_path_factory.mktemp("trial") / "trial.rrd"
    with SimServos(robot, failure=failure) as servos, Recording(path, robot, plan, title="seen") as recording:
        recording.finish(run_trial(Guard(servos), plan, recorders=(recording,)), {})
    return path
