"""A whole search with nobody beside it: a served robot, a rendered camera, `hexctl see`, `hexctl adapt`."""

import json
import re
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.store import load_session
from hexctl.cli.console import ABORTED, DONE
from hexctl.recording import paths
from hexctl.robot.loader import load_robot
from hexctl.types import FloatArray
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.place import arena_of, load_place
from hexctl.vision.twin.posture_history import followed_robot
from hexctl.vision.twin.twin_camera import FLOOR_TAGS, WEBCAM
from hexctl.wire.links import Link
from tests.recording.conftest import ReadBack
from tests.server.processes import hexctl, program, served

pytestmark = [pytest.mark.long, pytest.mark.realtime]

HOME = FLOOR_TAGS[0].pose

#: A camera that stands near: the circle in which it sees the robot has 0.65 m.
CAMERA = ("--fps", "6", "--size", "800x450", "--latency-ms", "150", "--position", "-1.3,0,1.4")

TRIALS = 2

#: How far a robot that stops softly may come beyond the edge, and its pose be off, in m.
MARGIN_M = 0.05

#: Stops by a busy computer: pictures, states or commands that came too late. They are no fault of the robot.
LATE = re.compile(
    r"stopped: (state|expired|pose lost)|knows no position|no longer knows|lost before the walk"
)
RETRIED_S = 400.0


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Session, FloatArray]:
    """Folder and session of a search, and the true places (N, 2) of the robot meanwhile, on the floor."""
    folder = tmp_path_factory.mktemp("unattended")
    save_lens(WEBCAM, folder / "lens.yaml")
    with served(folder, "--failed-leg", "5", backend="sim") as robot:
        link = ("--connect", robot.endpoint)
        with program(folder, "twin", "hexctl", "sim", "camera", *link, *CAMERA, MUJOCO_GL="egl") as camera:
            camera.wait_for("Ctrl-C ends it")
            url = camera.said().partition(" at ")[2].split()[0]
            look = (
                "hexctl", "see", "--camera", url, *link, "--latency-ms", "150",
                "--lens", str(folder / "lens.yaml"), "--place", str(folder / "place.yaml"),
            )  # fmt: skip
            with program(folder, "look", *look) as looking, true_places(robot.endpoint) as places:
                looking.wait_for("; seeing;")
                name = search(folder, robot.endpoint)
    return folder, load_session(name, folder / "runs"), np.array(places)


@contextmanager
def true_places(endpoint: str) -> Iterator[list[tuple[float, float]]]:
    """Where the simulated robot truly is, ten times a second, in the frame of the home tag."""
    places: list[tuple[float, float]] = []
    ended = threading.Event()
    with followed_robot(Link(endpoint=endpoint)) as (_, history):

        def note() -> None:
            while not ended.wait(0.1):
                truth = history.at(history.newest_at_s or 0.0)
                if truth is not None:
                    x_m, y_m = HOME.inverse().of_points(truth.position_floor[np.newaxis, :2])[0].tolist()
                    places.append((x_m, y_m))

        noting = threading.Thread(target=note)
        noting.start()
        try:
            yield places
        finally:
            ended.set()
            noting.join()


def search(folder: Path, endpoint: str) -> str:
    """Let `hexctl adapt` walk, with nobody at its stdin; the name of its session.

    What a busy computer stops is cleared and resumed, and nothing else.
    """
    link = ("--connect", endpoint)
    words = [
        "--backend", "zenoh", *link, "--arena", str(folder / "place.yaml"), "--failed-leg", "5",
        "--budget", str(TRIALS), "--duration", "4", "--no-baseline",
    ]  # fmt: skip
    until_s = time.monotonic() + RETRIED_S
    while True:
        done = subprocess.run(
            [sys.executable, "-m", "hexctl", "adapt", *words, "--json"],
            cwd=folder, stdin=subprocess.DEVNULL, capture_output=True, text=True, timeout=240,
            check=False,
        )  # fmt: skip
        told = json.loads(done.stdout) if done.stdout else {"trials": []}
        if len(told["trials"]) == TRIALS:
            assert done.returncode in (DONE, ABORTED), done.stderr
            return str(told["session"])
        assert LATE.search(done.stderr), done.stderr
        assert time.monotonic() < until_s, f"never came to an end: {done.stderr}"
        hexctl("estop", "--clear", *link)
        resumed = re.search(r"--resume (\S+)", done.stderr)
        words = words if resumed is None else ["--resume", resumed[1]]


def walk_of(recording: Path) -> FloatArray:
    """Places (N, 2) of the body as it knew them, from the beginning of the walk on."""
    kept, phase, robot = ReadBack(recording), f"/{paths.PHASE}", f"/{paths.ROBOT}"
    phases = kept.values(phase, "StateChange:state")
    began_s = kept.times_s(phase, "StateChange:state")[phases.index(["walk"])]
    places = np.array(kept.values(robot, "Transform3D:translation")).reshape(-1, 3)[:, :2]
    # Where no position is known the robot is drawn at the origin.
    walking = (kept.times_s(robot, "Transform3D:translation") >= began_s) & places.any(axis=1)
    return np.asarray(places[walking])


def test_every_trial_begins_inside_the_arena_that_the_camera_sees(
    searched: tuple[Path, Session, FloatArray],
) -> None:
    folder, session, _ = searched
    (x_m, y_m), radius_m = arena_of(load_place(folder / "place.yaml"), load_robot("ant"))
    spec = session.spec
    assert spec.home_m == pytest.approx([x_m, y_m], abs=0.001)
    assert spec.arena_m == pytest.approx(radius_m, abs=0.01)
    assert not spec.ask
    assert len(session.trials) == TRIALS
    for trial in session.trials:
        assert trial.recording is not None
        walk = walk_of(folder / trial.recording)
        assert np.hypot(*(walk[0] - (x_m, y_m))) < radius_m
        assert np.hypot(*(walk - (x_m, y_m)).T).max() < radius_m + MARGIN_M


def test_it_truly_never_left_it_and_did_walk(searched: tuple[Path, Session, FloatArray]) -> None:
    _, session, places = searched
    assert session.spec.home_m is not None
    assert session.spec.arena_m is not None
    away_m = np.hypot(*(places - session.spec.home_m).T)
    assert away_m.max() < session.spec.arena_m + MARGIN_M
    for trial in session.trials:
        assert trial.outcome["status"] in ("ok", "no_progress", "cut_short")
    steps_m = np.hypot(*np.diff(places, axis=0).T)
    assert steps_m.sum() > 0.3
    assert steps_m.max() < 0.2, "nobody carried it"
