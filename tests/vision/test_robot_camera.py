"""A camera that looks at a robot: places, poses, and what is told of them."""

import csv
import math
import shutil
import time
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.vision import pose_stream
from hexctl.vision.detection.lens import save_lens
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import Picture, TagFinder
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observation, Observer
from hexctl.vision.place import CameraPose, FloorTag, Place, RobotTag, arena_of, load_place
from hexctl.vision.pose_stream import COLUMNS, CameraReport, CameraStatus, PoseStream, PoseTable
from hexctl.vision.robot_camera import CameraStarted, RobotCamera
from hexctl.vision.video.videos import Frame, VideoSource, VideoWriter, open_video
from tests.vision.scenes import (
    CAMERA,
    FILM_FPS,
    FILM_PICTURES,
    FLOOR_TAGS,
    WEBCAM,
    film_walk,
    filmed_pose,
    scene,
    standing,
    tag_on,
)

#: Frame of the floor: the home tag's.
HOME = FLOOR_TAGS[0].pose


@dataclass(frozen=True)
class Looked:
    """A folder with a walk.mp4, its lens, the place that was learned of it, and what was said."""

    folder: Path
    report: CameraReport
    started: CameraStarted


def look(folder: Path, **options: Any) -> Looked:
    """Look at the film in a folder."""
    started: list[CameraStarted] = []
    camera = RobotCamera(
        camera=str(folder / "walk.mp4"),
        place=folder / "place.yaml",
        latency_ms=0.0,
        no_link=True,
        **options,
    )
    report = camera.run(lambda: False, on_started=started.append)
    return Looked(folder, report, started[0])


@pytest.fixture(scope="module")
def first(tmp_path_factory: pytest.TempPathFactory) -> Looked:
    """The first look at a walk, from which the place is learned."""
    folder = tmp_path_factory.mktemp("camera")
    film_walk(folder)
    outputs = {"poses": folder / "poses.csv", "output": folder / "seen.mp4"}
    return look(folder, lens=folder / "lens.yaml", bar_mm=100.0, **outputs)


