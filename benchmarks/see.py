"""A webcam and printed tags: how well a robot is seen, what a picture costs, how a line is held by it."""

from collections.abc import Iterator

import numpy as np

from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from benchmarks.see_floor import floor_errors
from benchmarks.seen_servos import held_walk
from hexctl.simulators.camera.rendering import CAMERA, WEBCAM

#: Bars: of position and heading over a floor of 3 x 2 m, of a picture while the robot is followed, and of
#: how much farther off a line ends that is held by the camera than one that is held by the true pose.
POSITION_MM, YAW_DEG, PICTURE_MS, HELD_CM = 10.0, 0.5, 10.0, 1.0

#: A core of a Raspberry Pi 4 takes about this many times as long for Python with NumPy and OpenCV as one of a
#: server of 2024: an estimate, by published single-core figures, and not a measurement.
PI_TIMES = 4.0

#: Noise of each corner in a worse camera, and pictures that the filter gets of it.
NOISE_PX, NOISY_PICTURES = 1.0, 30

#: World of `transfer` in which lines are held.
WORLD = 486

SEED = 11


def see_rows(scale: Scale) -> Iterator[Row]:
    """Errors over the floor, cost of a picture, lines that are held by the camera."""
    clear = floor_errors(CAMERA, WEBCAM, scale.see_step_m, seed=SEED)
    note = f"{len(clear.places)} places on 3 x 2 m, seen at {clear.seen.mean():.0%}, one picture each"
    yield Row("see.position_rms", 1e3 * clear.position_rms_m, "mm", Bar(high=POSITION_MM), note)
    yield Row("see.yaw_rms", float(np.degrees(clear.yaw_rms_rad)), "deg", Bar(high=YAW_DEG), note)
    noisy = floor_errors(
        CAMERA, WEBCAM, 2 * scale.see_step_m, noise_px=NOISE_PX, pictures=NOISY_PICTURES, seed=SEED
    )
    note = f"{NOISE_PX:g} px of noise at each corner, after {NOISY_PICTURES} pictures"
    yield Row("see.noisy.position_rms", 1e3 * noisy.position_rms_m, "mm", Bar(high=POSITION_MM), note)
    yield Row("see.noisy.yaw_rms", float(np.degrees(noisy.yaw_rms_rad)), "deg", Bar(high=YAW_DEG), note)
    picture_ms = 1e3 * float(np.median(clear.frame_s[clear.seen > 0]))
    note = f"{PI_TIMES:g} x {picture_ms:.1f} ms here: the robot's tag, one of the floor, and the filter"
    yield Row("see.picture", PI_TIMES * picture_ms, "ms", Bar(high=PICTURE_MS), note)
    yield from _held_rows(scale)


def _held_rows(scale: Scale) -> Iterator[Row]:
    cases = [(leg, failure) for leg in range(1, 7) for failure in ("locked", "missing")][: scale.see_walks]
    farther_m, steps_m = [], []
    for leg, failure in cases:
        true, _ = held_walk(WORLD, leg, failure, seen=False, duration_s=scale.see_walk_s)
        seen, errors = held_walk(WORLD, leg, failure, seen=True, duration_s=scale.see_walk_s)
        if true.true_deviation is None or seen.true_deviation is None:
            farther_m.append(np.nan)
            continue
        farther_m.append(abs(seen.true_deviation.signed) - abs(true.true_deviation.signed))
        steps_m.append(errors.greatest_step_m)
    note = f"{len(cases)} walks of {scale.see_walk_s:g} s, a leg locked or missing, world transfer:{WORLD}"
    yield Row("see.held", 100 * float(np.mean(farther_m)), "cm", Bar(high=HELD_CM), note)
    yield Row("see.step", 100 * max(steps_m, default=np.nan), "cm", Bar(high=2.0), "largest in 20 ms")
