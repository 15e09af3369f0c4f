"""What happens to a camera on request: it is knocked over, turned, or a hand covers the robot's tag."""

import re
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError, argument
from hexctl.robot.rotations import turned
from hexctl.simulators.camera.rendering import RobotPosture
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.planar_pose import PlacedTag
from hexctl.vision.detection.tags import Picture

ALLOWED = "moved:X,Y,Z (m), turned:DEGREES or covered:SECONDS, each with @SECONDS or from the start"

#: How many numbers each kind has.
_NUMBERS = {"moved": 3, "turned": 1, "covered": 1}

_NUMBER = r"-?[0-9]+(?:\.[0-9]+)?"
_FORM = re.compile(rf"([a-z]+):({_NUMBER}(?:,{_NUMBER})*)(?:@([0-9]+(?:\.[0-9]+)?))?")

#: A hand is so much wider than the tag that it covers, and of this colour, red first.
_HAND_SHARE, _HAND_COLOR = 1.0, (196, 150, 122)


@dataclass(frozen=True, slots=True, kw_only=True)
class CameraFault:
    """One fault.

    Attributes:
        kind: `moved`, `turned` or `covered`.
        at_s: when it begins, in s since the camera was switched on.
        values: by which the camera is moved, (x, y, z) in m on the floor; its turn to the left in degrees;
            or how long the tag is covered, in s.
    """

    kind: str
    at_s: float = 0.0
    values: tuple[float, ...]


def parse_camera_fault(text: str) -> CameraFault:
    """Fault of a text such as `moved:0.05,0,0@10`; raises InputError for anything else."""
    found = _FORM.fullmatch(text)
    values = () if found is None else tuple(float(number) for number in found[2].split(","))
    if found is None or _NUMBERS.get(found[1]) != len(values) or (found[1] == "covered" and values[0] <= 0):
        raise InputError(f"{argument('fault')}: got {text!r}; allowed: {ALLOWED}")
    return CameraFault(kind=found[1], at_s=float(found[3] or 0), values=values)


def faulty_camera(still: Camera, faults: Sequence[CameraFault], at_s: float) -> Camera:
    """Pose of a camera at a time, after its faults."""
    position, rotation = still.position_floor.copy(), still.rotation
    for fault in faults:
        if fault.at_s <= at_s and fault.kind == "moved":
            position += fault.values
        elif fault.at_s <= at_s and fault.kind == "turned":
            rotation = Rotation.from_euler("z", fault.values[0], degrees=True).as_matrix() @ rotation
    return Camera(still.lens, rotation, position)


def is_covered(faults: Sequence[CameraFault], at_s: float) -> bool:
    """Whether a hand is over the robot's tag at a time."""
    return any(
        fault.kind == "covered" and fault.at_s <= at_s < fault.at_s + fault.values[0] for fault in faults
    )


def with_hand(picture: Picture, camera: Camera, posture: RobotPosture, tag: PlacedTag) -> Picture:
    """A picture (H, W, 3), red first, in which a hand covers the tag on a robot."""
    on_body = np.array([tag.pose.x_m, tag.pose.y_m, tag.height_m])
    middle = posture.position_floor + turned(posture.quaternion_floor, on_body)
    edge = middle + camera.rotation[:, 0] * tag.edge_m * _HAND_SHARE
    seen_px = camera.pixels(np.array([middle, edge]))
    if not np.isfinite(seen_px).all():
        return picture
    covered = picture.copy()
    radius_px = int(np.hypot(*(seen_px[1] - seen_px[0]))) + 1
    cv2.circle(covered, tuple(int(pixel) for pixel in seen_px[0]), radius_px, _HAND_COLOR, cv2.FILLED)
    return covered
