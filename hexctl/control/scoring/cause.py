"""The likely cause of a walk without progress: clipped commands, saturated servos, sag, trunk or slip."""

import math
from dataclasses import dataclass

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.foot_trajectory import RAMP_DURATION_S, gait_feet_body
from hexctl.gait.gait import ideal_speed_m_s
from hexctl.ik.legs import link_points_body, solve_legs
from hexctl.ik.support_polygon import foot_heights_body, to_world
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, N_LEGS, BoolArray, FloatArray, RobotState, by_leg

#: Causes and their explanations for people.
CAUSES = {
    "clipping": "commands were clipped: joints too slow for this pace, or at the ends of their ranges",
    "saturation": "servos at their torque limit",
    "sag": "joints stay far behind their targets: soft servos under the weight, or late commands",
    "trunk": "the trunk lies on the floor: see to body.size_m and stance.up_m with hexctl check",
    "slip": "feet slide over the floor",
}

#: Bounds of the symptoms. Of 20 robots of each kind without progress (`python -m benchmarks --only check`,
#: `check.causes`), weak servos were saturated for 0.88 of the time or more, others for 0.06 at most. Tracking
#: errors: soft servos 0.76 or more, slipping robots 0.33 at most. Slip: 0.79 or more, others 0.15 at most.
#: Clipping: of joints at 13 % of the speed of a gait, 0.94 or more of the commands were clipped, and targets
#: moved by far less than the gait; at 50 % of the speed robots walked.
MOST_CLIPPED, LEAST_MOTION = 0.5, 0.75
MOST_SATURATED = 0.5
MOST_TRACKING_ERROR = 0.42
MOST_SLIP = 0.4
MOST_GROUNDED = 0.5

#: Nearer to the lowest foot, the trunk is on the floor.
TOUCH_M = 0.003

#: Below this share of the step height, a foot is meant to be on the floor.
ON_THE_FLOOR = 0.1

#: Points of a cycle at which the motion of a gait is calculated.
POINTS = 60

#: Ticks between two samples of a walk: no divisor of the usual gait cycles, to sample all phases.
SAMPLE_TICKS = 7

#: Maximum number of samples, those of the first minutes of a long walk.
MAX_SAMPLES = 2000


class WalkSamples:
    """Joints, targets and contacts of a walk every `SAMPLE_TICKS`; batch shape () for one robot."""

    def __init__(self, ticks: int, batch_shape: tuple[int, ...] = ()) -> None:
        rows = min(MAX_SAMPLES, math.ceil(ticks / SAMPLE_TICKS))
        self._measured = np.full((*batch_shape, rows, N_JOINTS), np.nan)
        self._sent = np.full((*batch_shape, rows, N_JOINTS), np.nan)
        self._contacts = np.zeros((*batch_shape, rows, N_LEGS), dtype=bool)
        self._rows, self._ticks = 0, 0
        self._complete = True

    def add(self, state: RobotState, commanded_rad: FloatArray) -> None:
        """Take the next tick: the state and the targets sent after it."""
        row, part = divmod(self._ticks, SAMPLE_TICKS)
        self._ticks += 1
        if part or row >= self._sent.shape[-2]:
            return
        self._rows = row + 1
        self._measured[..., row, :] = state.joint_positions_rad
        self._sent[..., row, :] = commanded_rad
        self._complete &= state.measured and state.foot_contacts is not None
        if state.foot_contacts is not None:
            self._contacts[..., row, :] = state.foot_contacts

    def of(self, ticks: int, index: tuple[int, ...] = ()) -> "Samples | None":
        """Samples of the first ticks of one robot; None if its joints or feet are not measured."""
        rows = min(MAX_SAMPLES, math.ceil(ticks / SAMPLE_TICKS))
        if not self._complete or rows > self._rows:
            return None
        return Samples(self._measured[index][:rows], self._sent[index][:rows], self._contacts[index][:rows])


@dataclass(frozen=True, slots=True, eq=False)
class Samples:
    """Samples of one robot: measured and sent joint angles (T, 18), and feet on the floor (T, 6)."""

    measured_rad: FloatArray
    commanded_rad: FloatArray
    contacts: BoolArray