@pytest.mark.slow
def test_a_video_of_a_walk_becomes_poses_on_the_floor_of_the_home_tag(first: Looked) -> None:
    assert first.started.learned
    assert set(first.started.place.floor_tags) == set(FLOOR_TAGS)
    assert first.started.doubts == ()
    assert first.report.seen == 1.0
    with (first.folder / "poses.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == first.report.pictures == FILM_PICTURES
    believed = [row for row in rows if row["sight"] == "seeing"]
    assert len(believed) > FILM_PICTURES - 10
    for row in believed:
        true = HOME.inverse().after(filmed_pose(round(float(row["at_s"]) * FILM_FPS)))
        assert np.hypot(float(row["seen_x_m"]) - true.x_m, float(row["seen_y_m"]) - true.y_m) < 0.01
        assert abs(wrapped_rad(float(row["seen_yaw_rad"]) - true.yaw_rad)) < 0.03
    with open_video(str(first.folder / "seen.mp4")) as seen:
        assert next(iter(seen)).picture.shape == (720, 1280, 3)


@pytest.mark.slow
def test_a_known_place_is_used_and_a_camera_with_other_pictures_stored(first: Looked, tmp_path: Path) -> None:
    """The file is what `adapt --arena` reads: in smaller pictures the tag is seen less far away."""
    large, robot = first.started, load_robot("ant")
    known = load_place(first.folder / "place.yaml")
    assert large.arena is not None
    assert arena_of(known, robot)[1] == pytest.approx(large.arena[1], abs=0.06)
    folder = Path(shutil.copytree(first.folder, tmp_path / "half"))
    with (
        open_video(str(first.folder / "walk.mp4")) as video,
        VideoWriter(tmp_path / "walk.mp4", FILM_FPS) as half,
    ):
        for frame in video:
            half.write(np.asarray(cv2.resize(frame.picture, (960, 540))), frame.at_s)
    (tmp_path / "walk.mp4").replace(folder / "walk.mp4")
    small = look(folder).started
    assert not small.learned
    assert small.place.floor_tags == known.floor_tags
    assert np.allclose(small.place.camera.position_m, known.camera.position_m, atol=0.01)
    stored = load_place(folder / "place.yaml")
    assert stored.viewpoint.lens.width_px == 960
    assert small.arena is not None
    (middle_m, radius_m), (shown_m, shown_radius_m) = arena_of(stored, robot), small.arena
    assert radius_m == pytest.approx(shown_radius_m, abs=0.02)
    assert middle_m == pytest.approx(shown_m, abs=0.06)
    assert radius_m < large.arena[1] - 0.1


@pytest.mark.slow
def test_learning_that_is_stopped_stores_nothing(first: Looked, tmp_path: Path) -> None:
    asked: list[None] = []

    def stop_requested() -> bool:
        asked.append(None)
        return len(asked) > 5

    camera = RobotCamera(camera=first.folder / "walk.mp4", place=tmp_path / "place.yaml", no_link=True)
    report = camera.run(stop_requested)
    assert (report.pictures, report.look_s) == (0, None)
    assert list(tmp_path.iterdir()) == []


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
        return None if picture is None else Frame(picture, self.now_s)

    def close(self) -> None:
        """Nothing is open."""


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


@pytest.mark.slow
def test_what_loses_the_robot_is_told_once(
    pictures: tuple[Picture, Picture], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Its tag is covered, then no picture comes, and then pictures of another size."""
    seen, covered = pictures
    small = np.asarray(cv2.resize(seen, (640, 360)))
    film = Film([*[seen] * 13, *[covered] * 45, *[seen] * 13, *[None] * 45, *[seen] * 13, *[small] * 45])
    clock = SimpleNamespace(monotonic=lambda: film.now_s, process_time=time.process_time)
    monkeypatch.setattr(pose_stream, "time", clock)
    tag, events, statuses = tag_on(ANT), list[str](), list[CameraStatus]()
    save_lens(WEBCAM, tmp_path / "lens.yaml")
    place = Place(
        lens=tmp_path / "lens.yaml",
        camera=CameraPose.of(CAMERA),
        floor_tags={number: FloorTag.at(one.pose, 1000 * one.edge_m) for number, one in FLOOR_TAGS.items()},
        robot_tag=RobotTag(id=tag.tag_id, edge_mm=1000 * tag.edge_m, height_m=tag.height_m),
    )
    seen_by = Observer(ANT, place.viewpoint, place.floor_corners, place.tag, finder=TagFinder())
    stream = PoseStream(seen_by)
    stream.run(film, lambda: False, on_pose=lambda _: None, on_status=statuses.append, on_event=events.append)
    told = ["seen", "its tag", "seen", "no pictures", "seen", "640x360", "no pictures"]
    assert len(events) == len(told)
    assert all(words in event for words, event in zip(told, events, strict=True))
    assert any(0 < status.seen < 1 and status.tag_px > 20 for status in statuses)
    assert (statuses[-1].seen, statuses[-1].tag_px) == (0.0, 0.0)


def test_what_is_not_known_is_empty(tmp_path: Path) -> None:
    lost = PoseEstimate(at_s=1.0, sight="lost", pose=None, covariance=None, age_s=math.inf, restarts=0)
    pose = PlanarPose(1.0, -2.0, 0.5)
    known = PoseEstimate(at_s=1.1, sight="bridging", pose=pose, covariance=np.eye(3), age_s=0.4, restarts=0)
    with PoseTable(tmp_path / "poses.csv") as table:
        for at_s, estimate in ((1.0, lost), (1.1, known)):
            table.write(at_s, estimate, Observation(None, False, None))
        assert len((tmp_path / "poses.csv").read_text(encoding="utf-8").splitlines()) == 3, "at once"
    with (tmp_path / "poses.csv").open(encoding="utf-8") as file:
        first, second = csv.DictReader(file)
    assert tuple(first) == COLUMNS
    assert [value for key, value in first.items() if key not in ("at_s", "sight")] == [""] * 8
    assert (second["x_m"], second["y_m"], second["yaw_rad"]) == ("1.00000", "-2.00000", "0.50000")
    assert (second["sight"], second["age_s"], second["seen_x_m"]) == ("bridging", "0.400", "")
    for path in (tmp_path / "poses.csv", tmp_path / "nowhere" / "poses.csv"):
        with pytest.raises(InputError):
            PoseTable(path)
