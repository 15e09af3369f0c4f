"""The feet of a walking robot over time: paper Eq. 1 to 5 for all legs, times and trials at once."""

import numpy as np
from numpy.typing import ArrayLike

from hexctl.gait.gait import Gait, Motion, turn_amplitude_m
from hexctl.gait.ramp import ramp
from hexctl.gait.trajectory import lift_offset, phase_in_cycle, stroke_offset
from hexctl.robot.model import Robot
from hexctl.types import FloatArray


def stroke_vectors_m(robot: Robot, gait: Gait, motion: Motion) -> FloatArray:
    """Return the direction and length of each foot's stance stroke in the body frame, (6, 2).

    As printed, Eq. 2 moves a stance foot toward +theta, so the body toward -theta; here the heading is
    where the body goes, so the foot moves against it. A turn moves each foot tangentially about the body's
    vertical axis, against the turn, in proportion to its distance from that axis.
    """
    travel = gait.amplitude * robot.size_m * motion.travel
    turn = turn_amplitude_m(robot, gait, motion.turn_rate_rad_s) / robot.stance_radius_m
    x, y = robot.stance_feet_body[:, 0], robot.stance_feet_body[:, 1]
    return np.stack(
        [turn * y - travel * np.cos(motion.heading_rad), -turn * x - travel * np.sin(motion.heading_rad)],
        axis=-1,
    )


def gait_feet_body(
    robot: Robot, gait: Gait, motion: Motion, time_s: ArrayLike, stop_s: float | None = None
) -> FloatArray:
    """Return the feet at times since the start of the walk (Eq. 1), time shape + (6, 3) in m.

    Args:
        robot: whose stance is the rest position of the feet.
        gait: slots, pace, amplitude and height.
        motion: travel and turn, in the body frame.
        time_s: seconds since the walk began, any shape.
        stop_s: when a soft stop began, or None while walking on.
    """
    return feet_of_walks(
        robot,
        slots=np.array(gait.slots),
        stroke_vectors=stroke_vectors_m(robot, gait, motion),
        pace_hz=gait.pace_hz,
        height_m=gait.height * robot.size_m,
        time_s=np.asarray(time_s, dtype=float),
        stop_s=stop_s,
    )


def feet_of_walks(
    robot: Robot,
    *,
    slots: ArrayLike,
    stroke_vectors: FloatArray,
    pace_hz: ArrayLike,
    height_m: ArrayLike,
    time_s: FloatArray,
    stop_s: float | None = None,
) -> FloatArray:
    """Return the feet of many walks at the same times, walks shape + time shape + (6, 3) in m.

    Args:
        robot: whose stance is the rest position of the feet.
        slots: walks shape + (6,).
        stroke_vectors: stance strokes in the body frame, walks shape + (6, 2) in m.
        pace_hz: walks shape.
        height_m: step heights, walks shape.
        time_s: seconds since the walks began, any shape.
        stop_s: when a soft stop began, or None while walking on.
    """
    walks = np.shape(pace_hz)
    times = (1,) * len(walks) + time_s.shape + (1,)

    def per_walk(values: ArrayLike, tail: tuple[int, ...]) -> FloatArray:
        return np.reshape(values, walks + (1,) * time_s.ndim + tail)

    cycles = per_walk(pace_hz, (1,)) * time_s.reshape(times)
    u = phase_in_cycle(cycles, per_walk(slots, (6,)))
    envelope = ramp(time_s, stop_s).reshape(times)
    stroke = (envelope * stroke_offset(u))[..., np.newaxis]
    lift = envelope * lift_offset(u) * per_walk(height_m, (1,))
    offsets = np.concatenate([stroke * per_walk(stroke_vectors, (6, 2)), lift[..., np.newaxis]], axis=-1)
    feet: FloatArray = robot.stance_feet_body + offsets
    return feet
