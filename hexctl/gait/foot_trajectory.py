"""The foot trajectory of a walk (paper, Eq. 1 to 5), for all legs, times and walks in one call.

Foot i is at its stance position plus an offset (Eq. 1, 2), with m_i along the direction of travel and h_i up:

    p_i = p_i^o + (m_i(u) cos theta, m_i(u) sin theta, h_i(u))

u is the foot's own normalised time (Eq. 5), and u in [1/3, 2/3) the swing. A ramp scales m and h at the start
and the stop of a walk.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields

import numpy as np
from numpy.typing import ArrayLike

from hexctl.gait.gait import STROKES_PER_CYCLE, SWING_SHARE, Gait, Motion, turn_amplitude_m
from hexctl.gait.posture import Posture
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, BoolArray, FloatArray

SWING_START, SWING_TOP, SWING_END = 1 / 3, 1 / 2, 2 / 3

# Constants of the curves. NumPy computes faster with arrays than with numbers, to the same bits.
_SLOPE, _SWING_SLOPE, _LIFT_SLOPE = np.array(1.5), np.array(3.0), np.array(6.0)
_BACK, _ZERO, _HALF, _ONE = np.array(-0.5), np.array(0.0), np.array(0.5), np.array(1.0)
_TOP, _END = np.array(SWING_TOP), np.array(SWING_END)


def part_of_cycle(cycles: FloatArray) -> FloatArray:
    """Fractional part of times in cycles, u in [0, 1): of a leg, of t + (g_i - 1) / 6 (paper, Eq. 5)."""
    # mod of a tiny negative rounds to 1.0, which is the start of the cycle: hence the second one.
    part: FloatArray = np.mod(np.mod(cycles, _ONE), _ONE)
    return part


@dataclass(frozen=True, slots=True, eq=False)
class Swing(ArrayFields):
    """Swings of a share s of the cycle, from (1 - s) / 2 to (1 + s) / 2, with slopes 2 / s of the lift."""

    share: FloatArray
    standing: FloatArray
    begins: FloatArray
    ends: FloatArray
    slope: FloatArray

    @classmethod
    def of(cls, share: FloatArray) -> "Swing":
        """Swings of shares in a shape that broadcasts against u."""
        standing = 1 - share
        return cls(share, standing, standing / 2, (1 + share) / 2, 2.0 / share)


def stroke_offset(u: FloatArray, swing: Swing | None = None) -> FloatArray:
    """Offset in the plane as a fraction of the amplitude, m / A in [-1/2, 1/2] (paper, Eq. 3).

    3u/2 in [0, 1/3), 1/2 - 3 (u - 1/3) in [1/3, 2/3), -1/2 (1 - 3 (u - 2/3)) in [2/3, 1). A swing share s
    other than a third has the slopes 1 / (1 - s) and -1 / s.
    """
    if swing is not None:
        piecewise = np.asarray(_BACK + (u - swing.ends) / swing.standing)
        np.copyto(piecewise, _HALF - (u - swing.begins) / swing.share, where=u < swing.ends)
        np.copyto(piecewise, u / swing.standing, where=u < swing.begins)  # faster than `np.where`
        return piecewise
    # Before the swing its piece is above the first one, after it below the last one: faster than `np.where`.
    swinging = np.maximum(_SLOPE - _SWING_SLOPE * u, _BACK + _SLOPE * (u - _END))
    offset: FloatArray = np.minimum(_SLOPE * u, swinging)
    return offset


def lift_offset(u: FloatArray, swing: Swing | None = None) -> FloatArray:
    """Height as a fraction of the step height, h / H in [0, 1] (paper, Eq. 4).

    6 (u - 1/3) in [1/3, 1/2), 1 - 6 (u - 1/2) in [1/2, 2/3), and 0 in the stance; with a swing share s the
    slopes are 2 / s.
    """
    slope = _LIFT_SLOPE if swing is None else swing.slope
    height: FloatArray = np.maximum(_ONE - slope * np.abs(u - _TOP), _ZERO)
    return height


def in_stance(u: FloatArray, swing: Swing | None = None) -> BoolArray:
    """Whether the trajectory has the foot on the floor, in the shape of u."""
    if swing is not None:
        return (u < swing.begins) | (u >= swing.ends)
    return (u < SWING_START) | (u >= SWING_END)


#: Share of the full amplitude gained or lost per second (the paper's demo model).
RAMP_RATE_PER_S = 0.5

#: Time from standing to the full amplitude, or back.
RAMP_DURATION_S = 1 / RAMP_RATE_PER_S


def ramp(time_s: ArrayLike, stop_s: float | None = None) -> FloatArray:
    """Factor of amplitude and height, in [0, 1], at times since the start of a walk: soft start and stop."""
    rising = np.asarray(time_s) * RAMP_RATE_PER_S
    if stop_s is None:
        return np.minimum(np.maximum(rising, 0.0), 1.0)
    falling = min(1.0, stop_s * RAMP_RATE_PER_S) - (np.asarray(time_s) - stop_s) * RAMP_RATE_PER_S
    return np.minimum(np.maximum(np.minimum(rising, falling), 0.0), 1.0)


def stroke_vectors_m(robot: Robot, gait: Gait, motion: Motion) -> FloatArray:
    """Strokes of the feet in the stance, as vectors in the body frame, (6, 2) in m.

    In Eq. 2 as printed a stance foot moves toward +theta; in hexctl the body does, and the foot moves against
    it. A turn at rate omega adds a stroke at right angles to the foot's position (x, y):

        stroke = -A (cos theta, sin theta) + omega / ((3/2) f) (y, -x)
    """
    travel = gait.amplitude * robot.size_m * motion.travel
    turn = turn_amplitude_m(robot, gait, motion.turn_rate_rad_s) / robot.stance_radius_m
    x, y = robot.stance_feet_body[:, 0], robot.stance_feet_body[:, 1]
    return np.stack(
        [turn * y - travel * np.cos(motion.heading_rad), -turn * x - travel * np.sin(motion.heading_rad)],
        axis=-1,
    )


#: Height of a tucked foot above its place in the stance, as a fraction of the robot's size.
TUCK_HEIGHT = 0.04


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class StepPattern(ArrayFields):
    """Gaits as arrays, for one walk or n computed together: the leading shape is () or (n,).

    Attributes:
        phases: lead of each leg in cycles, `Gait.leg_phases`, leading shape + (6,).
        pace_hz: leading shape.
        amplitude_m: leading shape.
        height_m: step heights, leading shape + (1,).
        posture_m: of the feet relative to the stance, leading shape + (6, 3).
        stepping: 1 for legs that step and 0 for tucked ones, leading shape + (6,).
        swing_share: leading shape + (1,); None if all are a third.
        swing: of the legs, in the shape of the phases; None if all are a third.
        changes_stance: whether posture or stepping change a foot.
    """

    phases: FloatArray
    pace_hz: FloatArray
    amplitude_m: FloatArray
    height_m: FloatArray
    posture_m: FloatArray
    stepping: FloatArray
    swing_share: FloatArray | None = None
    swing: Swing | None = field(init=False, compare=False, default=None)
    changes_stance: bool = field(init=False, compare=False, default=False)

    def __post_init__(self) -> None:
        if self.swing_share is not None:
            shares = np.broadcast_to(self.swing_share, np.shape(self.phases)).copy()
            object.__setattr__(self, "swing", Swing.of(shares))
        changes = bool(self.posture_m.any() or (self.stepping != 1).any())
        object.__setattr__(self, "changes_stance", changes)

    @classmethod
    def of(cls, robot: Robot, gaits: Gait | Sequence[Gait], *, plain: bool = True) -> "StepPattern":
        """Pattern of a gait, or of n gaits; with `plain` False the swing share is never None."""
        each, pick = ([gaits], 0) if isinstance(gaits, Gait) else (list(gaits), slice(None))

        def stacked(values: Sequence[ArrayLike]) -> FloatArray:
            return np.asarray(np.array(values, dtype=float)[pick])

        postures = [gait.posture for gait in each]
        third = plain and all(gait.swing_share == SWING_SHARE for gait in each)
        return cls(
            phases=stacked([gait.leg_phases for gait in each]),
            pace_hz=stacked([gait.pace_hz for gait in each]),
            amplitude_m=stacked([gait.amplitude * robot.size_m for gait in each]),
            height_m=stacked([[gait.height * robot.size_m] for gait in each]),
            posture_m=stacked([posture_offsets_m(robot, one) for one in postures]),
            stepping=stacked(
                [[float(leg not in one.tucked_legs) for leg in range(1, N_LEGS + 1)] for one in postures]
            ),
            swing_share=None if third else stacked([[gait.swing_share] for gait in each]),
        )

    def combined(self, other: "StepPattern", combine: Callable[..., FloatArray]) -> "StepPattern":
        """Pattern whose fields a function makes of those of two patterns; those that are None stay."""
        names = [each.name for each in fields(self) if each.init and getattr(self, each.name) is not None]
        return StepPattern(**{name: combine(getattr(self, name), getattr(other, name)) for name in names})

    @property
    def strokes_per_cycle(self) -> FloatArray:
        """Amplitudes per cycle at the speed of the stance, leading shape."""
        if self.swing_share is None:
            return np.full(np.shape(self.pace_hz), STROKES_PER_CYCLE)[()]
        return np.asarray(1 / (1 - self.swing_share[..., 0]))


def posture_offsets_m(robot: Robot, posture: Posture) -> FloatArray:
    """Offsets of the feet of a posture from the stance, in the body frame, (6, 3) in m."""
    offsets = np.zeros((N_LEGS, 3))
    offsets[:, :2] -= np.array(posture.shift) * robot.size_m
    offsets[:, 2] -= posture.body_raise * robot.size_m
    tucked = [leg - 1 for leg in posture.tucked_legs]
    offsets[tucked] = 0.0, 0.0, TUCK_HEIGHT * robot.size_m
    return offsets


def feet_at_phases(
    robot: Robot, pattern: StepPattern, u: FloatArray, strokes: FloatArray, envelope: FloatArray | float
) -> FloatArray:
    """Foot positions at normalised times u (..., 6), shape of u + (3,) in m; the rest broadcasts against u.

    `strokes` are in the body frame, + (2,) in m; `envelope`, 0 to 1, scales strokes, heights and posture.
    """
    stroke, lift = stroke_offset(u, pattern.swing), lift_offset(u, pattern.swing)
    if pattern.changes_stance:
        stroke, lift = stroke * pattern.stepping, lift * pattern.stepping
    if not (isinstance(envelope, float) and envelope == 1.0):
        stroke, lift = envelope * stroke, envelope * lift
    feet = np.empty((*u.shape, 3))
    np.multiply(stroke[..., np.newaxis], strokes, out=feet[..., :2])
    np.multiply(lift, pattern.height_m, out=feet[..., 2])
    if pattern.changes_stance:
        feet += np.asarray(envelope)[..., np.newaxis] * pattern.posture_m
    feet += robot.stance_feet_body
    return feet


def gait_feet_body(
    robot: Robot, gait: Gait, motion: Motion, time_s: ArrayLike, stop_s: float | None = None
) -> FloatArray:
    """Foot positions at times since the start of a walk (paper, Eq. 1), time shape + (6, 3) in m."""
    return feet_of_walks(
        robot,
        StepPattern.of(robot, gait),
        stroke_vectors=stroke_vectors_m(robot, gait, motion),
        time_s=np.asarray(time_s, dtype=float),
        stop_s=stop_s,
    )


def feet_of_walks(
    robot: Robot,
    pattern: StepPattern,
    *,
    stroke_vectors: FloatArray,
    time_s: FloatArray,
    stop_s: float | None = None,
) -> FloatArray:
    """Foot positions of walks at the same times, walks shape + time shape + (6, 3) in m.

    Strokes are walks shape + (6, 2) in m in the stance and the body frame.
    """
    walks = np.shape(pattern.pace_hz)
    times = (1,) * len(walks) + time_s.shape + (1,)

    def per_walk(values: FloatArray) -> FloatArray:
        return values.reshape(walks + (1,) * time_s.ndim + values.shape[len(walks) :])

    if walks:  # what belongs to a single walk broadcasts as it is
        pattern = pattern.combined(pattern, lambda values, _: per_walk(values))
        stroke_vectors = per_walk(stroke_vectors)
    u = part_of_cycle(pattern.pace_hz[..., np.newaxis] * time_s.reshape(times) + pattern.phases)
    return feet_at_phases(robot, pattern, u, stroke_vectors, ramp(time_s, stop_s).reshape(times))
