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
from hexctl.vision.detection.camera import Camera, camera_candidates, reprojection_px
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
    """The tags on the floor by number, the camera that saw them, and reasons not to trust them."""

    tags: Mapping[int, PlacedTag]
    camera: Camera
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


def learn_floor(lens: Lens, corners_px: CornersPx, edges_m: Mapping[int, float]) -> LearnedFloor:
    """Fit the poses of floor tags and camera to the corners (4, 2) that the camera sees.

    One least-squares fit of all corners gives the pose of the camera and x, y and yaw of every tag. The home
    tag is the origin. All edges together set the scale. Tags without an edge are not used.

    Raises InputError if the home tag was not seen or nothing fits.
    """
    seen = {tag_id: corners_px[tag_id] for tag_id in sorted(corners_px) if tag_id in edges_m}
    if HOME_TAG not in seen:
        raise InputError(
            f"floor: got {f'only the tags {list(seen)}' if seen else 'no tag in the picture'}; "
            f"allowed: pictures in which the home tag {HOME_TAG} is seen"
        )
    fits = [_Fit(lens, seen, edges_m, *start) for start in _starts(lens, seen, edges_m)]
    if not fits:
        raise InputError("floor: got tags that do not lie in one plane; allowed: tags on a flat floor")
    likely = sorted(fits, key=lambda fit: fit.cost)[:TRIED]
    return min((fit.solve() for fit in likely), key=lambda fit: fit.cost).learned()


def _starts(
    lens: Lens, seen: CornersPx, edges_m: Mapping[int, float]
) -> Iterable[tuple[Camera, dict[int, PlanarPose]]]:
    """First guesses of camera and tags: by each tag, in both ways in which it may be tilted."""
    for tag_id, corners_px in seen.items():
        for candidate in camera_candidates(lens, corners_px, UNIT_CORNERS * edges_m[tag_id]):
            home = tag_pose(candidate, seen[HOME_TAG], 0.0)
            if home is None:
                continue
            camera = _moved(candidate, home.pose.inverse())
            fits = {other: tag_pose(camera, px, 0.0) for other, px in seen.items() if other != HOME_TAG}
            poses = {other: fit.pose for other, fit in fits.items() if fit is not None}
            yield camera, {HOME_TAG: PlanarPose(0.0, 0.0, 0.0)} | poses


def _moved(camera: Camera, frame: PlanarPose) -> Camera:
    """The camera in another frame of the floor, in which the old one has a pose."""
    turn = Rotation.from_euler("z", frame.yaw_rad).as_matrix()
    position = turn @ camera.position_floor + [frame.x_m, frame.y_m, 0.0]
    return Camera(camera.lens, turn @ camera.rotation, position)


class _Fit:
    """All corners fitted together (bundle adjustment on a plane), with a loss that bears single bad tags."""

    def __init__(
        self, lens: Lens, seen: CornersPx, edges_m: Mapping[int, float], camera: Camera,
        poses: Mapping[int, PlanarPose],
    ) -> None:  # fmt: skip
        self._lens, self._edges_m = lens, edges_m
        self._seen = {tag_id: corners_px for tag_id, corners_px in seen.items() if tag_id in poses}
        self._tag_ids = sorted(set(poses) - {HOME_TAG})
        start = [Rotation.from_matrix(camera.rotation).as_rotvec(), camera.position_floor]
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

    def _unpacked(self, values: FloatArray) -> tuple[Camera, dict[int, PlacedTag]]:
        camera = Camera(self._lens, Rotation.from_rotvec(values[:3]).as_matrix(), values[3:6])
        tags = {HOME_TAG: PlacedTag(HOME_TAG, self._edges_m[HOME_TAG], PlanarPose(0.0, 0.0, 0.0))}
        for tag_id, (x_m, y_m, yaw) in zip(self._tag_ids, values[6:].reshape(-1, 3), strict=True):
            pose = PlanarPose(float(x_m), float(y_m), wrapped_rad(float(yaw)))
            tags[tag_id] = PlacedTag(tag_id, self._edges_m[tag_id], pose)
        return camera, tags

    def _misses(self, values: FloatArray) -> FloatArray:
        camera, tags = self._unpacked(values)
        points = np.concatenate([tags[tag_id].corners for tag_id in self._seen])
        expected_px = camera.pixels(np.column_stack([points, np.zeros(len(points))]))
        misses = expected_px - np.concatenate(list(self._seen.values()))
        return np.asarray(np.nan_to_num(misses.ravel(), nan=1e3))

    def learned(self) -> LearnedFloor:
        """The result with its doubts."""
        camera, tags = self._unpacked(self._solution.x)
        doubts = [
            *(() if self._lens.calibrated else (LENS_DOUBT,)),
            *_tag_doubts(camera, self._seen, tags, self._deviations_m()),
        ]
        if len(tags) == 1:
            doubts.append("only one tag is seen: far from it the floor is a guess; lay out more")
        return LearnedFloor(tags=tags, camera=camera, doubts=tuple(doubts))

    def _deviations_m(self) -> dict[int, float]:
        """Standard deviation of each tag's position, by the corners' and the curvature of the fit."""
        jacobian = self._solution.jac
        covariance = np.linalg.pinv(jacobian.T @ jacobian) * CORNER_PX**2
        variances = np.diag(covariance)[6:].reshape(-1, 3)
        told = {
            tag_id: float(np.sqrt(each[:2].sum()))
            for tag_id, each in zip(self._tag_ids, variances, strict=True)
        }
        return {HOME_TAG: 0.0} | told


def _tag_doubts(
    camera: Camera, seen: CornersPx, tags: Mapping[int, PlacedTag], deviations_m: Mapping[int, float]
) -> Iterable[str]:
    errors_px = reprojection_px(camera, seen, {tag_id: tag.corners for tag_id, tag in tags.items()})
    for tag_id, tag in tags.items():
        look = tag_pose(camera, seen[tag_id], 0.0)
        share = 0.0 if look is None else look.scale / tag.edge_m - 1
        if abs(share) > DOUBT_EDGE:
            yield (
                f"tag {tag_id} looks {1000 * tag.edge_m * (1 + share):.0f} mm wide and should be "
                f"{1000 * tag.edge_m:.0f}: is it on the floor, and printed like the others?"
            )
        elif errors_px[tag_id] > DOUBT_PX:
            error_px = errors_px[tag_id]
            yield f"tag {tag_id} is seen {error_px:.1f} px from where a flat one would be: is it flat?"
        if deviations_m[tag_id] > DOUBT_M:
            yield f"tag {tag_id} may be {1000 * deviations_m[tag_id]:.0f} mm off: use larger or more tags"
