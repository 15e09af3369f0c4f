"""Locate a robot with a camera and printed tags on robot and floor.

Each command of `hexctl see` is one class, whose `run` neither prints nor exits:

    camera = hexctl.vision.RobotCamera(camera="0", connect="tcp/127.0.0.1:7447")
    report = camera.run(stop_requested)

This is the whole public interface of the package. Names are imported when first used; they need the extra
`see`.
"""

import os
from importlib.util import find_spec
from typing import TYPE_CHECKING, Any

from hexctl.errors import MissingExtraError
from hexctl.lazy_names import lazy_names

if TYPE_CHECKING:
    from hexctl.vision.camera_lens import CameraLens
    from hexctl.vision.camera_options import CameraOptions, LinkedRobotOptions
    from hexctl.vision.detection.camera import Camera
    from hexctl.vision.detection.lens import Lens, load_lens, save_lens
    from hexctl.vision.detection.lens_calibration import CalibratedLens
    from hexctl.vision.detection.planar_pose import PlacedTag, PlanarPose
    from hexctl.vision.estimation.pose_filter import PoseEstimate
    from hexctl.vision.place import (
        AssumedLens,
        CameraPose,
        FloorTag,
        Place,
        RobotTag,
        arena_of,
        load_place,
        save_place,
    )
    from hexctl.vision.pose_stream import CameraReport, CameraStatus
    from hexctl.vision.robot_camera import CameraStarted, RobotCamera
    from hexctl.vision.sheet import Sheet, save_sheet

# OpenCV reads this as it is loaded: a file of a hundred bytes may claim to hold a picture of a gigabyte. The
# largest pictures of telephones have 200 million pixels.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "210000000")

# fmt: off
__all__ = [
    # one class for each command
    "RobotCamera", "CameraStarted", "CameraStatus", "CameraReport",
    "Sheet", "save_sheet",
    "CameraLens", "CalibratedLens",
    "CameraOptions", "LinkedRobotOptions",
    # places and lenses
    "Place", "FloorTag", "RobotTag", "CameraPose", "AssumedLens", "PlacedTag", "Camera",
    "load_place", "save_place", "arena_of",
    "Lens", "load_lens", "save_lens",
    # poses
    "PlanarPose", "PoseEstimate",
]
# fmt: on

_load = lazy_names(__name__, __file__, __all__)


def __getattr__(name: str) -> Any:
    if name in __all__ and find_spec("cv2") is None:
        raise MissingExtraError(f"hexctl.vision.{name}", "see")
    return _load(name)


def __dir__() -> list[str]:
    return __all__
