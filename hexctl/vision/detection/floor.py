"""Where the tags on the floor lie, learned by looking at them."""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError
from hexctl.robot.rotations import wrapped_rad
from hexctl.types import ArrayFields, FloatArray
from hexctl.vision.detection.camera import Camera, camera_candidates, place_camera, reprojection_px
from hexctl.vision.detection.lens import Lens
from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose, tag_pose
from hexctl.vision.detection.tags import HOME_TAG, UNIT_CORNERS, SeenTag

#: Minimum share of the pictures of one camera position that must show a tag.
LEAST_SEEN = 0.3

#: Trimmed share at both ends of a corner's coordinates.
TRIMMED = 0.25

#: Standard deviation of a corner in the mean of many pictures, in px: what noise, paper and lens leave.
CORNER_PX = 0.2

#: Thresholds of a doubt about a tag: deviation in px, relative error of its edge, and standard deviation of
#: its position in m.
DOUBT_PX, DOUBT_EDGE, DOUBT_M = 1.5, 0.04, 0.01

#: Start of the doubt about an uncalibrated lens.
LENS_DOUBT = (
    "the lens is only assumed, by which tags may look too small, bent or far off: calibrate it with hexctl "
    "see calibrate"
)

#: First guesses from which the fit begins.
TRIED = 2

CornersPx = Mapping[int, FloatArray]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LearnedFloor(ArrayFields):
    """The tags on the floor and the poses of the camera that saw them.

    Attributes:
        tags: by number.
        cameras: one for each position of the camera.
        residuals_px: RMS reprojection error of each tag's corners, by number.
        doubts: reasons not to trust the result, one sentence each.
    """

    tags: Mapping[int, PlacedTag]
    cameras: tuple[Camera, ...]
    residuals_px: Mapping[int, float]
    doubts: tuple[str, ...]


def averaged_corners(pictures: Sequence[Mapping[int, SeenTag]]) -> dict[int, FloatArray]:
    """Corners (4, 2) of the tags in many pictures of a camera that stands still, by number.

    Means without the outer quarters: nearly as sure as a mean, and single bad pictures do no harm.
    """
    from scipy.stats import trim_mean

    tag_ids = {tag_id for found in pictures for tag_id in found}
    stacks = {
        tag_id: np.stack([found[tag_id].corners_px for found in pictures if tag_id in found])
        for tag_id in tag_ids
    }
    least = max(1.0, LEAST_SEEN * len(pictures))
    return {
        tag_id: trim_mean(stack, TRIMMED, axis=0)
        for tag_id, stack in sorted(stacks.items())
        if len(stack) >= least
    }


def learn_floor(lens: Lens, views: Sequence[CornersPx], edges_m: Mapping[int, float]) -> LearnedFloor:
    """Fit the poses of floor tags and camera to pictures from one or several camera positions.

    One least-squares fit of all corners gives the poses of the camera and x, y and yaw of every tag. The home
    tag is the origin. All edges together set the scale.

    Args:
        lens: of the camera.
        views: corners (4, 2) in px by number, for each position of the camera.
        edges_m: edges of the floor tags, by number; other tags are not used.

    Raises InputError if the home tag was never seen or nothing fits.
    """
    if HOME_TAG not in edges_m:
        raise InputError(f"floor: got no edge of tag {HOME_TAG}; allowed: tags with the home tag {HOME_TAG}")
    seen = [{tag_id: view[tag_id] for tag_id in sorted(view) if tag_id in edges_m} for view in views]
    if not any(HOME_TAG in view for view in seen):
        others = sorted({tag_id for view in seen for tag_id in view})
        raise InputError(
            f"floor: got {f'only the tags {others}' if others else 'no tag in the picture'}; "
            f"allowed: pictures in which the home tag {HOME_TAG} is seen"
        )
    fits = [_Fit(lens, seen, edges_m, *start) for start in _starts(lens, seen, edges_m)]
    if not fits:
        raise InputError("floor: got tags that do not lie in one plane; allowed: tags on a flat floor")
    likely = sorted(fits, key=lambda fit: fit.cost)[:TRIED]
    return min((fit.solve() for fit in likely), key=lambda fit: fit.cost).learned()


