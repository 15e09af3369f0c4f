"""Check whether the camera was moved, by looking at the floor tags in turn."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from hexctl.types import FloatArray
from hexctl.vision.detection.camera import Camera, place_camera, reprojection_px
from hexctl.vision.detection.tags import Picture, SeenTag, TagFinder

#: Deviation from which a tag or the camera counts as moved, in px and in tag edges.
MOVED_PX, MOVED_EDGES = 2.0, 0.06

#: Pictures in a row in which a tag has to be elsewhere.
MOVED_LOOKS = 3

#: Every picture of this number is looked at while nothing has moved: at 30 a second, one in 0.13 s.
LOOK_EVERY = 4

#: Looks at each tag that are averaged to update the camera's pose: the minimum after a single picture, and
#: the maximum, which is also the number used to learn a floor.
LEAST_LOOKS, MOST_LOOKS = 15, 90

#: Pictures without any of the tags between two searches of the whole picture.
SEARCH_EVERY = 10

#: `moved`: tags are not where they should be; `blind`: none of them is seen.
Doubt = Literal["moved", "blind"]


@dataclass(frozen=True, slots=True)
class CameraChange:
    """Something that moved: the camera, or a tag on the floor.

    Attributes:
        tag_id: the tag, or None for the camera.
        shift_m: by which the camera moved; NaN for a tag.
        turned_rad: by which the camera turned; NaN for a tag.
    """

    tag_id: int | None
    shift_m: float
    turned_rad: float = float("nan")


class CameraWatch:
    """Check one floor tag at a time and keep the pose of the camera up to date.

    The pose of a fixed camera improves with the mean of many looks. If a tag is not where it should be, all
    tags are checked. If most of them have moved, the camera was moved: its pose is computed again from all
    visible tags. If a minority has moved, those tags are no longer used.

    Attributes:
        camera: current pose.
        doubt: why the pose may be wrong in the newest picture, or None.
    """

    def __init__(self, camera: Camera, floor_corners: Mapping[int, FloatArray], finder: TagFinder) -> None:
        self.camera = camera
        self.doubt: Doubt | None = None
        self._floor, self._finder = dict(floor_corners), finder
        self._looks: dict[int, deque[FloatArray]] = {
            tag_id: deque(maxlen=MOST_LOOKS) for tag_id in self._floor
        }
        self._elsewhere = dict.fromkeys(self._floor, 0)
        self._seen = dict.fromkeys(self._floor, True)
        self._turn = self._blind = self._pictures = 0
        self._enough = MOST_LOOKS

    @property
    def floor_corners(self) -> dict[int, FloatArray]:
        """Corners (4, 2) in m, by number, of the tags in use: those in their place."""
        return dict(self._floor)

    @property
    def visible(self) -> list[int]:
        """Numbers of the tags found at their last check, or not yet checked."""
        return [tag_id for tag_id, seen in self._seen.items() if seen]

    def look(self, gray: Picture) -> CameraChange | None:
        """Look at the next tag in a picture; what was found to have moved, or None."""
        self._pictures += 1
        if not self._floor or (self.doubt is None and self._pictures % LOOK_EVERY != 1):
            return None
        tag_id = sorted(self._floor)[self._turn % len(self._floor)]
        self._turn += 1
        as_expected = self._look_at(gray, tag_id)
        if self.doubt is not None or not as_expected:
            for other in self._floor:
                if other != tag_id:
                    self._look_at(gray, other)
        if not self.visible:
            return self._blinded(gray)
        self._blind = 0
        self.doubt = "moved" if any(self._elsewhere.values()) else None
        if self.doubt is not None:
            return self._judged(gray)
        self._refine()
        return None

    def _look_at(self, gray: Picture, tag_id: int) -> bool:
        """Whether a tag is in its place in the current picture."""
        expected_px = self.camera.pixels(np.column_stack([self._floor[tag_id], np.zeros(4)]))
        seen_tag = self._finder.near(gray, {tag_id: expected_px}).get(tag_id)
        self._seen[tag_id] = seen_tag is not None
        if seen_tag is None:
            self._elsewhere[tag_id] = 0
            return False
        if _is_elsewhere(seen_tag, expected_px):
            self._elsewhere[tag_id] += 1
            return False
        self._elsewhere[tag_id] = 0
        self._looks[tag_id].append(seen_tag.corners_px)
        return True

    def _blinded(self, gray: Picture) -> CameraChange | None:
        """Handle a picture without any tag in its place: the camera was moved far, or is covered."""
        self.doubt = "blind"
        self._blind += 1
        return self._replaced(gray) if self._blind % SEARCH_EVERY == 2 else None

    def _judged(self, gray: Picture) -> CameraChange | None:
        moved = [tag_id for tag_id in self.visible if self._elsewhere[tag_id] >= MOVED_LOOKS]
        if not moved:
            return None
        if 2 * len(moved) > len(self.visible):
            return self._replaced(gray)
        for known in (self._floor, self._looks, self._elsewhere, self._seen):
            known.pop(moved[0])
        self.doubt = "moved" if any(self._elsewhere.values()) else None
        return CameraChange(moved[0], float("nan"))

    def _replaced(self, gray: Picture) -> CameraChange | None:
        """The camera placed again by all tags in a picture, if they agree with one another."""
        found = self._finder.search(gray, thorough=True)
        corners_px = {tag_id: found[tag_id].corners_px for tag_id in self._floor if tag_id in found}
        camera = place_camera(self.camera.lens, corners_px, self._floor)
        if camera is None:
            return None
        errors_px = reprojection_px(camera, corners_px, self._floor)
        if max(errors_px.values()) > MOVED_PX:
            return None
        shift_m, turned_rad = camera.moved_from(self.camera)
        for tag_id in self._floor:
            self._looks[tag_id].clear()
            self._elsewhere[tag_id] = 0
            self._seen[tag_id] = True
        self.camera, self.doubt, self._blind, self._enough = camera, None, 0, LEAST_LOOKS
        return CameraChange(None, shift_m, turned_rad)

    def _refine(self) -> None:
        """Place the camera by the mean of many looks at each tag, once a round."""
        full = {tag_id: looks for tag_id, looks in self._looks.items() if len(looks) >= self._enough}
        if len(full) < len(self.visible) or self._turn % (LEAST_LOOKS * len(self._floor)):
            return
        means_px = {tag_id: np.mean(np.stack(looks), axis=0) for tag_id, looks in full.items()}
        self.camera = place_camera(self.camera.lens, means_px, self._floor) or self.camera


def _is_elsewhere(seen_tag: SeenTag, expected_px: FloatArray) -> bool:
    miss_px = float(np.hypot(*(seen_tag.corners_px - expected_px).T).mean())
    return miss_px > max(MOVED_PX, MOVED_EDGES * seen_tag.edge_px)
