"""Cameras unlike the usual webcam, over the same floor: other lenses, and other places."""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from benchmarks.see_floor import floor_errors
from hexctl.simulators.camera.rendering import FOV_DEG
from hexctl.simulators.camera.usual_camera import LOOK_AT_M, POSITION_M
from hexctl.vision.detection.camera import Camera
from hexctl.vision.detection.lens import Lens

#: A lens of 98 deg from left to right.
FISHEYE = Lens(
    width_px=640,
    height_px=480,
    matrix=np.array([[380.0, 0, 324], [0, 378, 236], [0, 0, 1]]),
    model="equidistant",
    distortion=np.array([-0.02, 0.004, 0.0, 0.0]),
)

#: Where it stands, in m: from the usual place it does not find the home tag, which has 18 x 13 px there.
FISHEYE_M = (-1.0, 0.0, 1.2)

#: A lens of a usual angle with a quarter of the pixels.
COARSE = replace(Lens.assumed(640, 480, FOV_DEG), calibrated=True)

#: Bars of position and heading.
POSITION_MM, YAW_DEG = 10.0, 0.5

SEED = 11


def camera_rows(scale: Scale) -> Iterator[Row]:
    """Errors over the floor by one picture, camera by camera."""
    for name, camera in strange_cameras().items():
        errors = floor_errors(camera, camera.lens, scale.see_step_m, seed=SEED)
        note = f"{len(errors.places)} places on 3 x 2 m, seen at {errors.seen.mean():.0%}, one picture each"
        position_mm, yaw_deg = 1e3 * errors.position_rms_m, float(np.degrees(errors.yaw_rms_rad))
        yield Row(f"cameras.{name}.position_rms", position_mm, "mm", Bar(high=POSITION_MM), note)
        yield Row(f"cameras.{name}.yaw_rms", yaw_deg, "deg", Bar(high=YAW_DEG), note)


def strange_cameras() -> dict[str, Camera]:
    """Cameras by name."""
    return {
        "fisheye": Camera.looking(FISHEYE, np.array(FISHEYE_M), np.array(LOOK_AT_M)),
        "480p": Camera.looking(COARSE, np.array(POSITION_M), np.array(LOOK_AT_M)),
    }
