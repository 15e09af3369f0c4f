"""What is given for a new place, against one that is known."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.place import Place, load_place
from hexctl.vision.place_learning import check_known, learned_place
from hexctl.vision.robot_camera import RobotCamera
from tests.vision.detection.test_floor import seen_by
from tests.vision.scenes import CAMERA
from tests.vision.test_place import PLACE, saved

#: What the place of the tests has.
SAME = {"robot_tag": 10, "robot_edge_mm": 100, "home_edge_mm": 110, "floor_edge_mm": 160}


def given(**options: Any) -> RobotCamera:
    """Options of a camera."""
    return RobotCamera(camera="0", **options)


def learned(options: RobotCamera, *numbers: int, before: Place | None = None) -> Place:
    """A place that is learned by a look at tags of some numbers."""
    return doubted(options, *numbers, before=before)[0]


def doubted(
    options: RobotCamera, *numbers: int, before: Place | None = None
) -> tuple[Place, tuple[str, ...]]:
    """The same, and what cannot be trusted of it."""
    views = [{number: seen_by(CAMERA)[number] for number in numbers}]
    return learned_place(options, views, (1280, 720), load_robot("ant"), before)


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
    ("options", "said"),
    [
        ({"tag_height_mm": 31.0}, r"tag_height_mm: got 31, and .* has 30"),
        ({"fov_deg": 67.0}, r"fov_deg: got 67, and .* has none"),
        ({"lens": Path("other.yaml")}, r"lens: got other\.yaml, and .* has .*lens\.yaml"),
        (SAME | {"robot_tag": 11}, r"robot_tag: got 11, and .* has 10"),
        (SAME | {"robot_edge_mm": 90}, r"robot_edge_mm: got 90, and .* has 100"),
        (SAME | {"home_edge_mm": 90}, r"home_edge_mm: got 90, and .* has 110"),
        (SAME | {"floor_edge_mm": 90}, r"floor_edge_mm: got 90, and .* has 160"),
    ],
)
def test_a_contradiction_is_refused_by_name(options: dict[str, Any], said: str, tmp_path: Path) -> None:
    path = saved(tmp_path)
    with pytest.raises(InputError, match=f"{said}; allowed: what it has, relearn, or another place"):
        check_known(given(**options), load_place(path), path)


def test_printed_tags_that_were_not_seen_are_told() -> None:
    place, doubts = doubted(given(bar_mm=100.0), 0, 1)
    assert set(place.floor_tags) == {0, 1}
    assert doubts[0] == "tags 2, 3 are not seen, and not used: in the picture, unfolded, and large enough?"
    assert doubted(given(bar_mm=100.0, floor_tags=2), 0, 1)[1][0].startswith("tag 2 is not seen")
    assert "not seen" not in " ".join(doubted(given(bar_mm=100.0, floor_tags=1), 0, 1)[1])


def test_of_a_sheet_only_what_is_given_must_agree(tmp_path: Path) -> None:
    path = saved(tmp_path, replace(PLACE, robot_tag=replace(PLACE.robot_tag, edge_mm=90)))
    check_known(given(robot_tag=10), load_place(path), path)
    with pytest.raises(InputError, match=r"robot_edge_mm: got 100, and .* has 90"):
        check_known(given(robot_edge_mm=100.0), load_place(path), path)


def test_what_is_not_given_of_a_sheet_stays_when_the_floor_is_learned_again() -> None:
    first = given(
        bar_mm=98.0, robot_tag=20, robot_edge_mm=90, home_edge_mm=105, floor_tags=1, floor_edge_mm=120
    )
    before = learned(first, 0, 1, 2)
    again = learned(given(robot_tag=30), 0, 1, 2, before=before)
    assert (again.robot_tag.id, again.robot_tag.edge_mm, again.bar_mm) == (30, 90, 98.0)
    assert again.tag.edge_m == pytest.approx(0.98 * 0.09)
    # Tag 2 was not used before: it was printed as tag 1 was.
    assert [again.floor_tags[each].edge_mm for each in (0, 1, 2)] == pytest.approx([105, 120, 120])
    fewer = learned(given(floor_tags=1, home_edge_mm=110.0), 0, 1, 2, before=before)
    assert (fewer.robot_tag.id, set(fewer.floor_tags)) == (20, {0, 1})
    assert [fewer.floor_tags[each].edge_mm for each in (0, 1)] == pytest.approx([110, 120])


def test_a_tag_of_the_robot_that_lies_on_the_floor_is_refused() -> None:
    before = learned(given(robot_tag=2, floor_tags=1), 0, 1)
    assert set(learned(given(), 0, 1, before=before).floor_tags) == {0, 1}
    with pytest.raises(InputError, match="robot_tag: got 2; allowed: no tag of the floor, 0, 1, 2, 3"):
        learned(given(floor_tags=3), 0, 1, before=before)
