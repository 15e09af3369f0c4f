"""Places of cameras: their files, what is learned, and what contradicts what is known."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.detection.lens import Lens, save_lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
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
from tests.vision.detection.test_camera import seen_by
from tests.vision.scenes import CAMERA, WEBCAM

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
