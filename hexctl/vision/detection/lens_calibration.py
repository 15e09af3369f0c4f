"""Calibrate a lens from pictures of the board: selection, coverage and quality."""

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError
from hexctl.files import read_file
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.calibration_board import N_CORNERS, BoardFinder, SeenBoard
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.tags import Picture

#: Pictures without which there is no lens, and those with which none is missing; more take longer.
LEAST_PICTURES, ENOUGH_PICTURES, MOST_PICTURES = 8, 15, 40

#: Corners that a picture has to show.
LEAST_CORNERS = N_CORNERS // 3

#: Pictures in which the board's corners are nearer to one another than this share of the width are alike.
ALIKE_SHARE = 0.05

#: Share of the width and height at each side in which there has to be a corner.
EDGE_SHARE = 0.15

#: A lens that misses the corners by more does not fit, in px of a picture of 1280 px.
MOST_RMS_PX = 2.0

#: A board whose corners move by more than this share of the width from frame to frame is smeared.
STEADY_SHARE = 0.004

#: Error of the rays above which more pictures help, and above which there is no lens, in px of 1280.
DOUBT_PX, MOST_DOUBT_PX = 1.0, 8.0

#: Pictures whose reprojection error exceeds this multiple of the median are dropped as blurred.
OUTLIER = 3.0

#: Columns and rows into which the picture is divided for the coverage.
CELLS = (8, 6)

_SIDES = {"left": (0, False), "right": (0, True), "upper": (1, False), "lower": (1, True)}


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class CalibratedLens(ArrayFields):
    """A lens, and how well it is known.

    Attributes:
        lens: as calibrated.
        rms_px: by which it misses the corners of the board.
        doubt_px: by which it misses rays: half of the RMS difference between the lenses that each half of
            the pictures gives, over the whole picture.
        pictures: how many it is made of.
        coverage: share of the picture in which there were corners.
        missing: what would make it better, a sentence each.
    """

    lens: Lens
    rms_px: float
    doubt_px: float
    pictures: int
    coverage: float
    missing: tuple[str, ...]


