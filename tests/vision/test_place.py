"""Options of a camera, its printed sheet, places and what is learned of them."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.camera_lens import CameraLens
from hexctl.vision.camera_options import CameraOptions, parse_size
from hexctl.vision.detection.calibration_board import N_CORNERS, SQUARE_M, BoardFinder
from hexctl.vision.detection.lens import Lens, load_lens, save_lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder
from hexctl.vision.place import (
    AssumedLens,
    CameraPose,
    FloorTag,
    Place,
    RobotTag,
    load_place,
    save_place,
)
from hexctl.vision.place_learning import check_known, learned_place
from hexctl.vision.robot_camera import RobotCamera
from hexctl.vision.sheet import PAPERS_MM, Sheet, save_sheet
from tests.vision.scenes import CAMERA, WEBCAM
from tests.vision.test_detection import seen_by
from tests.vision.test_detection_lenses import LENSES, pictures, ray_error_px

# Options and the sheet.


def test_a_size_is_two_numbers() -> None:
    assert parse_size("1280x720") == (1280, 720)
    for text in ("1280", "x", "1280x", "-1x2", "1.5x2"):
        with pytest.raises(ValueError, match="WIDTHxHEIGHT"):
            parse_size(text)


def board_files(folder: Path, count: int) -> list[Path]:
    """Files of pictures of the board, in a folder."""
    import cv2

    files = [folder / f"board{number}.png" for number in range(count)]
    for file, picture in zip(files, pictures("480p"), strict=False):
        cv2.imwrite(str(file), picture)
    return files


@pytest.mark.slow
def test_pictures_become_the_file_of_a_lens(tmp_path: Path) -> None:
    import cv2

    calibrated = CameraLens(pictures=board_files(tmp_path, 20), output=str(tmp_path / "lens.yaml")).run()
    assert calibrated.missing == ()
    assert load_lens(tmp_path / "lens.yaml") == calibrated.lens
    assert ray_error_px(LENSES["480p"], calibrated.lens) < 0.5
    files = board_files(tmp_path, 3)
    cv2.imwrite(str(tmp_path / "turned.png"), cv2.rotate(pictures("480p")[0], cv2.ROTATE_90_CLOCKWISE))
    for given, named in (([*files, files[0]], "pictures"), ([*files, tmp_path / "turned.png"], "turned.png")):
        with pytest.raises(InputError, match=named):
            CameraLens(pictures=given, output=tmp_path / "other.yaml").run()
    assert not (tmp_path / "other.yaml").exists()


PX_PER_MM = 4.0


def pages(sheet: Sheet) -> list[Picture]:
    """Pages as a PDF reader shows them."""
    import pypdfium2

    with pypdfium2.PdfDocument(sheet.pdf()) as document:
        scale = PX_PER_MM * 25.4 / 72
        drawn = [page.render(scale=scale, grayscale=True).to_numpy() for page in document]
        return [np.array(page).reshape(page.shape[:2]) for page in drawn]


def edges_mm(tag: SeenTag) -> np.ndarray:
    """The four edges of a tag; the reader rounds pages to whole pixels, up to 0.1 %."""
    steps_px = tag.corners_px - np.roll(tag.corners_px, 1, axis=0)
    return np.asarray(np.hypot(*steps_px.T) / PX_PER_MM)


@pytest.mark.slow
@pytest.mark.parametrize("paper", PAPERS_MM)
def test_each_tag_is_on_its_page_upright_and_in_its_size(paper: Any) -> None:
    first, *further, board = pages(Sheet(paper=paper))
    assert first.shape == pytest.approx([side * PX_PER_MM for side in PAPERS_MM[paper][::-1]], abs=1)
    found = TagFinder().search(first, thorough=True)
    assert set(found) == {0, 10}
    assert edges_mm(found[10]) == pytest.approx(100, abs=0.3)
    assert edges_mm(found[0]) == pytest.approx(110, abs=0.3)
    for tag_id, page in enumerate(further, start=1):
        found |= (alone := TagFinder().search(page, thorough=True))
        assert set(alone) == {tag_id}
        assert edges_mm(alone[tag_id]) == pytest.approx(160, abs=0.3)
    for tag in found.values():
        lower_left, lower_right, _, upper_left = tag.corners_px
        assert lower_right - lower_left == pytest.approx([edges_mm(tag)[0] * PX_PER_MM, 0], abs=1)
        assert upper_left[1] < lower_left[1]
    assert len(further) == 3
    seen = BoardFinder().find(board)
    assert seen is not None
    assert len(seen.corner_ids) == N_CORNERS
    steps_mm = np.diff(seen.corners_px[:6, 0]) / PX_PER_MM
    assert steps_mm == pytest.approx(1000 * SQUARE_M, abs=0.1)


def test_the_bar_is_100_mm_long() -> None:
    for page in pages(Sheet())[1:]:
        low = page[round(-30 * PX_PER_MM) : round(-6 * PX_PER_MM)]
        # The longest row of ink is the bar.
        lengths = [np.ptp(np.flatnonzero(row < 128)) if (row < 128).mean() > 0.4 else 0 for row in low]
        assert max(lengths) / PX_PER_MM == pytest.approx(100, abs=0.6)


def test_a_large_tag_has_a_page_of_its_own() -> None:
    first, second, *further = pages(Sheet(robot_edge_mm=150, floor_tags=0))
    assert set(TagFinder().search(first)) == {10}
    assert set(TagFinder().search(second)) == {0}
    assert len(further) == 1
    assert Sheet().pdf() == Sheet().pdf()


def test_the_command_writes_the_file_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "sheet.pdf"
    asked = ["see", "print", "--output", str(path), "--paper", "letter", "--robot-tag", "12"]
    assert exit_code(asked) == 0
    assert capsys.readouterr().out.strip() == str(path)
    assert path.read_bytes() == Sheet(paper="letter", robot_tag=12).pdf()
    assert exit_code(asked) == 2
    assert exit_code(["see", "print", "--output", str(tmp_path / "none" / "sheet.pdf")]) == 2
    assert exit_code(["see", "print", "--output", str(tmp_path / "x.pdf"), "--robot-tag", "1"]) == 2
    assert "--robot-tag" in capsys.readouterr().err


def test_a_sheet_with_a_name_that_no_disk_takes_is_refused(tmp_path: Path) -> None:
    for path in (tmp_path / (300 * "x"), tmp_path / (300 * "x") / "sheet.pdf"):
        with pytest.raises(InputError, match="output"):
            save_sheet(Sheet(), path)


@pytest.mark.parametrize(
    ("make", "options", "named"),
    [
        *[
            (RobotCamera, {"camera": 0, "page": page}, "page")
            for page in ("0.0.0.0:8019", "robot.local:8019")
        ],
        *[(RobotCamera, {"camera": 0, "page": page}, "page") for page in ("8019:", "70000", -1)],
        (RobotCamera, {"camera": 63, "output": "there.yaml"}, "exists"),
        (RobotCamera, {"camera": 63, "poses": "gone/file"}, "poses"),
        (RobotCamera, {"camera": 63, "place": "gone/file"}, "place"),
        (RobotCamera, {"camera": 63, "robot_tag": 2}, "robot_tag"),
        (RobotCamera, {"camera": 63, "latency_ms": 2001.0}, "latency_ms"),
        (CameraOptions, {}, "camera"),
        (CameraOptions, {"camera": 0, "place": 5}, "place"),
        (CameraLens, {}, "pictures"),
        (CameraLens, {"pictures": ["a.png"], "camera": 0}, "pictures"),
        (CameraLens, {"pictures": ["a.png"], "size_px": (640, 480)}, "size_px"),
        (CameraLens, {"camera": 0, "output": "none/lens.yaml"}, "output"),
        (CameraLens, {"camera": 0, "output": "there.yaml"}, "there.yaml"),
        (Sheet, {"paper": "a3"}, "paper"),
        (Sheet, {"robot_tag": 2}, "robot_tag"),
        (Sheet, {"robot_tag": 587}, "robot_tag"),
        (Sheet, {"floor_edge_mm": 200.0}, "floor_edge_mm"),
        (Sheet, {"home_edge_mm": float("nan")}, "home_edge_mm"),
    ],
)
def test_what_cannot_be_is_refused_by_name(
    make: Callable[..., object],
    options: dict[str, Any],
    named: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("there.yaml").touch()
    with pytest.raises(InputError, match=named):
        make(**options)


# Places.

PLACE = Place(
    lens=Path("lens.yaml"),
    camera=CameraPose.of(CAMERA),
    floor_tags={
        0: FloorTag(edge_mm=110, x_m=0.0, y_m=0.0, yaw_deg=0.0),
        3: FloorTag(edge_mm=160, x_m=0.9, y_m=-0.8, yaw_deg=-114.6),
    },
    robot_tag=RobotTag(id=10, edge_mm=100, x_m=0.01, yaw_deg=5.7, height_m=0.03),
    latency_s=0.08,
)


def saved(folder: Path, place: Place = PLACE) -> Path:
    """The file of a place, with its lens beside it."""
    save_lens(WEBCAM, folder / "lens.yaml")
    save_place(replace(place, lens=folder / "lens.yaml"), folder / "place.yaml")
    return folder / "place.yaml"


def test_a_file_brings_the_place_back(tmp_path: Path) -> None:
    found = load_place(saved(tmp_path))
    assert found.viewpoint.lens == WEBCAM
    assert np.allclose(found.viewpoint.rotation, CAMERA.rotation, atol=1e-5)
    assert np.allclose(found.viewpoint.position_floor, CAMERA.position_floor, atol=1e-5)
    assert found.latency_s == 0.08
    assert found.tag == PlacedTag(10, 0.1, PlanarPose(0.01, 0.0, math.radians(5.7)), 0.03)
    assert (found.robot_tag, found.floor_tags) == (PLACE.robot_tag, PLACE.floor_tags)
    for number, corners in PLACE.floor_corners.items():
        assert np.allclose(found.floor_corners[number], corners, atol=1e-5)
    assert yaml.safe_load((tmp_path / "place.yaml").read_text())["lens"] == "lens.yaml"


def test_comments_stay_when_a_place_is_stored_again(tmp_path: Path) -> None:
    path, place = saved(tmp_path), replace(PLACE, lens=tmp_path / "lens.yaml")
    text = path.read_text().replace("camera:", "# above the desk\ncamera:")
    path.write_text(text.replace("floor_tags:", "# taped down\nfloor_tags: # Jo's") + "# the end\n")
    tags = {**PLACE.floor_tags, 5: FloorTag(edge_mm=160, x_m=0.5, y_m=0.5, yaw_deg=0.0)}
    higher = replace(PLACE.camera, position_m=(0.0, 0.0, 2.5))
    save_place(replace(place, floor_tags=tags, camera=higher, latency_s=None), path)
    found, written = load_place(path), path.read_text()
    assert (found.floor_tags, found.camera.position_m, found.latency_s) == (tags, (0.0, 0.0, 2.5), None)
    assert all(f"# {words}\n" in written for words in ("above the desk", "Jo's", "taped down", "the end"))


def test_an_assumed_lens_needs_no_file(tmp_path: Path) -> None:
    assumed = AssumedLens(width_px=1280, height_px=720, fov_deg=67.0)
    place = replace(PLACE, lens=None, assumed_lens=assumed, latency_s=None)
    save_place(place, tmp_path / "place.yaml")
    found = load_place(tmp_path / "place.yaml")
    assert (found.assumed_lens, found.latency_s) == (assumed, None)
    assert found.viewpoint.lens == Lens.assumed(1280, 720, 67.0)
    assert not found.viewpoint.lens.calibrated
    with pytest.raises(InputError, match="lens and assumed_lens"):
        replace(PLACE, assumed_lens=assumed)


TAG = {"edge_mm": 160, "x_m": 0, "y_m": 0, "yaw_deg": 0}
LEVEL = [1, 0, 0, 0]


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("bar_mm", 10),
        ("bar", 98),
        ("floor_tags", {3: TAG}),
        ("floor_tags", {0: {"edge_mm": 160, "x_m": 0, "y_m": 0}}),
        ("floor_tags", {999: TAG}),
        ("robot_tag", {"id": 3, "edge_mm": 100, "height_m": 0.1}),
        ("robot_tag", {"id": 10, "edge_mm": "wide", "height_m": 0.1}),
        ("camera", {"position_m": [0, 0, 1], "orientation": [1, 1, 0, 0]}),
        ("camera", {"position_m": [0, 0, -1], "orientation": LEVEL}),
        ("camera", {"position_m": [0, 0], "orientation": LEVEL}),
        ("camera", {"position_m": [0, 0, 1], "orientation": LEVEL, "picture_px": [640, 480]}),
        ("latency_s", float("nan")),
        ("lens", "none.yaml"),
        ("lens", None),
    ],
)
def test_a_damaged_file_is_refused_by_key(tmp_path: Path, key: str, value: object) -> None:
    path = saved(tmp_path)
    path.write_text(yaml.safe_dump(yaml.safe_load(path.read_text()) | {key: value}))
    with pytest.raises(InputError, match=key):
        _ = load_place(path).viewpoint


def test_a_bar_measured_later_scales_what_was_learned_by_it_and_nothing_else() -> None:
    small = PLACE.printed(98.0)
    assert small.camera.position_m == pytest.approx(0.98 * CAMERA.position_floor)
    assert small.camera.orientation == PLACE.camera.orientation
    assert np.allclose(small.floor_corners[3], 0.98 * PLACE.floor_corners[3])
    assert small.tag.edge_m == pytest.approx(0.098)
    assert (small.tag.pose, small.tag.height_m) == (PLACE.tag.pose, 0.03)
    again = small.printed(100.0)
    assert np.allclose(again.floor_corners[3], PLACE.floor_corners[3])
    assert again.bar_mm == 100
    with pytest.raises(InputError, match="bar_mm"):
        PLACE.printed(49)
    with pytest.raises(InputError, match="bar_mm"):
        replace(PLACE, bar_mm=980)


#: What the place of the tests has.
SAME = {"robot_tag": 10, "robot_edge_mm": 100, "home_edge_mm": 110, "floor_edge_mm": 160}


def given(**options: Any) -> RobotCamera:
    """Options of a camera."""
    return RobotCamera(camera="0", **options)


def learn(options: RobotCamera, *numbers: int, before: Place | None = None) -> Place:
    """A place that is learned by a look at tags of some numbers."""
    return doubted(options, *numbers, before=before)[0]


def doubted(
    options: RobotCamera, *numbers: int, before: Place | None = None
) -> tuple[Place, tuple[str, ...]]:
    """The same, and what cannot be trusted of it."""
    corners_px = {number: seen_by(CAMERA)[number] for number in numbers}
    return learned_place(options, corners_px, (1280, 720), load_robot("ant"), before)


def test_nothing_and_the_same_are_no_contradiction(tmp_path: Path) -> None:
    path = saved(tmp_path)
    place = load_place(path)
    check_known(given(), place, path)
    same = given(lens=tmp_path / "." / "lens.yaml", bar_mm=98.0, tag_height_mm=30.0, **SAME)
    check_known(same, place, path)
    # The bar scales what was printed, and the sheet says what should have been.
    small = saved(tmp_path, replace(PLACE, bar_mm=98.0))
    check_known(given(**SAME), load_place(small), small)


@pytest.mark.parametrize(
    ("option", "options"),
    [
        ("tag_height_mm", {"tag_height_mm": 31.0}),
        ("fov_deg", {"fov_deg": 67.0}),
        ("lens", {"lens": Path("other.yaml")}),
        ("robot_tag", SAME | {"robot_tag": 11}),
        ("robot_edge_mm", SAME | {"robot_edge_mm": 90}),
        ("home_edge_mm", SAME | {"home_edge_mm": 90}),
        ("floor_edge_mm", SAME | {"floor_edge_mm": 90}),
    ],
)
def test_a_contradiction_is_refused_by_name(option: str, options: dict[str, Any], tmp_path: Path) -> None:
    path = saved(tmp_path)
    with pytest.raises(InputError, match=f"^{option}"):
        check_known(given(**options), load_place(path), path)


def test_the_edge_of_each_seen_floor_tag_is_compared(tmp_path: Path) -> None:
    tag = PLACE.floor_tags[3]
    mixed = replace(PLACE, floor_tags={**PLACE.floor_tags, 1: tag, 2: replace(tag, edge_mm=120.0)})
    path = saved(tmp_path, mixed)
    with pytest.raises(InputError, match=r"^floor_edge_mm: got 160, and .* has 120"):
        check_known(given(floor_edge_mm=160.0), load_place(path), path)
    only = replace(PLACE, floor_tags={0: PLACE.floor_tags[0], 5: tag})
    path = saved(tmp_path, only)
    check_known(given(floor_tags=2, floor_edge_mm=100.0), load_place(path), path)


def test_printed_tags_that_were_not_seen_are_told() -> None:
    place, doubts = doubted(given(bar_mm=100.0), 0, 1)
    assert set(place.floor_tags) == {0, 1}
    assert "tags 2, 3" in doubts[0]
    assert "not seen" not in " ".join(doubted(given(bar_mm=100.0, floor_tags=1), 0, 1)[1])


def test_what_is_not_given_of_a_sheet_stays_when_the_floor_is_learned_again() -> None:
    first = given(
        bar_mm=98.0, robot_tag=20, robot_edge_mm=90, home_edge_mm=105, floor_tags=1, floor_edge_mm=120
    )
    before = learn(first, 0, 1, 2)
    again = learn(given(robot_tag=30), 0, 1, 2, before=before)
    assert (again.robot_tag.id, again.robot_tag.edge_mm, again.bar_mm) == (30, 90, 98.0)
    assert again.tag.edge_m == pytest.approx(0.98 * 0.09)
    # Tag 2 was not used before: it was printed as tag 1 was.
    assert [again.floor_tags[each].edge_mm for each in (0, 1, 2)] == pytest.approx([105, 120, 120])
    fewer = learn(given(floor_tags=1, home_edge_mm=110.0), 0, 1, 2, before=before)
    assert (fewer.robot_tag.id, set(fewer.floor_tags)) == (20, {0, 1})
    assert [fewer.floor_tags[each].edge_mm for each in (0, 1)] == pytest.approx([110, 120])


def test_a_tag_of_the_robot_that_lies_on_the_floor_is_refused() -> None:
    before = learn(given(robot_tag=2, floor_tags=1), 0, 1)
    assert set(learn(given(), 0, 1, before=before).floor_tags) == {0, 1}
    with pytest.raises(InputError, match="robot_tag"):
        learn(given(floor_tags=3), 0, 1, before=before)
