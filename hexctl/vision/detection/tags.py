"""AprilTags of the family 36h11 in a picture: the corners of each, to a fraction of a pixel."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.types import ArrayFields, FloatArray

FAMILY = "tag36h11"

#: Numbers of the tags of the family.
TAG_IDS = range(587)

#: Number of the tag whose middle is the origin of the floor.
HOME_TAG = 0

#: Modules along the edge of a tag's black square; the print has one white module around it.
MODULES = 8

#: Corners of a tag with an edge of 1 in its own frame, x to the right and y up as printed: (4, 2), and so in
#: every array of corners.
UNIT_CORNERS = np.array([[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]])

#: The AprilTag library calls another corner the first one: its tags are turned by 180 deg to OpenCV's.
_OUR_ORDER = [2, 3, 0, 1]

#: Fewer differences between the black and the white of a tag than this, of 255, and it is noise.
LEAST_MARGIN = 20.0

#: A crop around a tag is this much wider than the tag at each side, in edges of it.
CROP_MARGIN = 0.35

#: A tag below this edge, in px, is not decoded reliably.
LEAST_EDGE_PX = 12.0

#: The edges of smaller tags are fitted through so few pixels that corners are tenths of a pixel off, always
#: to the same side: such tags are looked at enlarged.
GOOD_EDGE_PX = 40.0

Picture = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class SeenTag(ArrayFields):
    """A tag in a picture.

    Attributes:
        tag_id: its number.
        corners_px: (4, 2) in the order of `UNIT_CORNERS`; the middle of the first pixel is (0, 0).
        margin: by which black and white differ, up to 255: a measure of blur and light.
    """

    tag_id: int
    corners_px: FloatArray
    margin: float

    @property
    def edge_px(self) -> float:
        """Mean length of the edges."""
        steps = self.corners_px - np.roll(self.corners_px, 1, axis=0)
        return float(np.hypot(*steps.T).mean())


class TagFinder:
    """Finds tags in pictures: all of them in a whole picture, or known ones near where they were.

    A whole picture takes tens of milliseconds at 720p, a crop one or two. Not for several threads.
    """

    def __init__(self) -> None:
        from pyapriltags import Detector

        self._coarse: Any = Detector(families=FAMILY, nthreads=1, quad_decimate=2.0)
        self._fine: Any = Detector(families=FAMILY, nthreads=1, quad_decimate=1.0)

    def search(self, gray: Picture, *, thorough: bool = False) -> dict[int, SeenTag]:
        """Tags anywhere in a grey picture (H, W), by number.

        Of two tags with one number the larger one counts: the other is a reflection, or a page too many.
        A thorough search takes three times as long and also finds tags with edges of 15 to 30 px.
        """
        if thorough:
            return self._found(self._fine, gray, (0, 0))
        found = {}
        for rough in self._found(self._coarse, gray, (0, 0)).values():
            near = self.near(gray, {rough.tag_id: rough.corners_px})
            found[rough.tag_id] = near.get(rough.tag_id, rough)
        return found

    def near(self, gray: Picture, expected_px: Mapping[int, FloatArray]) -> dict[int, SeenTag]:
        """Tags near the corners (4, 2) at which they are expected, by number."""
        found = {}
        for tag_id, corners_px in expected_px.items():
            window = _window(corners_px, gray.shape)
            if window is None:
                continue
            top, bottom, left, right = window
            crop = np.ascontiguousarray(gray[top:bottom, left:right])
            seen_tag = self._found(self._fine, crop, (left, top), _enlarged(corners_px)).get(tag_id)
            if seen_tag is not None:
                found[tag_id] = seen_tag
        return found

    def _found(
        self, detector: Any, gray: Picture, origin_px: tuple[int, int], times: int = 1
    ) -> dict[int, SeenTag]:
        """Tags in a part of a picture that begins at an origin, looked at as many times larger."""
        if times > 1:
            import cv2

            gray = np.asarray(cv2.resize(gray, None, fx=times, fy=times, interpolation=cv2.INTER_CUBIC))
        found: dict[int, SeenTag] = {}
        for detection in detector.detect(gray):
            if detection.hamming > 0 or detection.decision_margin < LEAST_MARGIN:
                continue
            corners_px = np.array(detection.corners)[_OUR_ORDER] / times - 0.5 + origin_px
            seen_tag = SeenTag(int(detection.tag_id), corners_px, float(detection.decision_margin))
            if seen_tag.edge_px < LEAST_EDGE_PX:
                continue
            before = found.get(seen_tag.tag_id)
            if before is None or before.edge_px < seen_tag.edge_px:
                found[seen_tag.tag_id] = seen_tag
        return found


def _enlarged(corners_px: FloatArray) -> int:
    """How many times larger a tag is looked at, by its narrow direction: by `GOOD_EDGE_PX`, at most 3."""
    diagonals = corners_px[[0, 1]] - corners_px[[2, 3]]
    narrow_px = float(np.linalg.svd(diagonals, compute_uv=False)[-1])
    return int(np.clip(np.ceil(GOOD_EDGE_PX / max(narrow_px, 1.0)), 1, 3))


def _window(corners_px: FloatArray, shape: tuple[int, ...]) -> tuple[int, int, int, int] | None:
    """Rows and columns around corners, or None outside of the picture."""
    if not np.isfinite(corners_px).all():
        return None
    low, high = corners_px.min(axis=0), corners_px.max(axis=0)
    margin = CROP_MARGIN * float((high - low).max()) + 4
    left, top = (int(edge) for edge in np.maximum(low - margin, 0))
    right, bottom = (int(edge) + 1 for edge in np.minimum(high + margin, [shape[1], shape[0]]))
    return (top, bottom, left, right) if bottom - top > MODULES and right - left > MODULES else None


def tag_modules(tag_id: int) -> NDArray[np.bool_]:
    """Modules of a tag as printed, (8, 8), the top row first; True is black."""
    import cv2

    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return np.asarray(cv2.aruco.generateImageMarker(dictionary, tag_id, MODULES)) < 128
