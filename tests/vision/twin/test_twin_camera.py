"""A rendered camera over a robot that is served in real time."""

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError, RobotFaultError
from hexctl.robot.rotations import wrapped_rad, yaw_rad
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.detection.planar_pose import tag_pose
from hexctl.vision.detection.tags import SeenTag, TagFinder
from hexctl.vision.twin.posture_history import followed_robot
from hexctl.vision.twin.twin_camera import (
    CAMERA,
    FLOOR_TAGS,
    ROBOT_TAG,
    WEBCAM,
    TwinCamera,
    TwinReport,
    TwinStarted,
    tag_on,
)
from hexctl.vision.video.video_source import VideoSource, open_video
from hexctl.waiting import wait_for
from hexctl.wire.links import Link
from tests.server.processes import Served, free_port, served

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"fps": 0.5}, "fps: got 0.5; allowed: 1 to 60"),
        ({"latency_ms": -1.0}, "latency_ms: got -1; allowed: 0 to 2000"),
        ({"noise": float("nan")}, "noise: got nan; allowed: 0..50"),
        ({"drop": 1.5}, "drop: got 1.5; allowed: 0..1"),
        ({"size_px": (10, 10)}, "size_px: got 10x10; allowed: 64 to 4096 px"),
        ({"position_m": (0.0, 0.0, 0.0)}, "position_m: got"),
        ({"position_m": (0.0, 0.0, 1.0), "look_at_m": (0.0, 0.0, 1.0)}, "position_m: got"),
        ({"faults": ("fogged",)}, "fault: got 'fogged'"),
        ({"http_port": 70_000}, "http_port: got 70000"),
    ],
)
def test_an_option_that_is_not_allowed_is_refused(options: dict[str, Any], said: str) -> None:
    with pytest.raises(InputError, match=said):
        TwinCamera(**options)


def test_the_lens_is_a_webcams_one_of_its_size_or_that_of_a_file(tmp_path: Path) -> None:
    assert TwinCamera().camera() == CAMERA
    assert TwinCamera(size_px=(640, 360)).camera().lens == WEBCAM.scaled(640, 360)
    other = TwinCamera(size_px=(640, 480)).camera().lens
    assert (other.width_px, other.height_px) == (640, 480)
    assert not other.distortion.any()
    save_lens(WEBCAM, tmp_path / "lens.yaml")
    assert TwinCamera(lens=tmp_path / "lens.yaml").camera() == CAMERA
    with pytest.raises(InputError, match="same shape"):
        TwinCamera(lens=tmp_path / "lens.yaml", size_px=(640, 480)).camera()


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    with served(tmp_path_factory.mktemp("robot"), backend="sim") as running:
        yield running


class Running:
    """A camera in a thread.

    Attributes:
        url: of its pictures.
        said: events that it told.
        report: what it managed, at its end.
    """

    def __init__(self, options: TwinCamera) -> None:
        self.said: list[str] = []
        self.report: TwinReport | None = None
        self.url = ""
        self._over = threading.Event()
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._run, args=(options,))
        self._thread.start()
        wait_for(lambda: self.url or not self._thread.is_alive(), 30, "the camera never began")
        self._raise()

    def _run(self, options: TwinCamera) -> None:
        try:
            self.report = options.run(self._over.is_set, on_started=self._started, on_event=self.said.append)
        except Exception as error:  # noqa: BLE001  raised again where the test sees it
            self._error = error

    def _started(self, started: TwinStarted) -> None:
        assert started.robot == "ant"
        self.url = started.url

    def _raise(self) -> None:
        if self._error is not None:
            raise self._error

    def end(self) -> None:
        """End it; raises what it raised."""
        self._over.set()
        self._thread.join()
        self._raise()


@contextmanager
def running(**options: Any) -> Iterator[Running]:
    """A camera, until the block ends."""
    camera = Running(TwinCamera(fps=10, **options))
    try:
        yield camera
    finally:
        camera.end()


def tags(source: VideoSource) -> dict[int, SeenTag]:
    """Tags in the next picture; none without a picture."""
    frame = source.read(10)
    return {} if frame is None else TagFinder().search(frame.gray(), thorough=True)


def test_it_shows_the_robot_where_it_truly_is(robot: Served) -> None:
    with (
        followed_robot(Link(endpoint=robot.endpoint)) as (model, history),
        running(connect=robot.endpoint, robot="ant") as camera,
        open_video(camera.url) as source,
    ):
        found = wait_for(
            lambda: seen if {*FLOOR_TAGS, ROBOT_TAG} == set(seen := tags(source)) else None,
            30,
            "not all tags were seen",
        )
        truth = history.at(history.newest_at_s or 0.0)
    assert truth is not None
    height_m = float(truth.position_floor[2]) + tag_on(model).height_m
    seen = tag_pose(CAMERA, found[ROBOT_TAG].corners_px, height_m)
    assert seen is not None
    assert (seen.pose.x_m, seen.pose.y_m) == pytest.approx(truth.position_floor[:2], abs=0.005)
    assert abs(wrapped_rad(seen.pose.yaw_rad - float(yaw_rad(truth.quaternion_floor)))) < 0.02
    report = camera.report
    assert report is not None
    assert report.delivered > 0
    assert report.latency_s is not None
    assert report.latency_s >= 0.0799
    assert report.drawn >= report.delivered + report.dropped


def test_a_camera_that_is_knocked_sees_everything_elsewhere_and_a_hand_hides_the_robot(
    robot: Served,
) -> None:
    faults = ("turned:3", "covered:3600")
    with (
        running(connect=robot.endpoint, faults=faults) as camera,
        open_video(camera.url) as source,
    ):
        found = wait_for(lambda: tags(source), 30, "no tag was seen")
    assert ROBOT_TAG not in found
    place = FLOOR_TAGS[3].pose
    still_px = CAMERA.pixels(np.array([[place.x_m, place.y_m, 0.0]]))[0]
    assert found[3].corners_px.mean(axis=0)[0] > still_px[0] + 20  # it turned to the left
    assert abs(found[3].corners_px.mean(axis=0)[1] - still_px[1]) < 20


def test_pictures_that_are_lost_are_counted(robot: Served) -> None:
    with (
        running(connect=robot.endpoint, drop=1.0) as camera,
        pytest.raises(RobotFaultError, match="no video comes"),
    ):
        open_video(camera.url)
    assert camera.report is not None
    assert camera.report.dropped == camera.report.drawn > 0
    assert camera.report.to_dict()["latency_ms"] is None


def test_a_robot_that_falls_silent_is_told(tmp_path: Path) -> None:
    with served(tmp_path, backend="sim") as robot, running(connect=robot.endpoint) as camera:
        robot.end()
        wait_for(lambda: camera.said, 10, "the silence was never told")
        with open_video(camera.url) as source:
            wait_for(lambda: ROBOT_TAG in tags(source), 30, "the robot is not shown any more")
    assert camera.said[0] == "the robot is silent; it is shown where it was"


def test_a_port_in_use_and_a_place_without_a_robot_are_said(robot: Served) -> None:
    with running(connect=robot.endpoint) as camera:
        port = int(camera.url.split(":")[2].split("/")[0])
        with pytest.raises(RobotFaultError, match=f"http_port: got {port}"):
            Running(TwinCamera(connect=robot.endpoint, http_port=port))
    with pytest.raises(RobotFaultError, match="nothing listens"):
        Running(TwinCamera(connect=f"tcp/127.0.0.1:{free_port()}"))
