"""The foot trajectory of the paper (Eq. 3 to 5), normalised to amplitude 1 and height 1.

Stance is the two thirds of the cycle in which the offset grows, swing the third (u in [1/3, 2/3)) in which
the foot returns through the air.
"""

import numpy as np
from numpy.typing import ArrayLike

from hexctl.gait.gait import Gait, Motion, turn_amplitude_m
from hexctl.robot.model import Robot
from hexctl.types import BoolArray, FloatArray

SWING_START, SWING_TOP, SWING_END = 1 / 3, 1 / 2, 2 / 3


def phase_in_cycle(cycles: ArrayLike, slots: ArrayLike) -> FloatArray:
    """Return the normalised time u in [0, 1) of each leg (Eq. 5): u = mod(t + (g - 1) / 6, 1).

    Args:
        cycles: t, gait cycles since the start; broadcasts against the slots.
        slots: g, the phase slot of each leg, 1..6.
    """
    u = np.mod(np.asarray(cycles) + (np.asarray(slots) - 1) / 6, 1.0)
    # mod of a tiny negative rounds to 1.0 itself, which is the start of the cycle.
    return np.where(u == 1.0, 0.0, u)


def stroke_offset(u: FloatArray) -> FloatArray:
    """Return the offset in the plane as a fraction of the amplitude (Eq. 3), in [-1/2, 1/2]."""
    return np.where(
        u < SWING_START,
        1.5 * u,
        np.where(u < SWING_END, 1.5 - 3.0 * u, -0.5 + 1.5 * (u - SWING_END)),
    )


def lift_offset(u: FloatArray) -> FloatArray:
    """Return the height offset as a fraction of the step height (Eq. 4), in [0, 1]."""
    return np.clip(1.0 - 6.0 * np.abs(u - SWING_TOP), 0.0, None)


def in_stance(u: FloatArray) -> BoolArray:
    """Return where the foot is meant to be on the floor."""
    return (u < SWING_START) | (u >= SWING_END)


#: Share of the full amplitude gained or lost per second (the paper's demo model).
RAMP_RATE_PER_S = 0.5

#: Time from standing to the full amplitude, or back.
RAMP_DURATION_S = 1 / RAMP_RATE_PER_S


def ramp(time_s: ArrayLike, stop_s: float | None = None) -> FloatArray:
    """Return the envelope in [0, 1] at times since the start of a walk.

    Args:
        time_s: any shape; before the start (negative) the envelope is 0.
        stop_s: when the stop began, or None while walking on.
    """
    rising = np.asarray(time_s) * RAMP_RATE_PER_S
    if stop_s is None:
        return np.clip(rising, 0.0, 1.0)
    falling = min(1.0, stop_s * RAMP_RATE_PER_S) - (np.asarray(time_s) - stop_s) * RAMP_RATE_PER_S
    return np.clip(np.minimum(rising, falling), 0.0, 1.0)


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
