"""A walk whose velocity may change at every tick, and whose gait may change in stride."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from hexctl.control.controllers import Controller, held_joints, joints_of_feet, soft_stop_steps
from hexctl.control.preparation import WalkStart
from hexctl.control.walks.body_poser import BodyPoser
from hexctl.control.walks.ground_contact import GroundContact
from hexctl.errors import InputError
from hexctl.gait.foot_trajectory import (
    RAMP_DURATION_S,
    StepPattern,
    feet_at_phases,
    lift_offset,
    part_of_cycle,
    ramp,
)
from hexctl.gait.gait import Gait, ideal_speed_m_s
from hexctl.types import BoolArray, FloatArray, RobotState, any_of, check_shape, chosen

#: Time constant with which the strokes follow the commanded velocity.
RESPONSE_S = 0.2

#: Minimum time to the full speed of a gait: its acceleration limit.
FULL_SPEED_S = 0.5

#: Maximum strokes as a multiple of the gait's amplitude; longer ones are scaled down, all feet alike.
OVERDRIVE = 1.2

#: Duration of a change of gait, and of one to a crawl on four legs: in 1.5 cycles one of 45 robots fell.
GLIDE_CYCLES, CRAWL_GLIDE_CYCLES = 1.5, 1.0

#: Velocity of the body in its own frame, leading shape + (3,): forward and left in m/s, turn in rad/s.
Command = Callable[[int, RobotState], FloatArray]


class VelocityWalk(Controller):
    """Walks with the velocity that a command gives at every step.

    Strokes follow smoothly, within an acceleration limit. Excessive velocities are scaled down and counted. A
    walk in a batch equals a single one to the last bit.

    Attributes:
        foot_offsets_m: added to the feet in the body frame, leading shape + (6, 3), or None.
        suited: maps the gaits of a plan's change to those to use instead.
        poser: moves the bodies over the feet; for levelling, or a commanded pose.
        haste: multiple of the pace, leading shape, to walk the same strides faster; None for 1.
    """

    def __init__(self, start: WalkStart, command: Command | None = None) -> None:
        self._robot, self._period_s, self._held = start.robot, start.period_s, held_joints(start.held_legs)
        self._shape, self._command = start.batch_shape, command
        self._turning_m = start.robot.stance_feet_body[:, 1::-1] * np.array([1.0, -1.0])  # (y, -x)
        self.gaits = [plan.gait for plan in start.plans]
        self._glide: _Glide | None = None
        together = zip(*(plan.changes for plan in start.plans), strict=True)
        self._changes = [(group[0].at_s, [change.gait for change in group]) for group in together]
        self._use(self._pattern_of(self.gaits))
        self._cycles = np.zeros(self._shape)[()]
        #: Cycles, phases, and the normalised times of the legs that follow from these.
        self._phases_of: tuple[FloatArray | None, FloatArray | None, FloatArray] = None, None, self._cycles
        self.velocity_body: FloatArray = np.zeros((*self._shape, 3))
        self.limited_steps = np.zeros(self._shape, dtype=int)[()]
        self.foot_offsets_m: FloatArray | None = None
        self.haste: FloatArray | None = None
        self.poser = BodyPoser(start.robot, start.batch_shape, OVERDRIVE, level=start.plans[0].level)
        self.suited: Callable[[list[Gait]], list[Gait]] = list
        adaptive = start.plans[0].feet == "adaptive"
        self._ground = GroundContact(start.robot, start.batch_shape) if adaptive else None
        self._last_step = 0
        self._stop_step: int | None = None

    def desired(self, dt_s: float, step: int, state: RobotState) -> FloatArray:
        """Velocity asked for at a step, `dt_s` after the one before, leading shape + (3,)."""
        if self._command is None:
            return self.velocity_body
        velocity = np.asarray(self._command(step, state), dtype=float)
        check_shape(velocity, self.velocity_body.shape, "command: velocity")
        return velocity

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint angles at this step, leading shape + (18,)."""
        dt_s = (step - self._last_step) * self._period_s
        self._last_step = step
        if dt_s > 0:
            self._follow(dt_s, self.desired(dt_s, step, state))
        elif self._command is not None and not self._last_step:
            self.velocity_body = self.desired(dt_s, step, state)  # the ramp makes the start soft
        strokes, pace_hz = self._strokes(), self._pattern.pace_hz[()]
        if dt_s > 0:
            self.poser.update(dt_s, state, self._pattern)
            cycles = dt_s * (pace_hz if self.haste is None else pace_hz * self.haste)
            self._cycles = self._cycles + cycles
            self._change(step, cycles)
        u = self.leg_phases
        envelope, pattern = self._envelope(step), self.poser.lowered(self._pattern)
        feet = feet_at_phases(self._robot, pattern, u, strokes, envelope)
        if self.foot_offsets_m is not None:
            feet = feet + self.foot_offsets_m
        feet = self.poser.feet(feet)
        self._meet_ground(dt_s, u, feet, envelope, state)
        return joints_of_feet(self._robot, feet, self._held)

    def _meet_ground(
        self, dt_s: float, u: FloatArray, feet: FloatArray, lifted: float, state: RobotState
    ) -> None:
        """Move feet, in place, to the ground that they meet; `lifted` is the share of the step height."""
        if self._ground is not None:
            pattern = self.poser.lowered(self._pattern)
            lift_m = lifted * lift_offset(u, pattern.swing) * pattern.height_m
            lift_m = lift_m * pattern.stepping
            top_m = lifted * pattern.height_m
            feet[..., 2] += self._ground.update(dt_s, feet, lift_m, top_m, state, pattern.stepping)

    def _envelope(self, step: int) -> float:
        """Share of strokes and heights at a step: 1 except in the soft start and stop."""
        if self._stop_step is None and step * self._period_s >= RAMP_DURATION_S:
            return 1.0
        stop_s = None if self._stop_step is None else self._stop_step * self._period_s
        return float(ramp(step * self._period_s, stop_s))

    def glide_to(self, gaits: Gait | Sequence[Gait], which: BoolArray | None = None) -> None:
        """Change the gaits of walks in stride: phases, heights and posture glide; which None is all."""
        gaits = [gaits] if isinstance(gaits, Gait) else list(gaits)
        if len(gaits) != len(self.gaits):
            raise InputError(f"gaits: got {len(gaits)}; allowed: {len(self.gaits)}, one for each walk")
        begins = np.ones(self._shape, dtype=bool)[()] if which is None else which
        self.gaits = [
            new if begun else old
            for new, old, begun in zip(gaits, self.gaits, np.atleast_1d(begins).tolist(), strict=True)
        ]
        now = self.leave_plain()
        pattern = self._pattern_of(self.gaits, plain=False)
        shifted = now.phases + nearest_phases(now.phases, pattern.phases, pattern.stepping)
        ones: FloatArray = np.ones(self._shape)[()]
        going = _Glide(now, now, ones, ones) if self._glide is None else self._glide
        self._glide = _Glide(
            _mixed(begins, now, going.before),
            _mixed(begins, replace(pattern, phases=shifted), going.later),
            chosen(begins, 0.0, going.share),
            chosen(begins, self._each([glide_cycles(gait) for gait in self.gaits]), going.cycles),
        )

    def leave_plain(self) -> StepPattern:
        """Continue with an equivalent pattern with a swing share, and return it; feet differ by rounding."""
        if (plain := self._pattern).swing_share is None:
            self._use(replace(self._pattern_of(self.gaits, plain=False), phases=plain.phases))
        return self._pattern

    @property
    def leg_phases(self) -> FloatArray:  # type: ignore[override]  # from the last step
        """Normalised time of each leg in the last step, leading shape + (6,)."""
        cycles, phases = self._cycles, self._pattern.phases
        if self._phases_of[0] is not cycles or self._phases_of[1] is not phases:
            self._phases_of = cycles, phases, part_of_cycle(cycles[..., np.newaxis] + phases)
        return self._phases_of[2]

    def stop(self, step: int) -> int:
        """Begin the soft stop at a step; it takes `soft_stop_steps`."""
        if self._stop_step is None:
            self._stop_step = step
        return soft_stop_steps(self._period_s)

    def done(self, step: int, state: RobotState) -> bool:
        """Whether a soft stop has ended."""
        return self._stop_step is not None and step >= self._stop_step + soft_stop_steps(self._period_s) - 1

    def _each(self, values: Sequence[ArrayLike]) -> FloatArray:
        return np.asarray(np.array(values, dtype=float)[slice(None) if self._shape else 0])

    def _pattern_of(self, gaits: Sequence[Gait], *, plain: bool = True) -> StepPattern:
        return StepPattern.of(self._robot, gaits if self._shape else gaits[0], plain=plain)

    def _use(self, pattern: StepPattern) -> None:
        self._pattern = pattern
        self._per_second = 1 / (pattern.strokes_per_cycle * pattern.pace_hz)
        self._most_stroke_m2 = (OVERDRIVE * pattern.amplitude_m) ** 2
        full_m_s = pattern.amplitude_m / self._per_second
        self._most_change = full_m_s / FULL_SPEED_S

    def _follow(self, dt_s: float, desired: FloatArray) -> None:
        change = (1 - math.exp(-dt_s / RESPONSE_S)) * (desired - self.velocity_body)
        # A turn moves the feet at the radius of the stance.
        forward, left, turn = (change[..., axis][()] for axis in range(3))
        turn = turn * self._robot.stance_radius_m
        size = np.sqrt(forward * forward + left * left + turn * turn)
        most = self._most_change * dt_s
        if any_of(size > most):
            change = change * np.minimum(1.0, most / np.maximum(size, most))[..., np.newaxis]
        self.velocity_body = self.velocity_body + change

    def _strokes(self) -> FloatArray:
        """Current strokes of the feet, leading shape + (6, 2) in m, scaled to what the gait allows."""
        # A stance foot moves against the body, (-v_x + omega y, -v_y - omega x), for 1 / (strokes f).
        way = self._per_second[..., np.newaxis] * self.velocity_body
        strokes = way[..., 2, np.newaxis, np.newaxis] * self._turning_m - way[..., np.newaxis, :2]
        squares = strokes * strokes
        longest = np.maximum.reduce(squares[..., 0] + squares[..., 1], axis=-1)
        most_m2 = self._most_stroke_m2 * self.poser.stroke_share**2
        too_long: BoolArray = longest > most_m2
        if any_of(too_long):
            self.limited_steps = self.limited_steps + too_long
            scale = np.sqrt(most_m2 / np.maximum(longest, most_m2))
            strokes = strokes * scale[..., np.newaxis, np.newaxis]
            self.velocity_body = self.velocity_body * np.where(too_long, scale, 1.0)[..., np.newaxis]
        return np.asarray(strokes)

    def _change(self, step: int, cycles: FloatArray) -> None:
        if self._changes and step * self._period_s >= self._changes[0][0]:
            self.glide_to(self.suited(self._changes.pop(0)[1]))
        if self._glide is not None:
            self._glide = self._glide.after(cycles)
            self._use(self._glide.pattern)
            if (self._glide.share >= 1).all():
                self._glide = None


