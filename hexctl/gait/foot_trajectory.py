"""The foot trajectory of a walk (paper, Eq. 1 to 5), for all legs, times and walks in one call.

Foot i is at its stance position plus an offset (Eq. 1, 2), with m_i along the direction of travel and h_i up:

    p_i = p_i^o + (m_i(u) cos theta, m_i(u) sin theta, h_i(u))

u is the foot's own normalised time (Eq. 5). In the swing, u in [1/3, 2/3), the foot moves through the air
against its direction in the stance. At the start and the stop of a walk, m and h are scaled by a ramp.
"""

import numpy as np
from numpy.typing import ArrayLike

from hexctl.gait.gait import STROKES_PER_CYCLE, Gait, Motion, turn_amplitude_m
from hexctl.robot.model import Robot
from hexctl.types import BoolArray, FloatArray

SWING_START, SWING_TOP, SWING_END = 1 / 3, 1 / 2, 2 / 3


def phase_in_cycle(cycles: ArrayLike, slots: ArrayLike) -> FloatArray:
    """Normalised time of each leg in [0, 1), u = mod(t + (g_i - 1) / 6, 1) (paper, Eq. 5).

    Args:
        cycles: t, gait cycles since the start; broadcasts against the slots.
        slots: g_i, the phase slot of each leg, 1..6.
    """
    u = np.mod(np.asarray(cycles) + (np.asarray(slots) - 1) / 6, 1.0)
    # mod of a tiny negative rounds to 1.0 itself, which is the start of the cycle.
    return np.where(u == 1.0, 0.0, u)


def stroke_offset(u: FloatArray) -> FloatArray:
    """Offset in the plane as a fraction of the amplitude, m / A in [-1/2, 1/2] (paper, Eq. 3).

    3u/2 in [0, 1/3), 1/2 - 3 (u - 1/3) in [1/3, 2/3), -1/2 (1 - 3 (u - 2/3)) in [2/3, 1).
    """
    return np.where(
        u < SWING_START,
        1.5 * u,
        np.where(u < SWING_END, 1.5 - 3.0 * u, -0.5 + 1.5 * (u - SWING_END)),
    )


def lift_offset(u: FloatArray) -> FloatArray:
    """Height as a fraction of the step height, h / H in [0, 1] (paper, Eq. 4).

    6 (u - 1/3) in [1/3, 1/2), 1 - 6 (u - 1/2) in [1/2, 2/3), and 0 in the stance.
    """
    return np.maximum(1.0 - 6.0 * np.abs(u - SWING_TOP), 0.0)


def in_stance(u: FloatArray) -> BoolArray:
    """Whether the trajectory has the foot on the floor, in the shape of u."""
    return (u < SWING_START) | (u >= SWING_END)


#: Share of the full amplitude gained or lost per second (the paper's demo model).
RAMP_RATE_PER_S = 0.5

#: Time from standing to the full amplitude, or back.
RAMP_DURATION_S = 1 / RAMP_RATE_PER_S


def ramp(time_s: ArrayLike, stop_s: float | None = None) -> FloatArray:
    """Factor of amplitude and height, in [0, 1], at times since the start of a walk: soft start and stop.

    Args:
        time_s: any shape; before the start (negative) the factor is 0.
        stop_s: when the stop began, or None while walking on.
    """
    rising = np.asarray(time_s) * RAMP_RATE_PER_S
    if stop_s is None:
        return np.minimum(np.maximum(rising, 0.0), 1.0)
    falling = min(1.0, stop_s * RAMP_RATE_PER_S) - (np.asarray(time_s) - stop_s) * RAMP_RATE_PER_S
    return np.minimum(np.maximum(np.minimum(rising, falling), 0.0), 1.0)