class LensCalibration:
    """Collects pictures of the board that differ from one another; a fisheye sees more than 110 deg."""

    def __init__(self, *, fisheye: bool = False) -> None:
        self._fisheye, self._finder = fisheye, BoardFinder()
        self._size_px: tuple[int, int] | None = None
        self._views: list[SeenBoard] = []
        self._refused: Counter[str] = Counter()
        self._last: SeenBoard | None = None

    @property
    def pictures(self) -> int:
        """How many are kept."""
        return len(self._views)

    def add(self, gray: Picture) -> str | None:
        """Keep a grey picture (H, W) of the board; return the reason if it is rejected.

        Raises InputError if its size differs from that of earlier pictures.
        """
        size_px = (gray.shape[1], gray.shape[0])
        if self._size_px not in (None, size_px):
            raise InputError(
                f"got a picture of {size_px[0]}x{size_px[1]} px after one of "
                f"{'x'.join(map(str, self._size_px or ()))}; allowed: pictures of one size"
            )
        self._size_px = size_px
        view = self._finder.find(gray)
        refused = self._refusal(view)
        if view is None or refused is not None:
            self._refused[refused or ""] += 1
            return refused
        self._views.append(view)
        return None

    def add_steady(self, gray: Picture) -> bool:
        """Keep a video frame (H, W) if the board rests since the previous frame; whether it was kept.

        Raises InputError as `add` does.
        """
        last, self._last = self._last, self._finder.find(gray)
        if last is None or self._last is None:
            return False
        still_px = STEADY_SHARE * gray.shape[1]
        return _apart_px(last, self._last) < still_px and self.add(gray) is None

    def _refusal(self, view: SeenBoard | None) -> str | None:
        if view is None:
            return "no board"
        if len(view.corner_ids) < LEAST_CORNERS:
            return "too little of the board"
        if len(self._views) >= MOST_PICTURES:
            return "one too many"
        alike_px = ALIKE_SHARE * self._size()[0]
        return "too alike" if any(_apart_px(view, kept) < alike_px for kept in self._views) else None

    def _size(self) -> tuple[int, int]:
        return self._size_px or (1, 1)

    def missing(self) -> tuple[str, ...]:
        """What has not been seen yet, a sentence each."""
        said = []
        if len(self._views) < ENOUGH_PICTURES:
            said.append(f"{ENOUGH_PICTURES - len(self._views)} more pictures, each from another side")
        corners_px = self._corners_px()
        for side, (axis, far) in _SIDES.items():
            share = corners_px[:, axis] / self._size()[axis]
            if not ((1 - share if far else share) < EDGE_SHARE).any():
                said.append(f"hold it nearer to the {side} edge of the picture")
        if self._views and max(_slant(view) for view in self._views) < 1.2:
            said.append("tilt it, by 30 to 45 degrees, to each side")
        return tuple(said)

    def coverage(self) -> float:
        """Share of the picture, in cells, in which there were corners."""
        cells = np.floor(self._corners_px() / self._size() * CELLS).astype(int)
        return len({(int(column), int(row)) for column, row in cells}) / (CELLS[0] * CELLS[1])

    def _corners_px(self) -> FloatArray:
        return np.concatenate([np.empty((0, 2)), *(view.corners_px for view in self._views)])

    def solve(self) -> CalibratedLens:
        """The lens of the pictures.

        Raises InputError for fewer than `LEAST_PICTURES` that differ, and for a lens that does not fit.
        """
        if len(self._views) < LEAST_PICTURES:
            others = ", ".join(f"{count} {reason}" for reason, count in self._refused.items())
            raise InputError(
                f"calibrate: got {len(self._views)} pictures of the board that differ"
                f"{f' ({others})' if others else ''}; allowed: {LEAST_PICTURES} or more, from all sides"
            )
        kept, lens, errors_px = self._fit_without_outliers()
        rms_px = float(np.sqrt(np.mean(np.square(errors_px))))
        scale = self._size()[0] / 1280
        if not rms_px < MOST_RMS_PX * scale:
            raise InputError(
                f"calibrate: the lens misses the board's corners by {rms_px:.1f} px; allowed: below "
                f"{MOST_RMS_PX * scale:.1f}: is the board flat, are pictures sharp, is the lens a fisheye?"
            )
        doubt_px = _difference_px(self._fit(kept[::2])[0], self._fit(kept[1::2])[0]) / 2
        if not doubt_px < MOST_DOUBT_PX * scale:
            raise InputError(
                f"calibrate: two halves of the pictures give lenses that differ by {2 * doubt_px:.0f} px; "
                "allowed: a tilted board at all edges of the picture; is the lens a fisheye?"
            )
        missing = self.missing()
        if not doubt_px < DOUBT_PX * scale and not missing:
            missing = ("more pictures, nearer, at the edges and tilted",)
        return CalibratedLens(
            lens=lens, rms_px=rms_px, doubt_px=doubt_px, pictures=len(kept),
            coverage=self.coverage(), missing=missing,
        )  # fmt: skip

    def _fit_without_outliers(self) -> tuple[list[SeenBoard], Lens, FloatArray]:
        """The pictures that fit to one lens, that lens, and the RMS in px by which it misses each."""
        lens, errors_px = self._fit(self._views)
        most_px = OUTLIER * float(np.median(errors_px)) + 0.3
        kept = [view for view, error in zip(self._views, errors_px, strict=True) if error < most_px]
        if LEAST_PICTURES <= len(kept) < len(self._views):
            return kept, *self._fit(kept)
        return self._views, lens, errors_px

    def _fit(self, views: Sequence[SeenBoard]) -> tuple[Lens, FloatArray]:
        """Lens of some views, and the RMS in px by which it misses the corners of each."""
        return (_fit_fisheye if self._fisheye else _fit_plumb_bob)(views, self._size())


#: Size of the file of a picture.
MOST_BYTES = 200_000_000


def read_picture(path: Path) -> Picture:
    """Read a file as a grey picture (H, W). Raises InputError if that fails."""
    try:
        data = np.frombuffer(read_file(path, MOST_BYTES), dtype=np.uint8)
    except OSError as error:
        raise InputError(f"{path}: is no picture that can be read: {error.strerror}") from error
    try:
        picture = cv2.imdecode(data, cv2.IMREAD_GRAYSCALE) if len(data) else None
    except cv2.error:  # one that claims to have more pixels than OpenCV takes
        picture = None
    if picture is None:
        raise InputError(f"{path}: is no picture that can be read; allowed: PNG, JPEG and others")
    return np.asarray(picture, dtype=np.uint8)


def _apart_px(view: SeenBoard, other: SeenBoard) -> float:
    """Mean distance between the corners that two pictures share; infinite where they share none."""
    _, here, there = np.intersect1d(view.corner_ids, other.corner_ids, return_indices=True)
    if not len(here):
        return float("inf")
    return float(np.hypot(*(view.corners_px[here] - other.corners_px[there]).T).mean())


