"""What a camera tells of a robot that is seen, covered, and filmed by a camera that stops."""

import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from hexctl.robot.loader import load_robot
from hexctl.vision import pose_stream
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.detection.overlay import Overlay
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.observer import Observer
from hexctl.vision.place import CameraPose, FloorTag, Place, RobotTag
from hexctl.vision.pose_stream import CameraStatus, PoseOutputs, PoseStream
from hexctl.vision.video.video_source import Frame, VideoSource
from tests.vision.scenes import CAMERA, FLOOR_TAGS, WEBCAM, scene, standing, tag_on

FRAME_S = 0.1
ANT = load_robot("ant")


class Film(VideoSource):
    """Pictures of a camera, ten a second of a clock of its own; None is one that never comes."""

    live = True

    def __init__(self, pictures: list[Picture | None]) -> None:
        super().__init__("film")
        self.now_s, self._pictures, self._number = 100.0, pictures, 0

    def read(self, timeout_s: float = 1.0) -> Frame | None:
        """The next picture."""
        picture = self._pictures[self._number]
        self._number += 1
        self.now_s += FRAME_S
        self.ended = self._number == len(self._pictures)
        return None if picture is None else Frame(picture, self.now_s, self._number)

    def close(self) -> None:
        """Nothing is open."""


class Shown:
    """In place of a video: its pictures are counted."""

    def __init__(self) -> None:
        self.pictures = 0

    def write(self, picture: Picture, at_s: float) -> None:
        """Count a picture."""
        self.pictures += 1


@pytest.fixture(scope="module")
def pictures() -> tuple[Picture, Picture]:
    """The robot in the middle of the floor, and the same with a hand over its tag."""
    with scene() as renderer:
        color = renderer.draw_color(standing(ANT, PlanarPose(0.0, 0.0, 0.0)))
    seen = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
    covered = seen.copy()
    column, row = CAMERA.pixels(np.array([[0.0, 0.0, ANT.standing_height_m + tag_on(ANT).height_m]]))[0]
    cv2.circle(covered, (round(column), round(row)), 60, (120, 140, 180), cv2.FILLED)
    return seen, covered


def streamed(
    film: Film, monkeypatch: pytest.MonkeyPatch, folder: Path
) -> tuple[list[str], list[CameraStatus], list[list[str]]]:
    """Events, statuses, and the text of each picture."""
    texts: list[list[str]] = []
    draw: Callable[..., Picture] = Overlay.draw

    def noted(self: Overlay, *arguments: Any, **options: Any) -> Picture:
        texts.append(list(options["lines"]))
        return draw(self, *arguments, **options)

    monkeypatch.setattr(Overlay, "draw", noted)
    clock = SimpleNamespace(monotonic=lambda: film.now_s, process_time=time.process_time)
    monkeypatch.setattr(pose_stream, "time", clock)
    tag, events, statuses = tag_on(ANT), list[str](), list[CameraStatus]()
    save_lens(WEBCAM, folder / "lens.yaml")
    place = Place(
        lens=folder / "lens.yaml",
        camera=CameraPose.of(CAMERA),
        floor_tags={number: FloorTag.at(one.pose, 1000 * one.edge_m) for number, one in FLOOR_TAGS.items()},
        robot_tag=RobotTag(id=tag.tag_id, edge_mm=1000 * tag.edge_m, height_m=tag.height_m),
    )
    video: Any = Shown()
    observer = Observer.at(place, ANT, TagFinder(), 0.0)
    stream = PoseStream(observer, PoseOutputs(None, None, video, None))
    stream.run(film, lambda: False, on_pose=lambda _: None, on_status=statuses.append, on_event=events.append)
    assert video.pictures == len(texts)
    return events, statuses, texts


@pytest.mark.slow
def test_a_tag_that_is_covered_is_not_seen(
    pictures: tuple[Picture, Picture], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen, covered = pictures
    film = Film([*[seen] * 13, *[covered] * 45, *[seen] * 20])
    events, statuses, texts = streamed(film, monkeypatch, tmp_path)
    assert events == ["the robot is seen", "the robot is lost: its tag is not seen", "the robot is seen"]
    partly = [status for status in statuses if 0 < status.seen < 1]
    assert partly
    assert all(status.tag_px > 20 for status in partly)
    assert any("by its legs" in text[-1] for text in texts)
    lost = [text for text in texts if "lost" in text[-1]]
    assert lost
    assert all(text[0] == "pose not known" for text in lost)
    assert lost[0][1] == "tag not seen"


def test_a_camera_that_stops_is_what_loses_the_robot(
    pictures: tuple[Picture, Picture], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    film = Film([*[pictures[0]] * 13, *[None] * 45])
    events, statuses, _ = streamed(film, monkeypatch, tmp_path)
    assert events == ["the robot is seen", "the robot is lost: no pictures come"]
    assert (statuses[-1].seen, statuses[-1].tag_px) == (0.0, 0.0)


def test_a_camera_that_comes_back_with_another_size_is_told_once(
    pictures: tuple[Picture, Picture], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    seen, small = pictures[0], np.asarray(cv2.resize(pictures[0], (640, 360)))
    events, _, texts = streamed(Film([*[seen] * 13, *[small] * 45]), monkeypatch, tmp_path)
    assert events[1].startswith("the camera sends pictures of 640x360 px now, and they were 1280x720")
    assert events[2:] == ["the robot is lost: no pictures come"]
    assert len(texts) == 13
