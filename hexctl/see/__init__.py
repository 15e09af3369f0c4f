"""A camera over the floor, and tags on robot and floor: where the robot is.

What `hexctl see` does is one class for each of its commands, whose `run` neither prints nor exits:

    camera = hexctl.see.RobotCamera(camera="0", connect="tcp/127.0.0.1:7447")
    report = camera.run(stop_requested)

This is the whole public interface of the package. Names are imported when first used; they need the extra
`see`.
"""

import os
from typing import TYPE_CHECKING

from hexctl.lazy_names import lazy_names

if TYPE_CHECKING:
    from hexctl.see.camera_lens import CameraLens
    from hexctl.see.estimation.latency import Latency
    from hexctl.see.estimation.pose_filter import PoseEstimate
    from hexctl.see.latency_trial import CameraLatency, LatencyTrial, TwistAhead
    from hexctl.see.options import CameraOptions, LinkOptions
    from hexctl.see.place import Place, arena_of, load_place, save_place
    from hexctl.see.pose_stream import CameraReport, CameraStatus
    from hexctl.see.robot_camera import CameraStarted, RobotCamera
    from hexctl.see.sheet import Sheet, save_sheet
    from hexctl.see.twin.rendering import PlacedTag
    from hexctl.see.twin.twin_camera import TwinCamera, TwinReport, TwinStarted
    from hexctl.see.vision.calibration import CalibratedLens
    from hexctl.see.vision.camera import Camera
    from hexctl.see.vision.floor import FloorTag
    from hexctl.see.vision.lens import Lens, load_lens, save_lens
    from hexctl.see.vision.planar_pose import PlanarPose
    from hexctl.see.vision.robot_tracker import RobotTag

# OpenCV reads this as it is loaded: a file of a hundred bytes may claim to hold a picture of a gigabyte. The
# largest pictures of telephones have 200 million pixels.
os.environ.setdefault("OPENCV_IO_MAX_IMAGE_PIXELS", "210000000")

# fmt: off
__all__ = [
    # one class for each command
    "RobotCamera", "CameraStarted", "CameraStatus", "CameraReport",
    "Sheet", "save_sheet",
    "CameraLens", "CalibratedLens",
    "CameraLatency", "TwistAhead", "LatencyTrial", "Latency",
    "TwinCamera", "TwinStarted", "TwinReport", "PlacedTag",
    "CameraOptions", "LinkOptions",
    # places and lenses
    "Place", "load_place", "save_place", "arena_of", "FloorTag", "RobotTag", "Camera",
    "Lens", "load_lens", "save_lens",
    # poses
    "PlanarPose", "PoseEstimate",
]
# fmt: on

__getattr__ = lazy_names(
    "hexctl.see",
    {
        "robot_camera": "RobotCamera CameraStarted",
        "pose_stream": "CameraStatus CameraReport",
        "sheet": "Sheet save_sheet",
        "camera_lens": "CameraLens",
        "vision.calibration": "CalibratedLens",
        "latency_trial": "CameraLatency TwistAhead LatencyTrial",
        "estimation.latency": "Latency",
        "twin.twin_camera": "TwinCamera TwinStarted TwinReport",
        "twin.rendering": "PlacedTag",
        "options": "CameraOptions LinkOptions",
        "place": "Place load_place save_place arena_of",
        "vision.floor": "FloorTag",
        "vision.robot_tracker": "RobotTag",
        "vision.camera": "Camera",
        "vision.lens": "Lens load_lens save_lens",
        "vision.planar_pose": "PlanarPose",
        "estimation.pose_filter": "PoseEstimate",
    },
)


def __dir__() -> list[str]:
    return __all__