def _slant(view: SeenBoard) -> float:
    """How much longer one direction of the board looks than the other: 1 straight from the front."""
    linear = np.linalg.lstsq(
        np.column_stack([view.corners_m[:, :2], np.ones(len(view.corners_m))]), view.corners_px, rcond=None
    )[0][:2]
    long, short = np.linalg.svd(linear, compute_uv=False)
    return float(long / max(short, 1e-9))


def _fit_plumb_bob(views: Sequence[SeenBoard], size_px: tuple[int, int]) -> tuple[Lens, FloatArray]:
    # A first guess from parts of the board is poor; so the middle and a usual angle are given.
    matrix = Lens.assumed(*size_px, 65.0).matrix
    _, matrix, distortion, _, _, _, _, errors_px = cv2.calibrateCameraExtended(
        [view.corners_m.astype(np.float32) for view in views],
        [view.corners_px.astype(np.float32) for view in views],
        size_px, matrix, np.zeros(5), flags=cv2.CALIB_USE_INTRINSIC_GUESS,
    )  # fmt: skip
    lens = Lens(
        width_px=size_px[0], height_px=size_px[1], matrix=np.asarray(matrix),
        distortion=np.ravel(distortion)[:5],
    )  # fmt: skip
    return lens, np.ravel(errors_px)


def _fit_fisheye(views: Sequence[SeenBoard], size_px: tuple[int, int]) -> tuple[Lens, FloatArray]:
    """The best of the fits that begin with some usual angles: from a wrong one it does not get away."""
    fits = []
    for fov_deg in (90.0, 120.0, 150.0):
        try:
            fits.append(_fit_fisheye_from(views, size_px, fov_deg))
        except cv2.error:  # it did not converge from there
            continue
    if not fits:
        raise InputError(
            "calibrate: no fisheye fits; allowed: sharp pictures, or another lens model than fisheye"
        )
    return min(fits, key=lambda fit: float(np.mean(fit[1])))


def _fit_fisheye_from(
    views: Sequence[SeenBoard], size_px: tuple[int, int], fov_deg: float
) -> tuple[Lens, FloatArray]:
    focal_px = size_px[0] / np.radians(fov_deg)
    matrix = Lens.assumed(*size_px, 90.0).matrix.copy()
    matrix[0, 0] = matrix[1, 1] = focal_px
    points_m = [view.corners_m.reshape(1, -1, 3) for view in views]
    points_px = [view.corners_px.reshape(1, -1, 2) for view in views]
    flags = cv2.CALIB_RECOMPUTE_EXTRINSIC | cv2.CALIB_FIX_SKEW
    flags |= cv2.CALIB_USE_INTRINSIC_GUESS
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 100, 1e-8)
    _, matrix, distortion, turns, shifts = cv2.fisheye.calibrate(
        points_m, points_px, size_px, matrix, np.zeros(4), flags=flags, criteria=criteria
    )
    errors_px = []
    for at_m, at_px, turn, shift in zip(points_m, points_px, turns, shifts, strict=True):
        expected_px = cv2.fisheye.projectPoints(at_m, turn, shift, matrix, distortion)[0]
        errors_px.append(float(np.sqrt(np.square(expected_px - at_px).sum(axis=-1).mean())))
    lens = Lens(
        width_px=size_px[0], height_px=size_px[1], matrix=np.asarray(matrix), model="equidistant",
        distortion=np.ravel(distortion),
    )  # fmt: skip
    return lens, np.array(errors_px)


def _difference_px(lens: Lens, other: Lens) -> float:
    """RMS distance over the picture between the pixels at which two lenses see the same.

    Where one is the other, turned, they are the same: a camera's pose makes good for it.
    """
    columns, rows = np.meshgrid(np.linspace(0, lens.width_px - 1, 17), np.linspace(0, lens.height_px - 1, 11))
    points_px = np.column_stack([columns.ravel(), rows.ravel()])
    rays, others = lens.rays(points_px), other.rays(points_px)
    seen = np.isfinite(rays).all(axis=1) & np.isfinite(others).all(axis=1)
    turn, _ = Rotation.align_vectors(_units(others[seen]), _units(rays[seen]))
    apart_px = other.pixels(turn.apply(rays[seen])) - points_px[seen]
    return float(np.sqrt(np.mean(np.square(apart_px).sum(axis=1))))


def _units(rays: FloatArray) -> FloatArray:
    return np.asarray(rays / np.linalg.norm(rays, axis=1, keepdims=True))
