"""A camera's latency by a twist of a served robot that a rendered camera sees."""

import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.control.body_wiggle import wiggle_targets_rad, wiggle_yaw_rad
from hexctl.errors import InputError
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.latency_trial import CameraLatency, course
from hexctl.vision.place import load_place, save_place
from hexctl.vision.robot_camera import RobotCamera
from hexctl.vision.robot_link import LegState
from hexctl.vision.twin.twin_camera import WEBCAM
from tests.robots import shipped
from tests.server.processes import hexctl_process, program, served

LATENCY_MS = 120


@dataclass
class Watched:
    """A served robot and a camera over it.

    Attributes:
        endpoint: of the robot.
        url: of the pictures.
        place: file of the place, learned.
    """

    endpoint: str
    url: str
    place: Path


@contextmanager
def watched(folder: Path) -> Iterator[Watched]:
    """A robot that stands under a camera whose pictures come 120 ms late."""
    save_lens(WEBCAM, folder / "lens.yaml")
    with served(folder, backend="sim") as robot:
        twin = (
            "hexctl", "sim", "camera", "--connect", robot.endpoint, "--fps", "15", "--size", "960x540",
            "--latency-ms", str(LATENCY_MS),
        )  # fmt: skip
        with program(folder, "twin", *twin) as camera:
            camera.wait_for("Ctrl-C ends it")
            url = camera.said().partition(" at ")[2].split()[0]
            looking = RobotCamera(
                camera=url, place=folder / "place.yaml", lens=folder / "lens.yaml", connect=robot.endpoint
            )
            started: list[object] = []
            looking.run(lambda: bool(started), on_started=started.append)
            yield Watched(robot.endpoint, url, folder / "place.yaml")


def latency(over: Watched, *more: str) -> list[str]:
    """Arguments of the command."""
    where = ["--camera", over.url, "--connect", over.endpoint, "--place", str(over.place)]
    return ["see", "latency", *where, *more]


@pytest.mark.long
@pytest.mark.realtime
def test_a_twist_tells_the_latency_which_the_place_keeps(tmp_path: Path) -> None:
    with watched(tmp_path) as over:
        before = load_place(over.place)
        done = hexctl_process(*latency(over, "--json"))
        assert done.returncode == 0, done.stderr
        assert "ant moves now: it stands up where it is and turns its body to and fro" in done.stderr
        # The robot is free again.
        assert hexctl_process(*latency(over)).returncode == 0
    report = json.loads(done.stdout)
    assert abs(report["latency_ms"] - LATENCY_MS) < 25
    assert 0 < report["sigma_ms"] < 10
    after = load_place(over.place)
    assert after.latency_s is not None
    assert abs(1000 * after.latency_s - LATENCY_MS) < 25
    assert replace(after, latency_s=None) == before


@pytest.mark.long
@pytest.mark.realtime
def test_ctrl_c_ends_the_twist_and_stores_nothing(tmp_path: Path) -> None:
    with watched(tmp_path) as over:
        before = over.place.read_bytes()
        with program(tmp_path, "latency", "hexctl", *latency(over)) as measuring:
            measuring.wait_for("moves now")
            measuring.signal(signal.SIGINT)
            assert measuring.wait() == 130
            assert "nothing is stored" in measuring.said()
        status = hexctl_process("status", "--connect", over.endpoint, "--json")
        assert json.loads(status.stdout)["controller"] is None
        assert over.place.read_bytes() == before


@pytest.mark.realtime
def test_a_robot_that_is_not_seen_does_not_move(tmp_path: Path) -> None:
    with watched(tmp_path) as over:
        place = load_place(over.place)
        save_place(replace(place, robot_tag=replace(place.robot_tag, id=77)), over.place)
        before = over.place.read_bytes()
        done = hexctl_process(*latency(over))
        assert done.returncode == 2
        assert re.search(r"--camera: tag 77 on ant is seen in 0 of \d+ pictures; allowed: half", done.stderr)
        assert "moves now" not in done.stderr
        assert over.place.read_bytes() == before


def test_a_place_that_was_never_learned_is_refused(tmp_path: Path) -> None:
    with pytest.raises(
        InputError, match=r"place: .*place.yaml is not there; allowed: .* hexctl see --camera"
    ):
        CameraLatency(camera="0", place=tmp_path / "place.yaml").run(lambda: False)


def test_the_course_of_a_twist_is_its_yaw() -> None:
    robot, times_s = shipped(), 0.02 * np.arange(220, dtype=float)
    joints = wiggle_targets_rad(robot, times_s)
    states = [LegState(float(at_s), row, None, None) for at_s, row in zip(times_s, joints, strict=True)]
    walked = course(robot, states)
    assert walked[0].tolist() == [0, 0, 0]
    assert np.abs(walked[:, 2] - wiggle_yaw_rad(times_s)).max() < 0.005
    assert np.hypot(*walked[:, :2].T).max() < 0.005
