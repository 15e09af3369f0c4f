"""Whether the camera still stands where it stood: by the tags on the floor, a look at each in turn."""

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from hexctl.see.camera import Camera, place_camera, reprojection_px
from hexctl.see.tags import Picture, Sighted, TagFinder, only
from hexctl.types import ArrayFields, FloatArray

#: A tag seen farther than this from where it should be was moved, or the camera was: in px, and in edges.
MOVED_PX, MOVED_EDGES = 2.0, 0.06

#: Looks in a row at which a tag has to be elsewhere.
MOVED_LOOKS = 3

#: Looks at each tag of which the mean is taken.
AVERAGED = 30

#: Looks at a tag without seeing it after which it is searched for in the whole picture.
LOST_LOOKS = 10


@dataclass(frozen=True, slots=True, eq=False)
class CameraChange(ArrayFields):
    """Something that moved: the camera, or a tag on the floor.

    Attributes:
        tag_id: the tag, or None for the camera.
        camera: as it stands now.
        shift_m: by which the camera moved; NaN for a tag.
    """

    tag_id: int | None
    camera: Camera
    shift_m: float


class CameraWatch:
    """Looks at one tag on the floor in each picture, and knows where the camera is.

    A camera that stays gets better known: the mean of many looks counts. If most of the tags are seen
    elsewhere, the camera has moved, and is placed anew by all tags that are seen; if a minority is, those
    tags have, and are no longer used.

    Args:
        camera: as believed at first.
        floor_corners: corners (4, 2) of the tags on the floor in m, by number.
        finder: of the tags.
    """

    def __init__(self, camera: Camera, floor_corners: Mapping[int, FloatArray], finder: TagFinder) -> None:
        self.camera = camera
        self._floor, self._finder = dict(floor_corners), finder
        self._looks: dict[int, deque[FloatArray]] = {tag_id: deque(maxlen=AVERAGED) for tag_id in self._floor}
        self._elsewhere = dict.fromkeys(self._floor, 0)
        self._unseen = dict.fromkeys(self._floor, 0)
        self._turn = 0

    @property
    def visible(self) -> list[int]:
        """Numbers of the tags that were seen lately, or not yet looked at."""
        return [tag_id for tag_id, looks in self._unseen.items() if looks < LOST_LOOKS]

    def look(self, gray: Picture) -> CameraChange | None:
        """Look at the next tag in a picture; what was found to have moved, or None."""
        if not self._floor:
            return None
        tag_id = sorted(self._floor)[self._turn % len(self._floor)]
        self._turn += 1
        expected_px = self._expected_px(tag_id)
        sighted = self._finder.near(gray, {tag_id: expected_px}).get(tag_id)
        if sighted is None:
            self._unseen[tag_id] += 1
            # A camera that has moved far sees none of them where it looks for them.
            nothing = all(looks >= LOST_LOOKS for looks in self._unseen.values())
            return self._replaced(gray) if nothing and self._turn % LOST_LOOKS == 0 else None
        self._unseen[tag_id] = 0
        if _is_elsewhere(sighted, expected_px):
            self._elsewhere[tag_id] += 1
            return self._judged(gray)
        self._elsewhere[tag_id] = 0
        self._looks[tag_id].append(sighted.corners_px)
        self._refine()
        return None

    def _expected_px(self, tag_id: int) -> FloatArray:
        return self.camera.pixels(np.column_stack([self._floor[tag_id], np.zeros(4)]))

    def _judged(self, gray: Picture) -> CameraChange | None:
        """What moved, once enough looks agree."""
        seen = [tag_id for tag_id in self._floor if tag_id in self.visible]
        moved = [tag_id for tag_id in seen if self._elsewhere[tag_id] >= MOVED_LOOKS]
        if not moved:
            return None
        if 2 * len(moved) > len(seen):
            return self._replaced(gray)
        if any(self._elsewhere[tag_id] for tag_id in set(seen) - set(moved)):
            return None  # the others are about to be judged
        dropped = moved[0]
        self._forget(dropped)
        return CameraChange(dropped, self.camera, float("nan"))

    def _forget(self, tag_id: int) -> None:
        for known in (self._floor, self._looks, self._elsewhere, self._unseen):
            known.pop(tag_id)

    def _replaced(self, gray: Picture) -> CameraChange | None:
        """The camera placed anew by all tags in a picture, if they agree with one another."""
        found = only(self._finder.search(gray, thorough=True), self._floor)
        corners_px = {tag_id: sighted.corners_px for tag_id, sighted in found.items()}
        camera = place_camera(self.camera.lens, corners_px, self._floor)
        if camera is None:
            return None
        errors_px = reprojection_px(camera, corners_px, self._floor)
        if max(errors_px.values()) > MOVED_PX:
            return None
        shift_m = float(np.linalg.norm(camera.position_floor - self.camera.position_floor))
        self.camera = camera
        for tag_id in self._floor:
            self._looks[tag_id].clear()
            self._elsewhere[tag_id] = 0
            self._unseen[tag_id] = 0
        return CameraChange(None, camera, shift_m)

    def _refine(self) -> None:
        """Place the camera by the mean of many looks at each tag, once a round."""
        full = {tag_id: looks for tag_id, looks in self._looks.items() if len(looks) == AVERAGED}
        if len(full) < len(self.visible) or self._turn % (AVERAGED * len(self._floor)):
            return
        means_px = {tag_id: np.mean(np.stack(looks), axis=0) for tag_id, looks in full.items()}
        self.camera = place_camera(self.camera.lens, means_px, self._floor) or self.camera


def _is_elsewhere(sighted: Sighted, expected_px: FloatArray) -> bool:
    miss_px = float(np.hypot(*(sighted.corners_px - expected_px).T).mean())
    return miss_px > max(MOVED_PX, MOVED_EDGES * sighted.edge_px)
