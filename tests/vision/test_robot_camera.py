import csv
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.robot.rotations import wrapped_rad
from hexctl.vision.estimation.pose_filter import PoseEstimate
from hexctl.vision.place import arena_of, load_place, store
from hexctl.vision.pose_stream import CameraReport, CameraStatus
from hexctl.vision.robot_camera import CameraStarted, RobotCamera
from hexctl.vision.video.video_source import open_video
from hexctl.vision.video.video_writer import VideoWriter
from tests.vision.scenes import FILM_FPS, FILM_PICTURES, FLOOR_TAGS, film_walk, filmed_pose

pytestmark = pytest.mark.slow

#: Frame of the floor: the home tag's.
HOME = FLOOR_TAGS[0].pose


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a video of a walk and the calibration of its lens."""
    folder = tmp_path_factory.mktemp("camera")
    film_walk(folder)
    return folder


def looked(folder: Path, recorded: Path, **options: Any) -> tuple[CameraReport, CameraStarted]:
    """Report, and what was said at the start."""
    started: list[CameraStarted] = []
    camera = RobotCamera(
        camera=str(recorded / "walk.mp4"), place=folder / "place.yaml", lens=recorded / "lens.yaml",
        latency_ms=0.0, no_link=True, **options,
    )  # fmt: skip
    report = camera.run(lambda: False, on_started=started.append)
    return report, started[0]


def test_a_video_of_a_walk_becomes_poses_on_the_floor_of_the_home_tag(tmp_path: Path, recorded: Path) -> None:
    outputs = {"poses": tmp_path / "poses.csv", "output": tmp_path / "seen.mp4"}
    report, started = looked(tmp_path, recorded, bar_mm=100.0, **outputs)
    assert started.learned
    assert set(started.place.floor_tags) == set(FLOOR_TAGS)
    assert started.doubts == ()
    assert report.seen == 1.0
    with (tmp_path / "poses.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == report.pictures == FILM_PICTURES
    believed = [row for row in rows if row["sight"] == "seeing"]
    assert len(believed) > FILM_PICTURES - 10
    for row in believed:
        true = HOME.inverse().after(filmed_pose(round(float(row["at_s"]) * FILM_FPS)))
        assert np.hypot(float(row["seen_x_m"]) - true.x_m, float(row["seen_y_m"]) - true.y_m) < 0.01
        assert abs(wrapped_rad(float(row["seen_yaw_rad"]) - true.yaw_rad)) < 0.03
    with open_video(str(tmp_path / "seen.mp4")) as seen:
        assert next(iter(seen)).picture.shape == (720, 1280, 3)


def test_a_known_place_is_used_and_the_camera_placed_by_what_it_sees(tmp_path: Path, recorded: Path) -> None:
    looked(tmp_path, recorded)
    known = load_place(tmp_path / "place.yaml")
    text = (tmp_path / "place.yaml").read_text(encoding="utf-8")
    _, started = looked(tmp_path, recorded)
    assert not started.learned
    assert (tmp_path / "place.yaml").read_text(encoding="utf-8") == text
    assert started.place.floor_tags == known.floor_tags
    assert np.allclose(started.place.camera.position_m, known.camera.position_m, atol=0.01)
    assert started.arena is not None
    (x_m, y_m), radius_m = started.arena
    assert radius_m > 0.5
    assert (x_m, y_m) != (0.0, 0.0)


def test_a_camera_with_other_pictures_is_stored_so_that_the_arena_is_what_it_sees(
    tmp_path: Path, recorded: Path
) -> None:
    """The file is what `adapt --arena` reads: in smaller pictures the tag is seen less far away."""
    robot = load_robot("ant")
    _, large = looked(tmp_path, recorded)
    assert large.arena is not None
    assert arena_of(load_place(tmp_path / "place.yaml"), robot)[1] == pytest.approx(large.arena[1], abs=0.06)
    with (
        open_video(str(recorded / "walk.mp4")) as video,
        VideoWriter(tmp_path / "walk.mp4", FILM_FPS) as half,
    ):
        for frame in video:
            half.write(np.asarray(cv2.resize(frame.picture, (960, 540))), frame.at_s)
    (tmp_path / "lens.yaml").write_bytes((recorded / "lens.yaml").read_bytes())
    camera = RobotCamera(camera=tmp_path / "walk.mp4", place=tmp_path / "place.yaml", no_link=True)
    started: list[CameraStarted] = []
    camera.run(lambda: bool(started), on_started=started.append)
    assert not started[0].learned
    stored = load_place(tmp_path / "place.yaml")
    assert stored.viewpoint.lens.width_px == 960
    assert started[0].arena is not None
    (middle_m, radius_m), (shown_m, shown_radius_m) = arena_of(stored, robot), started[0].arena
    assert radius_m == pytest.approx(shown_radius_m, abs=0.02)
    assert middle_m == pytest.approx(shown_m, abs=0.06)
    assert radius_m < large.arena[1] - 0.1


def test_what_contradicts_a_known_place_is_refused_and_the_file_stays(tmp_path: Path, recorded: Path) -> None:
    looked(tmp_path, recorded)
    text = (tmp_path / "place.yaml").read_text(encoding="utf-8")
    for options, said in (
        (
            {"tag_height_mm": 90.0},
            r"tag_height_mm: got 90, and .*place\.yaml has .*; allowed: what it has, relearn",
        ),
        ({"robot_tag": 11}, r"robot_tag: got 11, and .*place\.yaml has 10"),
        ({"fov_deg": 80.0}, r"fov_deg: got 80, and .*place\.yaml has none"),
    ):
        with pytest.raises(InputError, match=said):
            looked(tmp_path, recorded, **options)
    assert (tmp_path / "place.yaml").read_text(encoding="utf-8") == text


def test_a_floor_that_is_learned_again_keeps_lens_and_latency(tmp_path: Path, recorded: Path) -> None:
    looked(tmp_path, recorded, bar_mm=98.0, tag_height_mm=50.0)
    before = replace(load_place(tmp_path / "place.yaml"), latency_s=0.123)
    store(before, tmp_path / "place.yaml", "latency_s")
    camera = RobotCamera(
        camera=recorded / "walk.mp4", place=str(tmp_path / "place.yaml"), relearn=True, no_link=True
    )
    started: list[CameraStarted] = []
    camera.run(lambda: bool(started), on_started=started.append)
    after = load_place(tmp_path / "place.yaml")
    assert started[0].learned
    assert (after.lens, after.latency_s, after.bar_mm) == (before.lens, 0.123, 98.0)
    assert after.robot_tag == before.robot_tag
    assert set(after.floor_tags) == set(before.floor_tags)


def test_learning_that_is_stopped_stores_nothing(tmp_path: Path, recorded: Path) -> None:
    asked: list[None] = []

    def stop_requested() -> bool:
        asked.append(None)
        return len(asked) > 5

    camera = RobotCamera(camera=recorded / "walk.mp4", place=tmp_path / "place.yaml", no_link=True)
    report = camera.run(stop_requested)
    assert (report.pictures, report.look_s) == (0, None)
    assert list(tmp_path.iterdir()) == []


def test_each_picture_gives_a_pose(tmp_path: Path, recorded: Path) -> None:
    poses: list[PoseEstimate] = []
    camera = RobotCamera(
        camera=recorded / "walk.mp4", place=tmp_path / "place.yaml", lens=recorded / "lens.yaml", no_link=True
    )
    report = camera.run(on_pose=poses.append)
    assert len(poses) == report.pictures == FILM_PICTURES
    assert poses[-1].sight == "seeing"
    assert report.to_dict()["look_ms"] > 0


def test_without_a_calibration_the_lens_is_assumed_and_that_is_said(tmp_path: Path, recorded: Path) -> None:
    started: list[CameraStarted] = []
    statuses: list[CameraStatus] = []
    camera = RobotCamera(
        camera=str(recorded / "walk.mp4"), place=tmp_path / "place.yaml", latency_ms=0.0, no_link=True
    )
    camera.run(lambda: False, on_started=started.append, on_status=statuses.append)
    assert any("assumed" in doubt for doubt in started[0].doubts)
    assert load_place(tmp_path / "place.yaml").lens is None


def test_a_bar_that_is_shorter_makes_the_floor_smaller(tmp_path: Path, recorded: Path) -> None:
    (tmp_path / "full").mkdir()
    _, full = looked(tmp_path / "full", recorded)
    _, small = looked(tmp_path, recorded, bar_mm=98.0)
    ratio = small.place.floor_tags[3].x_m / full.place.floor_tags[3].x_m
    assert ratio == pytest.approx(0.98, abs=1e-3)
    assert any("measure it" in doubt for doubt in full.doubts)
    assert small.doubts == ()


def test_a_bar_measured_later_corrects_the_place_and_that_is_said(tmp_path: Path, recorded: Path) -> None:
    _, first = looked(tmp_path, recorded)
    _, later = looked(tmp_path, recorded, bar_mm=98.0)
    assert not later.learned
    assert later.doubts == ("the bar of the sheet is 98 mm long, not 100: all distances change by -2.0 %",)
    known = load_place(tmp_path / "place.yaml")
    assert known.bar_mm == 98
    for number, corners in first.place.floor_corners.items():
        assert np.allclose(known.floor_corners[number], 0.98 * corners, atol=1e-5)
    high_m = later.place.camera.position_m[2]
    assert high_m == pytest.approx(0.98 * first.place.camera.position_m[2], rel=2e-3)
    _, again = looked(tmp_path, recorded)
    assert again.doubts == ()
    assert again.place.bar_mm == 98


def test_files_that_exist_are_not_replaced(tmp_path: Path) -> None:
    (tmp_path / "seen.mp4").touch()
    for options in ({"output": tmp_path / "seen.mp4"}, {"poses": tmp_path / "seen.mp4"}):
        given: dict[str, Any] = dict(options)
        with pytest.raises(InputError, match="exists"):
            RobotCamera(camera="0", **given)


def test_files_that_are_not_there_are_told_before_the_camera_is_opened(tmp_path: Path) -> None:
    gone = tmp_path / "gone" / "file"
    for name in ("output", "poses", "place"):
        given: dict[str, Any] = {name: gone}
        with pytest.raises(InputError, match=rf"{name}: got .*file; allowed: a folder that is there"):
            RobotCamera(camera="63", **given)
    with pytest.raises(InputError, match="nolens"):
        RobotCamera(camera="63", place=tmp_path / "place.yaml", lens=tmp_path / "nolens.yaml").run()


@pytest.mark.parametrize("latency_ms", [-1.0, 2001.0, float("nan")])
def test_an_impossible_latency_is_refused(latency_ms: float) -> None:
    with pytest.raises(InputError, match="0 to 2000"):
        RobotCamera(camera="0", latency_ms=latency_ms)


def test_a_floor_without_the_home_tag_is_refused(tmp_path: Path) -> None:
    with VideoWriter(tmp_path / "empty.mp4") as writer:
        for number in range(5):
            writer.write(np.full((480, 640, 3), 120, dtype=np.uint8), number / 30)
    camera = RobotCamera(camera=str(tmp_path / "empty.mp4"), place=tmp_path / "place.yaml", no_link=True)
    with pytest.raises(InputError, match="home tag"):
        camera.run(lambda: False)
    assert not (tmp_path / "place.yaml").exists()


def test_what_no_sheet_has_is_refused_at_once() -> None:
    with pytest.raises(InputError, match="robot_tag: got 2; allowed: 4 to 586"):
        RobotCamera(camera="0", robot_tag=2)