class MotionWalk(VelocityWalk):
    """Walks the motions of its plans at the ideal speed of its gaits, open loop."""

    def __init__(self, start: WalkStart) -> None:
        super().__init__(start)
        self._motions = start.motions
        self._desired = self.velocity_body = self._velocity_of(self.gaits)

    def desired(self, dt_s: float, step: int, state: RobotState) -> FloatArray:
        """Velocity of the motions, leading shape + (3,)."""
        return self._desired

    def glide_to(self, gaits: Gait | Sequence[Gait], which: BoolArray | None = None) -> None:
        """Change to other gaits in stride, and to their speeds."""
        super().glide_to(gaits, which)
        self._desired = self._velocity_of(self.gaits)

    def _velocity_of(self, gaits: Sequence[Gait]) -> FloatArray:
        rows = []
        for gait, motion in zip(gaits, self._motions, strict=True):
            speed_m_s = ideal_speed_m_s(self._robot, gait, motion)
            way = (math.cos(motion.heading_rad), math.sin(motion.heading_rad))
            rows.append([speed_m_s * way[0], speed_m_s * way[1], motion.turn_rate_rad_s])
        return self._each(rows)


def glide_cycles(gait: Gait) -> float:
    """Duration of a change to a gait, in cycles."""
    return CRAWL_GLIDE_CYCLES if len(gait.posture.tucked_legs) > 1 else GLIDE_CYCLES


