"""Learn a place from pictures, or update the pose of the camera in a known place.

Pictures do not show the lens calibration, the print scale and the height of the robot's tag. The user gives
these.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.robot.model import Robot
from hexctl.vision.detection.camera import Camera, place_camera
from hexctl.vision.detection.floor import CornersPx, averaged_corners, learn_floor
from hexctl.vision.detection.lens import load_lens
from hexctl.vision.detection.tags import HOME_TAG, Picture, SeenTag, TagFinder
from hexctl.vision.place import (
    AssumedLens,
    CameraPose,
    FloorTag,
    Place,
    RobotTag,
    load_place,
    save_place,
)
from hexctl.vision.place_options import PlaceOptions
from hexctl.vision.sheet import BAR_MM
from hexctl.vision.video.videos import VideoSource

#: Field of view of a lens of which nothing is known: that of many webcams.
USUAL_FOV_DEG = 67.0

#: Doubt if the length of the sheet's bar is not given.
BAR_DOUBT = (
    "the bar of the sheet is taken for 100 mm long: measure it; --bar-mm with another length corrects this "
    "place at any time"
)

#: Lengths in mm, and angles in degrees, that differ by less are the same.
SAME = 0.01

#: Pictures of which the floor is learned, and how long is waited for them.
LEARNING_PICTURES, LEARNING_S = 90, 20.0

#: Every picture of this number is searched for tags; in the others they are looked for where they were.
SEARCHED_EVERY = 15

#: Pictures by which the camera is placed at a known floor.
PLACING_PICTURES = 8

#: Change of position or angle from which the camera's pose is stored again.
ELSEWHERE_M, ELSEWHERE_RAD = 0.02, math.radians(0.5)


def known_place(given: PlaceOptions) -> Place | None:
    """The place of the file, if there is one; raises InputError for options that contradict it."""
    path = Path(given.place)
    known = load_place(path) if path.exists() else None
    if known is not None and not given.relearn:
        check_known(given, known, path)
    elif given.lens is not None:
        load_lens(given.lens)  # report a bad file before opening anything
    return known


def camera_place(
    given: PlaceOptions,
    known: Place | None,
    video: VideoSource,
    robot: Robot,
    finder: TagFinder,
    stop_requested: Callable[[], bool],
) -> tuple[Place, bool, tuple[str, ...]] | None:
    """The place, whether it was learned, and doubts, one sentence each; None after a requested stop.

    A known place gets the current pose of the camera. Changes are stored. Raises the errors of
    `learned_place` and `seen_place`.
    """
    path = Path(given.place)
    if known is not None and not given.relearn:
        place, changes = measured(known, given.bar_mm)
        placed = seen_place(place, video, finder, stop_requested)
        if placed is not None and _stands_elsewhere(placed.viewpoint, known.viewpoint):
            save_place(placed, path)
        elif changes:
            save_place(place, path)
        return None if placed is None else (placed, False, changes)
    pictures = list(_searched(video, finder, LEARNING_PICTURES, stop_requested))
    if stop_requested():
        return None
    height_px, width_px = pictures[0][0].shape
    corners_px = averaged_corners([found for _, found in pictures])
    place, doubts = learned_place(given, corners_px, (width_px, height_px), robot, known)
    save_place(place, path)
    return place, True, doubts


def seen_place(
    place: Place, video: VideoSource, finder: TagFinder, stop_requested: Callable[[], bool]
) -> Place | None:
    """A known place with the camera's current pose from the tags; None after a requested stop.

    Raises InputError if the pictures do not fit the lens, and RobotFaultError for a video without pictures.
    """
    pictures = list(_searched(video, finder, PLACING_PICTURES, stop_requested))
    if stop_requested():
        return None
    height_px, width_px = pictures[0][0].shape
    lens = place.viewpoint.lens.scaled(width_px, height_px)
    camera = place_camera(lens, averaged_corners([found for _, found in pictures]), place.floor_corners)
    return replace(place, camera=CameraPose.of(camera or replace(place.viewpoint, lens=lens)))


def _stands_elsewhere(camera: Camera, known: Camera) -> bool:
    """Whether a camera shows another part of the floor than the known one."""
    shift_m, turned_rad = camera.moved_from(known)
    return shift_m > ELSEWHERE_M or turned_rad > ELSEWHERE_RAD or camera.lens.size_px != known.lens.size_px


def _searched(
    video: VideoSource, finder: TagFinder, count: int, stop_requested: Callable[[], bool]
) -> Iterator[tuple[Picture, dict[int, SeenTag]]]:
    """Pictures in grey with the tags in them; raises RobotFaultError where none comes."""
    given, until_s = 0, time.monotonic() + LEARNING_S
    found: dict[int, SeenTag] = {}
    while given < count and not video.ended and not stop_requested() and time.monotonic() < until_s:
        frame = video.read()
        if frame is not None:
            gray = frame.gray()
            if given % SEARCHED_EVERY == 0:
                found |= finder.search(gray, thorough=True)
            given += 1
            yield gray, finder.near(gray, {number: one.corners_px for number, one in found.items()})
    if not given and not stop_requested():
        raise RobotFaultError(f"camera {video.name} sends no pictures")


def check_known(given: PlaceOptions, place: Place, path: Path) -> None:
    """Raise InputError for an option that a known place contradicts; its bar may differ (`measured`)."""
    numbers = given.sheet.floor_edges_mm
    # Tags that it never saw cannot be compared.
    edges = [(_edge_option(each), tag.edge_mm) for each, tag in place.floor_tags.items() if each in numbers]
    for name, known in [*_options_of(place).items(), *edges]:
        got = getattr(given, name)
        if got is None or name == "bar_mm" or (known is not None and _same(got, known)):
            continue
        raise InputError(
            f"{argument(name)}: got {_text(got)}, and {path} has "
            f"{'one that is assumed' if name == 'lens' and known is None else _text(known)}; "
            f"allowed: what it has, {argument('relearn')}, or another {argument('place')}"
        )


def _same(got: Any, known: Any) -> bool:
    if isinstance(known, Path):
        return Path(got).resolve() == known.resolve()
    return bool(abs(got - known) <= SAME)


def _text(value: Any) -> str:
    return f"{value:g}" if isinstance(value, float | int) else "none" if value is None else str(value)


def _options_of(place: Place) -> dict[str, Any]:
    """Options by which a place would be learned again, by name; None for a lens that it does not have."""
    tag, assumed = place.robot_tag, place.assumed_lens
    return {
        "lens": place.lens,
        "fov_deg": None if assumed is None else assumed.fov_deg,
        "bar_mm": place.bar_mm,
        "robot_tag": tag.id,
        "robot_edge_mm": tag.edge_mm,
        "tag_height_mm": 1000 * tag.height_m,
    }


def _edge_option(number: int) -> str:
    return "home_edge_mm" if number == HOME_TAG else "floor_edge_mm"


def measured(place: Place, bar_mm: float | None) -> tuple[Place, tuple[str, ...]]:
    """A known place by a length of the bar, if one is given, and what has changed by it, a sentence."""
    if bar_mm is None or bar_mm == place.bar_mm:
        return place, ()
    percent = 100 * (bar_mm / place.bar_mm - 1)
    return place.printed(bar_mm), (
        f"the bar of the sheet is {bar_mm:g} mm long, not {place.bar_mm:g}: "
        f"all distances change by {percent:+.1f} %",
    )


def learned_place(
    given: PlaceOptions,
    corners_px: CornersPx,
    size_px: tuple[int, int],
    robot: Robot,
    before: Place | None,
) -> tuple[Place, tuple[str, ...]]:
    """A place from the corners (4, 2) of tags in px by number, and doubts, one sentence each.

    Missing options are taken from the earlier place, if it is learned again, or the defaults. Raises
    InputError for invalid lenses and floors.
    """
    options = _new_options(given, robot, before)
    edges_mm = _edges_mm(given, before, options)
    if options["robot_tag"] in edges_mm:
        raise InputError(
            f"{argument('robot_tag')}: got {options['robot_tag']}; allowed: no tag of the floor, "
            f"{', '.join(map(str, edges_mm))}"
        )
    path = None if options["lens"] is None else Path(options["lens"])
    assumed = AssumedLens(width_px=size_px[0], height_px=size_px[1], fov_deg=options["fov_deg"])
    lens = assumed.opened() if path is None else load_lens(path).scaled(*size_px)
    scale = options["bar_mm"] / BAR_MM / 1000
    floor = learn_floor(lens, corners_px, {number: scale * edge for number, edge in edges_mm.items()})
    height_m = options["tag_height_mm"] / 1000
    tag = {"id": options["robot_tag"], "edge_mm": options["robot_edge_mm"], "height_m": height_m}
    place = Place(
        lens=path,
        assumed_lens=assumed if path is None else None,
        bar_mm=options["bar_mm"],
        floor_tags={number: FloorTag.at(tag.pose, edges_mm[number]) for number, tag in floor.tags.items()},
        robot_tag=RobotTag(**tag) if before is None else replace(before.robot_tag, **tag),
        camera=CameraPose.of(floor.camera),
        latency_s=None if before is None else before.latency_s,
    )
    unseen = _unseen_doubt(sorted(set(edges_mm) - set(floor.tags)))
    return place, (*unseen, *floor.doubts, *(BAR_DOUBT,) * (given.bar_mm is None and before is None))


def _new_options(given: PlaceOptions, robot: Robot, before: Place | None) -> dict[str, Any]:
    """Options of a new place: as given, else those of the place before, else usual ones."""
    usual = asdict(given.sheet) | {"lens": None, "fov_deg": USUAL_FOV_DEG, "bar_mm": BAR_MM}
    usual |= {"tag_height_mm": 1000 * robot.body.size_m[2] / 2}
    known: dict[str, Any] = {}
    if before is not None:
        # New floor tags are as the first one.
        edges = {_edge_option(number): tag.edge_mm for number, tag in reversed(before.floor_tags.items())}
        known = _options_of(before) | edges
    if given.fov_deg is not None:
        known["lens"] = None
    asked = {name: getattr(given, name, None) for name in usual}
    sources = [{name: value for name, value in each.items() if value is not None} for each in (known, asked)]
    return usual | sources[0] | sources[1]


def _edges_mm(given: PlaceOptions, before: Place | None, options: Mapping[str, Any]) -> dict[int, float]:
    """Edges of the floor's tags as the sheet names them, by number; new ones are as those before."""
    numbers = set(given.sheet.floor_edges_mm)
    known = {} if before is None else {number: tag.edge_mm for number, tag in before.floor_tags.items()}
    if given.floor_tags is None:
        numbers = (numbers | set(known)) - ({options["robot_tag"]} if known else set())
    return {
        number: getattr(given, _edge_option(number)) or known.get(number, options[_edge_option(number)])
        for number in sorted(numbers)
    }


def _unseen_doubt(numbers: Sequence[int]) -> tuple[str, ...]:
    if not numbers:
        return ()
    those = f"tag {numbers[0]} is" if len(numbers) == 1 else f"tags {', '.join(map(str, numbers))} are"
    return (f"{those} not seen, and not used: in the picture, unfolded, and large enough?",)
