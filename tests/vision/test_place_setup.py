"""What is given for a new place, against one that is known."""

from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.errors import InputError
from hexctl.robot.loader import load_robot
from hexctl.vision.place import load_place
from hexctl.vision.place_setup import PlaceSetup
from hexctl.vision.sheet import Sheet
from tests.vision.detection.test_floor import seen_by
from tests.vision.scenes import CAMERA
from tests.vision.test_place import PLACE, saved

NOTHING = PlaceSetup(lens=None, fov_deg=None, bar_mm=None, sheet=None, tag_height_mm=None)

#: What the place of the tests has.
SAME = Sheet(robot_tag=10, robot_edge_mm=100, home_edge_mm=110, floor_edge_mm=160)


def test_nothing_and_the_same_are_no_contradiction(tmp_path: Path) -> None:
    path = saved(tmp_path)
    place = load_place(path)
    NOTHING.check_known(place, path)
    same = PlaceSetup(
        lens=tmp_path / "." / "lens.yaml", fov_deg=None, bar_mm=98.0, sheet=SAME, tag_height_mm=30.0
    )
    same.check_known(place, path)
    # The bar scales what was printed, and the sheet says what should have been.
    small = saved(tmp_path, replace(PLACE, bar_mm=98.0, robot_tag=replace(PLACE.robot_tag, edge_m=0.098)))
    replace(NOTHING, sheet=Sheet(home_edge_mm=110 / 0.98, floor_edge_mm=160 / 0.98)).check_known(
        load_place(small), small
    )


@pytest.mark.parametrize(
    ("setup", "said"),
    [
        (replace(NOTHING, tag_height_mm=31.0), r"tag_height_mm: got 31, and .* has 30"),
        (replace(NOTHING, fov_deg=67.0), r"fov_deg: got 67, and .* has none"),
        (replace(NOTHING, lens=Path("other.yaml")), r"lens: got other\.yaml, and .* has .*lens\.yaml"),
        (replace(NOTHING, sheet=replace(SAME, robot_tag=11)), r"robot_tag: got 11, and .* has 10"),
        (replace(NOTHING, sheet=replace(SAME, robot_edge_mm=90)), r"robot_edge_mm: got 90, and .* has 100"),
        (replace(NOTHING, sheet=replace(SAME, home_edge_mm=90)), r"home_edge_mm: got 90, and .* has 110"),
        (replace(NOTHING, sheet=replace(SAME, floor_edge_mm=90)), r"floor_edge_mm: got 90, and .* has 160"),
    ],
)
def test_a_contradiction_is_refused_by_name(setup: PlaceSetup, said: str, tmp_path: Path) -> None:
    path = saved(tmp_path)
    with pytest.raises(InputError, match=f"{said}; allowed: what it has, relearn, or another place"):
        setup.check_known(load_place(path), path)


def test_printed_tags_that_were_not_seen_are_told() -> None:
    views = [{number: seen_by(CAMERA)[number] for number in (0, 1)}]
    place, doubts = replace(NOTHING, bar_mm=100.0).learned(views, (1280, 720), load_robot("ant"), None)
    assert set(place.floor_tags) == {0, 1}
    assert doubts[0] == "tags 2, 3 are not seen, and not used: in the picture, unfolded, and large enough?"
    one = replace(NOTHING, bar_mm=100.0, sheet=Sheet(floor_tags=2))
    assert one.learned(views, (1280, 720), load_robot("ant"), None)[1][0].startswith("tag 2 is not seen")
    fits = replace(NOTHING, bar_mm=100.0, sheet=Sheet(floor_tags=1))
    assert "not seen" not in " ".join(fits.learned(views, (1280, 720), load_robot("ant"), None)[1])


def test_of_a_sheet_only_what_is_given_must_agree(tmp_path: Path) -> None:
    place = replace(PLACE, robot_tag=replace(PLACE.robot_tag, edge_m=0.09))
    path = saved(tmp_path, place)
    replace(NOTHING, sheet={"robot_tag": 10}).check_known(load_place(path), path)
    with pytest.raises(InputError, match=r"robot_edge_mm: got 100, and .* has 90"):
        replace(NOTHING, sheet={"robot_edge_mm": 100.0}).check_known(load_place(path), path)


def test_what_is_not_given_of_a_sheet_stays_when_the_floor_is_learned_again() -> None:
    views = [{number: seen_by(CAMERA)[number] for number in (0, 1, 2)}]
    ant = load_robot("ant")
    first = Sheet(robot_tag=20, robot_edge_mm=90, home_edge_mm=105, floor_tags=1, floor_edge_mm=120)
    before, _ = replace(NOTHING, bar_mm=98.0, sheet=first).learned(views, (1280, 720), ant, None)
    again, _ = replace(NOTHING, sheet={"robot_tag": 30}).learned(views, (1280, 720), ant, before)
    assert (again.robot_tag.tag_id, again.bar_mm) == (30, 98.0)
    assert again.robot_tag.edge_m == pytest.approx(0.98 * 0.09)
    # Tag 2 was not used before: it was printed as tag 1 was.
    assert [again.floor_tags[each].edge_m for each in (0, 1, 2)] == pytest.approx([0.1029, 0.1176, 0.1176])
    fewer, _ = replace(NOTHING, sheet={"floor_tags": 1, "home_edge_mm": 110.0}).learned(
        views, (1280, 720), ant, before
    )
    assert (fewer.robot_tag.tag_id, set(fewer.floor_tags)) == (20, {0, 1})
    assert [fewer.floor_tags[each].edge_m for each in (0, 1)] == pytest.approx([0.1078, 0.1176])


def test_a_tag_of_the_robot_that_lies_on_the_floor_is_refused() -> None:
    views = [{number: seen_by(CAMERA)[number] for number in (0, 1)}]
    first = Sheet(robot_tag=2, floor_tags=1)
    before, _ = replace(NOTHING, sheet=first).learned(views, (1280, 720), load_robot("ant"), None)
    assert set(NOTHING.learned(views, (1280, 720), load_robot("ant"), before)[0].floor_tags) == {0, 1}
    with pytest.raises(InputError, match="robot_tag: got 2; allowed: no tag of the floor, 0, 1, 2, 3"):
        replace(NOTHING, sheet={"floor_tags": 3}).learned(views, (1280, 720), load_robot("ant"), before)
