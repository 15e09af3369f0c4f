"""A robot under a camera: poses of a film, places, and what is published when it sees badly."""

import csv
import math
import shutil
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import cv2
import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import about_z, wrapped_rad
from hexctl.simulators.camera.rendering import RobotPosture, SceneRenderer
from hexctl.types import FloatArray
from hexctl.vision import pose_stream
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlanarPose
from hexctl.vision.detection.tags import MODULES, UNIT_CORNERS, Picture, TagFinder, tag_modules
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.observer import Observation, Observer
from hexctl.vision.place import arena_of, load_place
from hexctl.vision.pose_stream import COLUMNS, CameraReport, CameraStatus, PoseStream, PoseTable
from hexctl.vision.robot_camera import CameraStarted, RobotCamera
from hexctl.vision.robot_link import LegState
from hexctl.vision.video.videos import Frame, VideoSource, VideoWriter, open_video
from tests.driven import Driven, driven
from tests.vision.scenes import (
    CAMERA,
    FILM_FPS,
    FILM_PICTURES,
    FLOOR_CORNERS,
    FLOOR_TAGS,
    ROBOT_TAG,
    WEBCAM,
    film_walk,
    filmed_pose,
    scene,
    standing,
    tag_on,
)

ROBOT = load_robot("ant")
TAG = tag_on(ROBOT)

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
    large = first.started
    known = load_place(first.folder / "place.yaml")
    assert large.arena is not None
    assert arena_of(known, ROBOT)[1] == pytest.approx(large.arena[1], abs=0.06)
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
    (middle_m, radius_m), (shown_m, shown_radius_m) = arena_of(stored, ROBOT), small.arena
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


@pytest.mark.slow
def test_what_loses_the_robot_is_told_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """Its tag is covered, then no picture comes, and then pictures of another size."""
    with scene() as renderer:
        color = renderer.draw_color(standing(ROBOT, PlanarPose(0.0, 0.0, 0.0)))
    seen = np.asarray(cv2.cvtColor(color, cv2.COLOR_RGB2BGR))
    covered, small = seen.copy(), np.asarray(cv2.resize(seen, (640, 360)))
    column, row = CAMERA.pixels(np.array([[0.0, 0.0, ROBOT.standing_height_m + TAG.height_m]]))[0]
    cv2.circle(covered, (round(column), round(row)), 60, (120, 140, 180), cv2.FILLED)
    film = Film([*[seen] * 13, *[covered] * 45, *[seen] * 13, *[None] * 45, *[seen] * 13, *[small] * 45])
    clock = SimpleNamespace(monotonic=lambda: film.now_s, process_time=time.process_time)
    monkeypatch.setattr(pose_stream, "time", clock)
    events, statuses = list[str](), list[CameraStatus]()
    stream = PoseStream(Observer(ROBOT, CAMERA, FLOOR_CORNERS, TAG, finder=TagFinder()))
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


# A rendered camera that is knocked or sees badly.

HERE = Camera(WEBCAM.scaled(960, 540), CAMERA.rotation, CAMERA.position_floor)

#: Ticks of 20 ms for each picture, and by how many of them it comes late.
TICKS, LATE_TICKS = 4, 4

#: A picture, disturbed, by its time and the true pose in it.
Disturbance = Callable[[Picture, float, PlanarPose], Picture]


@dataclass(frozen=True, eq=False)
class Filmed:
    """A walk, and the pictures of it, one each `TICKS` ticks."""

    walk: Driven
    pictures: list[Picture]


@pytest.fixture(scope="module")
def filmed() -> Filmed:
    """It stands for a second, walks ahead for 3 s and turns for 2 s, in an arc."""
    walk = driven("ant", ((1, 0, 0, 0), (3, 1, 0, 0), (2, 0.6, 0, 0.5)))
    pictures = []
    with SceneRenderer(ROBOT, HERE, FLOOR_TAGS, TAG) as renderer:
        for tick in range(0, len(walk.times_s), TICKS):
            x_m, y_m, yaw_rad = walk.poses[tick].tolist()
            position = np.array([x_m, y_m, walk.height_m[tick]])
            pictures.append(renderer.draw(RobotPosture(position, about_z(yaw_rad), walk.joints_rad[tick])))
    return Filmed(walk, pictures)