@dataclass(frozen=True, slots=True, eq=False)
class _Glide:
    """A change of gait between two patterns, by a share of 0 to 1, over some cycles, leading shapes."""

    before: StepPattern
    later: StepPattern
    share: FloatArray
    cycles: FloatArray

    def after(self, cycles: FloatArray) -> "_Glide":
        return replace(self, share=np.minimum(1.0, self.share + cycles / self.cycles))

    @property
    def pattern(self) -> StepPattern:
        def between(before: FloatArray, later: FloatArray) -> FloatArray:
            share = _spread(self.share, later)
            return np.where(share < 1, before + share * (later - before), later)

        return self.before.combined(self.later, between)


def _spread(values: FloatArray | BoolArray, over: FloatArray) -> FloatArray:
    """Values of leading shape, reshaped to broadcast against `over`."""
    return np.asarray(np.reshape(values, np.shape(values) + (1,) * (np.ndim(over) - np.ndim(values))))


def _mixed(condition: BoolArray, yes: StepPattern, no: StepPattern) -> StepPattern:
    """Pattern `yes` of walks that meet a condition of leading shape, and `no` of the others."""
    return yes.combined(no, lambda one, two: np.asarray(np.where(_spread(condition, one), one, two)))


def nearest_phases(before: FloatArray, later: FloatArray, stepping: FloatArray | None = None) -> FloatArray:
    """Change of each leg's phase, (..., 6) in cycles of -1/2 to 1/2, between gaits that may be shifted.

    A shifted gait is the same gait: of six shifts, each with one leg constant, the one with the smallest sum
    of squares of the stepping legs.
    """
    changes = later - before
    shifted = changes[..., np.newaxis, :] - changes[..., :, np.newaxis]  # (..., leg that stays, 6)
    shifted = shifted - np.rint(shifted)
    squares = shifted * shifted
    if stepping is not None:
        squares = squares * stepping[..., np.newaxis, :]
    best = np.argmin(squares.sum(axis=-1), axis=-1)
    return np.asarray(np.take_along_axis(shifted, best[..., np.newaxis, np.newaxis], axis=-2)[..., 0, :])