def _starts(
    lens: Lens, views: Sequence[CornersPx], edges_m: Mapping[int, float]
) -> Iterable[tuple[dict[int, Camera], dict[int, PlanarPose]]]:
    """First guesses: by each tag of a view with the home tag, in both ways in which it may be tilted."""
    first = next(number for number, view in enumerate(views) if HOME_TAG in view)
    for tag_id, corners_px in views[first].items():
        for camera in camera_candidates(lens, corners_px, UNIT_CORNERS * edges_m[tag_id]):
            home = _seen_pose(camera, views[first][HOME_TAG])
            if home is not None:
                cameras = {first: _moved(camera, home.inverse())}
                yield cameras, _chained(lens, views, edges_m, cameras)


def _chained(
    lens: Lens, views: Sequence[CornersPx], edges_m: Mapping[int, float], cameras: dict[int, Camera]
) -> dict[int, PlanarPose]:
    """Poses of the tags from camera to tag to camera; a position that shares no tag is left out."""
    poses = {HOME_TAG: PlanarPose(0.0, 0.0, 0.0)}
    known = 0
    while known < len(poses) + len(cameras):
        known = len(poses) + len(cameras)
        for number, camera in cameras.items():
            for tag_id, corners_px in views[number].items():
                pose = None if tag_id in poses else _seen_pose(camera, corners_px)
                if pose is not None:
                    poses[tag_id] = pose
        corners = {tag_id: PlacedTag(tag_id, edges_m[tag_id], pose).corners for tag_id, pose in poses.items()}
        for number, view in enumerate(views):
            camera_there = None if number in cameras else place_camera(lens, view, corners)
            if camera_there is not None:
                cameras[number] = camera_there
    return poses


def _seen_pose(camera: Camera, corners_px: FloatArray) -> PlanarPose | None:
    seen = tag_pose(camera, corners_px, 0.0)
    return None if seen is None else seen.pose


def _moved(camera: Camera, frame: PlanarPose) -> Camera:
    """The camera in another frame of the floor, in which the old one has a pose."""
    turn = Rotation.from_euler("z", frame.yaw_rad).as_matrix()
    position = turn @ camera.position_floor + [frame.x_m, frame.y_m, 0.0]
    return Camera(camera.lens, turn @ camera.rotation, position)