def stroke_vectors_m(robot: Robot, gait: Gait, motion: Motion) -> FloatArray:
    """Strokes of the feet in the stance, as vectors in the body frame, (6, 2) in m.

    In Eq. 2 as printed a foot on the floor moves toward +theta, and the body toward -theta. In hexctl theta
    is where the body goes, so the foot moves against it. A turn at rate omega adds a stroke at right angles
    to the foot's position (x, y), in proportion to its distance from the vertical axis:

        stroke = -A (cos theta, sin theta) + omega / ((3/2) f) (y, -x)
    """
    travel = gait.amplitude * robot.size_m * motion.travel
    turn = turn_amplitude_m(robot, gait, motion.turn_rate_rad_s) / robot.stance_radius_m
    x, y = robot.stance_feet_body[:, 0], robot.stance_feet_body[:, 1]
    return np.stack(
        [turn * y - travel * np.cos(motion.heading_rad), -turn * x - travel * np.sin(motion.heading_rad)],
        axis=-1,
    )


def strokes_per_velocity(robot: Robot, pace_hz: ArrayLike) -> FloatArray:
    """Strokes of the feet per velocity of the body without slip, leading shape + (6, 2, 3).

    The last axis is for v_x and v_y in m/s and omega in rad/s, all in the body frame. A foot on the floor
    covers (3/2) f strokes in a second (Eq. 3), and moves against the body:

        stroke = (-v_x + omega y, -v_y - omega x) / ((3/2) f)

    Args:
        robot: its stance gives the positions (x, y) of the feet.
        pace_hz: f, leading shape.
    """
    per_velocity = np.zeros((*robot.stance_feet_body[:, :2].shape, 3))
    per_velocity[:, 0, 0] = per_velocity[:, 1, 1] = -1.0
    per_velocity[:, 0, 2] = robot.stance_feet_body[:, 1]
    per_velocity[:, 1, 2] = -robot.stance_feet_body[:, 0]
    return np.asarray(per_velocity / (STROKES_PER_CYCLE * np.asarray(pace_hz)[..., None, None, None]))


def feet_at_phases(
    robot: Robot, u: FloatArray, strokes: FloatArray, height_m: FloatArray, envelope: float
) -> FloatArray:
    """Foot positions of walks at one moment, leading shape + (6, 3) in m.

    Args:
        robot: its stance gives the initial positions p_i^o.
        u: normalised time of each foot, leading shape + (6,).
        strokes: in the body frame, leading shape + (6, 2) in m.
        height_m: step heights, broadcast against u.
        envelope: factor of strokes and heights, 0 to 1.
    """
    feet = np.empty((*u.shape, 3))
    feet[..., :2] = (envelope * stroke_offset(u))[..., np.newaxis] * strokes
    feet[..., 2] = envelope * lift_offset(u) * height_m
    feet += robot.stance_feet_body
    return feet


def gait_feet_body(
    robot: Robot, gait: Gait, motion: Motion, time_s: ArrayLike, stop_s: float | None = None
) -> FloatArray:
    """Foot positions at times since the start of a walk (paper, Eq. 1), time shape + (6, 3) in m.

    Args:
        robot: its stance gives the initial positions p_i^o.
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
    """Foot positions of several walks at the same times, walks shape + time shape + (6, 3) in m.

    Args:
        robot: its stance gives the initial positions p_i^o.
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
        return np.asarray(values).reshape(walks + (1,) * time_s.ndim + tail)

    cycles = per_walk(pace_hz, (1,)) * time_s.reshape(times)
    u = phase_in_cycle(cycles, per_walk(slots, (6,)))
    envelope = ramp(time_s, stop_s).reshape(times)
    stroke = (envelope * stroke_offset(u))[..., np.newaxis]
    lift = envelope * lift_offset(u) * per_walk(height_m, (1,))
    offsets = np.concatenate([stroke * per_walk(stroke_vectors, (6, 2)), lift[..., np.newaxis]], axis=-1)
    feet: FloatArray = robot.stance_feet_body + offsets
    return feet