def followed(filmed: Filmed, disturb: Disturbance) -> list[PoseEstimate]:
    """What is published tick by tick, of pictures that come late."""
    observer = Observer(ROBOT, HERE, FLOOR_CORNERS, TAG, finder=TagFinder(), latency_s=0.02 * LATE_TICKS)
    published = []
    for tick, at_s in enumerate(filmed.walk.times_s.tolist()):
        observer.listen(LegState(at_s, filmed.walk.joints_rad[tick], None, None))
        taken = tick - LATE_TICKS
        if taken >= 0 and taken % TICKS == 0:
            pose = PlanarPose(*filmed.walk.poses[taken].tolist())
            observer.look(disturb(filmed.pictures[taken // TICKS], 0.02 * taken, pose), at_s)
        published.append(observer.estimate(at_s))
    return published


def errors_m(filmed: Filmed, published: list[PoseEstimate]) -> tuple[float, float]:
    """Greatest distance from the truth after the first second, and greatest step beyond the robot's."""
    found = [(math.nan, math.nan) if one.pose is None else (one.pose.x_m, one.pose.y_m) for one in published]
    off_m = np.array(found) - filmed.walk.poses[:, :2]
    jumps_m = np.hypot(*np.diff(off_m, axis=0).T)
    return float(np.nanmax(np.hypot(*off_m[50:].T))), float(np.nanmax(jumps_m))


def corners_px(pose: PlanarPose, side_m: float) -> FloatArray:
    """Corners of a square at the height of the robot's tag in the picture, (4, 2)."""
    corners = pose.of_points(side_m * UNIT_CORNERS)
    height_m = ROBOT.standing_height_m + TAG.height_m
    return HERE.pixels(np.column_stack([corners, np.full(4, height_m)]))


def glare(picture: Picture, at_s: float, pose: PlanarPose) -> Picture:
    """For a second and a half a lamp is mirrored on a part of the tag, with a halo."""
    import cv2

    if not 2.0 <= at_s < 3.5:
        return picture
    light = np.zeros(picture.shape, dtype=np.float32)
    middle = corners_px(pose, 0.1)[:2].mean(axis=0)
    cv2.circle(light, tuple(int(place) for place in middle), 9, 400.0, cv2.FILLED)
    return np.asarray(np.clip(picture + cv2.GaussianBlur(light, (0, 0), 4), 0, 255), dtype=np.uint8)


def twin_tag(picture: Picture, at_s: float, _pose: PlanarPose) -> Picture:
    """A second tag with the number of the robot's lies nearer to the camera, and is seen larger."""
    import cv2

    if at_s < 1.25:
        return picture
    modules = np.pad(~tag_modules(ROBOT_TAG), 1, constant_values=True).astype(np.uint8) * 200 + 25
    large = cv2.resize(modules, None, fx=24, fy=24, interpolation=cv2.INTER_NEAREST)
    side = large.shape[0]
    # As printed: lower left, lower right, upper right, upper left.
    printed = np.array([[0, side], [side, side], [side, 0], [0, 0]], dtype=np.float32)
    lies = corners_px(PlanarPose(-0.5, 0.4, 0.3), 0.1 * (MODULES + 2) / MODULES)
    turn = cv2.getPerspectiveTransform(printed, lies.astype(np.float32))
    size = picture.shape[::-1]
    drawn = cv2.warpPerspective(large, turn, size, flags=cv2.INTER_AREA)
    covers = cv2.warpPerspective(np.full_like(large, 255), turn, size) > 127
    return np.where(covers, drawn, picture).astype(np.uint8)


@pytest.mark.slow
def test_a_tag_that_cannot_be_read_for_a_while_makes_no_jump_and_is_told(filmed: Filmed) -> None:
    published = followed(filmed, glare)
    off_m, jump_m = errors_m(filmed, published)
    assert {one.sight for one in published[50:]} == {"seeing", "bridging"}
    assert off_m < 0.03
    assert jump_m < 0.02
    assert published[-1].restarts == 0


@pytest.mark.slow
def test_a_second_tag_with_the_same_number_draws_no_robot_away(filmed: Filmed) -> None:
    published = followed(filmed, twin_tag)
    assert errors_m(filmed, published)[0] < 0.012
    assert published[-1].restarts == 0


@pytest.mark.slow
@pytest.mark.parametrize("noise", [False, True])
def test_pictures_that_stand_still_while_the_legs_walk_show_no_robot(filmed: Filmed, noise: bool) -> None:
    """A camera that hangs repeats its picture, and something may add noise to it."""
    kept, chance = list[Picture](), np.random.default_rng(0)

    def hung(picture: Picture, at_s: float, _pose: PlanarPose) -> Picture:
        if at_s < 0.9:
            return picture
        kept.append(picture)
        grain = chance.integers(0, 3 if noise else 1, picture.shape, dtype=np.uint8)
        return np.asarray(cv2.add(kept[0], grain), dtype=np.uint8)

    sights = [one.sight for one in followed(filmed, hung)]
    assert sights[15:50] == ["seeing"] * 35
    assert sights[-1] == "lost"


KNOCKED = Camera.looking(HERE.lens, np.array([-1.55, 0.08, 1.6]), np.array([0.03, 0.05, 0.0]))


@pytest.mark.slow
def test_a_knocked_camera_makes_no_jump_and_is_told() -> None:
    position = np.array([0.2, -0.1, ROBOT.standing_height_m])
    stands = RobotPosture(position, about_z(0.4), ROBOT.stance_angles_rad)
    pictures = []
    for camera in (HERE, KNOCKED):
        with SceneRenderer(ROBOT, camera, FLOOR_TAGS, TAG) as renderer:
            pictures.append(renderer.draw(stands))
    observer, changes, offs_m = Observer(ROBOT, HERE, FLOOR_CORNERS, TAG, finder=TagFinder()), [], []
    for number, picture in enumerate([pictures[0]] * 20 + [pictures[1]] * 45):
        observer.listen(LegState(number / 30, ROBOT.stance_angles_rad, None, None))
        changes.append(observer.look(picture, number / 30).change)
        estimate = observer.estimate(number / 30)
        if number >= 20:
            assert estimate.pose is not None
            offs_m.append(math.hypot(estimate.pose.x_m - 0.2, estimate.pose.y_m + 0.1))
    (told,) = [change for change in changes if change is not None]
    true_shift_m = np.linalg.norm(KNOCKED.position_floor - HERE.position_floor)
    assert told.tag_id is None
    assert told.shift_m == pytest.approx(true_shift_m, abs=0.01)
    found, middle_px = observer.watch.camera, np.array([[640.0, 360.0]])
    assert np.linalg.norm(found.position_floor - KNOCKED.position_floor) < 0.01
    assert np.allclose(found.floor_points(middle_px), KNOCKED.floor_points(middle_px), atol=0.005)
    assert max(offs_m) < 0.02
    assert offs_m[-1] < 0.005
    assert (estimate.sight, estimate.restarts) == ("seeing", 0)