class _Fit:
    """All corners fitted together (bundle adjustment on a plane), with a loss that bears single bad tags."""

    def __init__(
        self, lens: Lens, views: Sequence[CornersPx], edges_m: Mapping[int, float],
        cameras: Mapping[int, Camera], poses: Mapping[int, PlanarPose],
    ) -> None:  # fmt: skip
        self._lens, self._edges_m = lens, edges_m
        self._positions = sorted(cameras)
        self._left_out = sorted(set(range(len(views))) - set(cameras))
        self._views = [
            {key: views[number][key] for key in views[number] if key in poses} for number in self._positions
        ]
        self._tag_ids = sorted(set(poses) - {HOME_TAG})
        start = [
            np.r_[Rotation.from_matrix(cameras[number].rotation).as_rotvec(), cameras[number].position_floor]
            for number in self._positions
        ]
        start += [
            np.array([pose.x_m, pose.y_m, pose.yaw_rad]) for pose in map(poses.__getitem__, self._tag_ids)
        ]
        self._start = np.concatenate(start)
        self._solution: Any = None

    @property
    def cost(self) -> float:
        """Loss of the fit."""
        misses = self._misses(self._start if self._solution is None else self._solution.x)
        return float(np.sum(np.sqrt(1 + misses**2) - 1))

    def solve(self) -> "_Fit":
        """Make the loss small."""
        self._solution = least_squares(
            self._misses, self._start, loss="soft_l1", f_scale=1.0, x_scale="jac", xtol=1e-7, max_nfev=60
        )
        return self

    def _unpacked(self, values: FloatArray) -> tuple[list[Camera], dict[int, PlacedTag]]:
        count = len(self._positions)
        cameras = [
            Camera(self._lens, Rotation.from_rotvec(six[:3]).as_matrix(), six[3:])
            for six in values[: 6 * count].reshape(-1, 6)
        ]
        tags = {HOME_TAG: PlacedTag(HOME_TAG, self._edges_m[HOME_TAG], PlanarPose(0.0, 0.0, 0.0))}
        for tag_id, (x_m, y_m, yaw) in zip(self._tag_ids, values[6 * count :].reshape(-1, 3), strict=True):
            pose = PlanarPose(float(x_m), float(y_m), wrapped_rad(float(yaw)))
            tags[tag_id] = PlacedTag(tag_id, self._edges_m[tag_id], pose)
        return cameras, tags

    def _misses(self, values: FloatArray) -> FloatArray:
        cameras, tags = self._unpacked(values)
        misses = []
        for camera, view in zip(cameras, self._views, strict=True):
            points = np.concatenate([tags[tag_id].corners for tag_id in view])
            expected_px = camera.pixels(np.column_stack([points, np.zeros(len(points))]))
            misses.append(expected_px - np.concatenate(list(view.values())))
        return np.asarray(np.nan_to_num(np.concatenate(misses).ravel(), nan=1e3))

    def learned(self) -> LearnedFloor:
        """The result with its doubts."""
        cameras, tags = self._unpacked(self._solution.x)
        corners = {tag_id: tag.corners for tag_id, tag in tags.items()}
        squares: dict[int, list[float]] = {tag_id: [] for tag_id in tags}
        for camera, view in zip(cameras, self._views, strict=True):
            for tag_id, error_px in reprojection_px(camera, view, corners).items():
                squares[tag_id].append(error_px**2)
        residuals_px = {tag_id: float(np.sqrt(np.mean(each))) for tag_id, each in squares.items() if each}
        deviations_m = self._deviations_m()
        doubts = [
            *(() if self._lens.calibrated else (LENS_DOUBT,)),
            *_tag_doubts(cameras, self._views, tags, residuals_px, deviations_m),
            *(f"camera position {number + 1} shares no tag with the others" for number in self._left_out),
        ]
        if len(tags) == 1:
            doubts.append("only one tag is seen: far from it the floor is a guess; lay out more")
        return LearnedFloor(
            tags=tags, cameras=tuple(cameras), residuals_px=residuals_px,
            doubts=tuple(doubts),
        )  # fmt: skip

    def _deviations_m(self) -> dict[int, float]:
        """Standard deviation of each tag's position, by the corners' and the curvature of the fit."""
        jacobian = self._solution.jac
        covariance = np.linalg.pinv(jacobian.T @ jacobian) * CORNER_PX**2
        variances = np.diag(covariance)[6 * len(self._positions) :].reshape(-1, 3)
        told = {
            tag_id: float(np.sqrt(each[:2].sum()))
            for tag_id, each in zip(self._tag_ids, variances, strict=True)
        }
        return {HOME_TAG: 0.0} | told


def _tag_doubts(
    cameras: Sequence[Camera], views: Sequence[CornersPx], tags: Mapping[int, PlacedTag],
    residuals_px: Mapping[int, float], deviations_m: Mapping[int, float],
) -> Iterable[str]:  # fmt: skip
    for tag_id, tag in tags.items():
        looks = [
            seen.scale / tag.edge_m - 1
            for camera, view in zip(cameras, views, strict=True)
            if tag_id in view and (seen := tag_pose(camera, view[tag_id], 0.0))
        ]
        share = float(np.mean(looks)) if looks else 0.0
        if abs(share) > DOUBT_EDGE:
            yield (
                f"tag {tag_id} looks {1000 * tag.edge_m * (1 + share):.0f} mm wide and should be "
                f"{1000 * tag.edge_m:.0f}: is it on the floor, and printed like the others?"
            )
        elif residuals_px[tag_id] > DOUBT_PX:
            error_px = residuals_px[tag_id]
            yield f"tag {tag_id} is seen {error_px:.1f} px from where a flat one would be: is it flat?"
        if deviations_m[tag_id] > DOUBT_M:
            yield f"tag {tag_id} may be {1000 * deviations_m[tag_id]:.0f} mm off: use larger or more tags"