@dataclass(frozen=True, slots=True)
class Symptoms:
    """Servo and foot symptoms of a walk after its soft start.

    Attributes:
        saturated: time share of stance legs with a femur or tibia error >= torque limit / stiffness.
        tracking_error: RMS joint error over the RMS motion of the targets.
        slip: speed of stance feet over the floor, as a share of the ideal walking speed.
        clipped: time share of commands that a limit changed.
        motion: RMS motion of the targets over that of the gait.
        grounded: time share with the trunk on the floor.
    """

    saturated: float
    tracking_error: float
    slip: float
    clipped: float = 0.0
    motion: float = 1.0
    grounded: float = 0.0

    @property
    def cause(self) -> str | None:
        """The likely cause of a walk without progress, one of `CAUSES`, or None."""
        if self.clipped > MOST_CLIPPED and self.motion < LEAST_MOTION:
            return "clipping"
        if self.saturated > MOST_SATURATED:
            return "saturation"
        if self.tracking_error > MOST_TRACKING_ERROR:
            return "sag"
        if self.grounded > MOST_GROUNDED:
            return "trunk"
        return "slip" if self.slip > MOST_SLIP else None


def symptoms(
    robot: Robot,
    plan: TrialPlan,
    samples: Samples,
    positions_world: FloatArray,
    quaternions_world: FloatArray,
    clipped: float = 0.0,
) -> Symptoms | None:
    """Symptoms of a walk on its intact legs, from base positions (ticks, 3) and orientations (ticks, 4).

    `clipped` is the time share of clipped commands.

    None if the walk ended within a second of its soft start. Unknown poses are NaN.
    """
    first = math.ceil(RAMP_DURATION_S / (SAMPLE_TICKS * PERIOD_S))
    measured, sent = samples.measured_rad[first:], samples.commanded_rad[first:]
    ideal_m_s = ideal_speed_m_s(robot, plan.gait, plan.motion(0.0))
    if len(measured) * SAMPLE_TICKS * PERIOD_S < 1.0 or ideal_m_s == 0:
        return None
    legs = [leg for leg in range(N_LEGS) if leg + 1 not in plan.failed_legs]
    up_m = foot_heights_body(robot, sent) - robot.stance_feet_body[:, 2]
    down = samples.contacts[first:] & (up_m < ON_THE_FLOOR * plan.gait.height * robot.size_m)
    poses = tuple(
        rows[::SAMPLE_TICKS][first : first + len(measured)] for rows in (positions_world, quaternions_world)
    )
    feet = to_world(link_points_body(robot, measured)[..., -1, :], *poses)
    corners = to_world(np.broadcast_to(_underside(robot), (len(measured), 4, 3)), *poses)
    heights_m = corners[..., 2].min(axis=-1) - (feet[..., 2].min(axis=-1) - robot.foot_radius_m)
    speeds_m_s = np.linalg.norm(np.diff(feet[..., :2], axis=0), axis=-1) / (SAMPLE_TICKS * PERIOD_S)
    held = np.abs(sent - measured) * robot.stiffness_nm_per_rad >= robot.joint_max_torque_nm
    saturated = np.asarray(by_leg(held)[..., 1:].any(axis=-1))
    error, motion = by_leg(sent - measured)[:, legs], by_leg(sent - sent.mean(axis=0))[:, legs]
    return Symptoms(
        saturated=_mean(saturated[:, legs], down[:, legs]),
        tracking_error=math.sqrt((error**2).mean() / max(float((motion**2).mean()), 1e-12)),
        slip=_mean(speeds_m_s[:, legs], (down[1:] & down[:-1] & np.isfinite(speeds_m_s))[:, legs])
        / ideal_m_s,
        clipped=clipped,
        motion=math.sqrt(float((motion**2).mean()) / max(_gait_motion(robot, plan, legs), 1e-12)),
        grounded=float((heights_m < TOUCH_M).mean()),
    )


def _underside(robot: Robot) -> FloatArray:
    """Lower corners of the trunk in the body frame, (4, 3)."""
    half_m = np.array(robot.body.size_m) / 2
    return half_m * [[x, y, -1] for x in (-1, 1) for y in (-1, 1)]


def _gait_motion(robot: Robot, plan: TrialPlan, legs: list[int]) -> float:
    """Mean square motion of the joints of some legs over a cycle of the plan's gait, in rad^2."""
    time_s = RAMP_DURATION_S + np.arange(POINTS) / (POINTS * plan.gait.pace_hz)
    joints = solve_legs(robot, gait_feet_body(robot, plan.gait, plan.motion(0.0), time_s)).joint_positions_rad
    return float((by_leg(joints - joints.mean(axis=0))[:, legs] ** 2).mean())


def _mean(values: FloatArray | BoolArray, where: BoolArray) -> float:
    return float(np.asarray(values, dtype=float)[where].mean()) if where.any() else 0.0
