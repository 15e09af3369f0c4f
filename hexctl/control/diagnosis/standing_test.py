"""The standing test: small motions of each leg and of the body, and stands on three legs.

A lift raises one leg by its femur joint, while the coxa swings by a sine and the tibia by one bump: the
targets of its joints are independent. A sway moves the body over six feet on a circle, and dips. A tripod
stands on every other leg, and is left out if one of them is known to be dead or missing.
"""

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from hexctl.control.controllers import Controller
from hexctl.errors import LimitError, ReachError
from hexctl.ik.legs import range_excess_rad, solve_legs_within_limits
from hexctl.robot.model import Robot
from hexctl.types import JOINTS_PER_LEG, N_LEGS, FloatArray, RobotState, leg_slice

LIFT_S, SWAY_S, TRIPOD_S = 1.2, 1.6, 1.2

#: Order of the lifts: no leg follows its neighbour.
LIFT_ORDER = (1, 4, 2, 5, 3, 6)

TRIPODS = ((1, 3, 5), (2, 4, 6))

#: Height of a lift, and of the raised legs of a tripod, as multiples of the gait's step height.
LIFT_HEIGHTS, TRIPOD_HEIGHTS = 1.5, 0.6

#: Sine of the coxa and radius of the sway, as multiples of the gait's stride.
COXA_STRIDES, SWAY_STRIDES = 0.35, 0.12

#: Dip of the body in the sway, as a multiple of the gait's step height.
DIP_HEIGHTS = 0.6

TIBIA_BUMP_RAD = math.radians(15.0)

#: Maximum amplitudes of femur and coxa.
MOST_RAD = math.radians(30.0)

#: Share of a motion in which it rises, and in which it comes down.
RISE = 0.25

#: Peak speed of a motion, as a share of the joint's.
SPEED_SHARE = 0.8

#: Shift of the body away from a lifted leg, as a share of the stance radius.
LEAN_SHARE = 0.1

#: A motion ends if the body leans by more than this from where it stood.
MOST_TILT_RAD = math.radians(12.0)

#: It also ends if fewer feet than this stand for `LOST_TICKS`, and the body leans by more than
#: `LOST_TILT_RAD` (if known): on stiff legs a foot may carry nothing while the body stays level.
LEAST_FEET = 3
LOST_TICKS = 5
LOST_TILT_RAD = math.radians(4.0)

#: Duration of the return of a stopped motion.
RETURN_S = 0.4


@dataclass(frozen=True, slots=True)
class Probe:
    """A motion of the standing test: `lift` of a leg, `sway` on all, or `tripod` on three legs."""

    kind: str
    legs: tuple[int, ...]

    def __str__(self) -> str:
        names = ", ".join(map(str, self.legs))
        return {"lift": f"lift of leg {names}", "sway": "sway"}.get(self.kind, f"stand on legs {names}")

    @property
    def duration_s(self) -> float:
        """Its planned duration."""
        return {"lift": LIFT_S, "sway": SWAY_S, "tripod": TRIPOD_S}[self.kind]

    @property
    def raised(self) -> tuple[int, ...]:
        """The legs that it takes off the floor."""
        if self.kind == "sway":
            return ()
        return self.legs if self.kind == "lift" else tuple(set(range(1, N_LEGS + 1)) - set(self.legs))


LIFTS = tuple(Probe("lift", (leg,)) for leg in LIFT_ORDER)
SWAY = Probe("sway", tuple(range(1, N_LEGS + 1)))
ALL_PROBES = (*LIFTS, SWAY, *(Probe("tripod", legs) for legs in TRIPODS))


def probe_targets_rad(robot: Robot, probe: Probe, period_s: float) -> FloatArray:
    """Joint targets of a motion, (T, 18), from stance to stance, scaled down to joint ranges and speeds."""
    count = round(probe.duration_s / period_s)
    tau: FloatArray = np.linspace(0.0, 1.0, count + 1)[1:]
    for scale in np.linspace(1.0, 0.1, 19):
        try:
            targets = _targets(robot, probe, tau, float(scale))
        except (ReachError, LimitError):
            continue
        steps = np.abs(np.diff(targets, axis=0, prepend=robot.stance_angles_rad[np.newaxis]))
        slow = (steps <= SPEED_SHARE * robot.joint_max_speed_rad_s * period_s).all()
        if slow and range_excess_rad(robot, targets).max() <= 0:
            return targets
    raise LimitError(f"{probe}: its joints have no room around the stance; allowed: some to both sides")


def _targets(robot: Robot, probe: Probe, tau: FloatArray, scale: float) -> FloatArray:
    stance = robot.stance_angles_rad
    if probe.kind == "sway":
        # A circle through the centre with two dips, and a soft start and stop.
        angle = math.tau * (tau - np.sin(math.tau * tau) / math.tau)
        radius_m = scale * SWAY_STRIDES * robot.gait.amplitude * robot.size_m
        body = radius_m * np.stack([np.sin(angle), 1 - np.cos(angle), np.zeros_like(angle)], axis=-1)
        body[:, 2] = -scale * DIP_HEIGHTS * robot.gait.height * robot.size_m * np.sin(angle) ** 2
        return solve_legs_within_limits(robot, robot.stance_feet_body - body[:, np.newaxis])
    up = 0.5 - 0.5 * np.cos(math.pi * np.clip(np.minimum(tau, 1 - tau) / RISE, 0, 1))
    targets = np.tile(stance, (len(tau), 1))
    if probe.kind == "tripod":
        raised = np.isin(np.arange(1, N_LEGS + 1), probe.raised)
        lift_m = scale * TRIPOD_HEIGHTS * robot.gait.height * robot.size_m
        rise = np.zeros((len(tau), N_LEGS, 3))
        rise[..., 2] = lift_m * up[:, np.newaxis] * raised
        return solve_legs_within_limits(robot, robot.stance_feet_body + rise)
    leg = probe.legs[0]
    joints = leg_slice(leg)
    away_m = scale * LEAN_SHARE * robot.stance_radius_m
    azimuth = robot.leg_azimuths_rad[leg - 1]
    shift = away_m * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    targets = solve_legs_within_limits(robot, robot.stance_feet_body + up[:, np.newaxis, np.newaxis] * shift)
    part = np.clip((tau - RISE) / (1 - 2 * RISE), 0, 1)
    coxa, femur, tibia = scale * _lift_amplitudes_rad(robot, leg)
    targets[:, joints] = stance[joints] + np.stack(
        [coxa * np.sin(math.tau * part), femur * up, tibia * (0.5 - 0.5 * np.cos(math.tau * part))], axis=-1
    )
    return targets


def _lift_amplitudes_rad(robot: Robot, leg: int) -> FloatArray:
    """Amplitudes of coxa, femur and tibia in a lift, (3,), within their ranges and speeds."""
    from_mount = robot.stance_feet_body[leg - 1] - robot.mount_positions_body[leg - 1]
    outward_m = float(np.hypot(*from_mount[:2]))
    coxa = COXA_STRIDES * robot.gait.amplitude * robot.size_m / outward_m
    femur = LIFT_HEIGHTS * robot.gait.height * robot.size_m / (outward_m - robot.link_vectors_m[0, 0])
    joints = leg_slice(leg)
    above = (robot.joint_upper_rad - robot.stance_angles_rad)[joints]
    below = (robot.stance_angles_rad - robot.joint_lower_rad)[joints]
    # Peak speeds of a sine of one period, of a rise, and of a bump, at an amplitude of 1.
    peaks = np.array([math.tau / (1 - 2 * RISE), math.pi / 2 / RISE, math.pi / (1 - 2 * RISE)]) / LIFT_S
    most = np.minimum(MOST_RAD, SPEED_SHARE * robot.joint_max_speed_rad_s[joints] / peaks)
    tibia = TIBIA_BUMP_RAD if above[2] >= min(below[2], TIBIA_BUMP_RAD) else -TIBIA_BUMP_RAD
    wanted = np.array(
        [min(coxa, above[0], below[0]), min(femur, above[1]), np.clip(tibia, -below[2], above[2])]
    )
    return np.asarray(np.clip(wanted, -most, most))


@dataclass(slots=True)
class Section:
    """A motion as it was made, rows [start, stop); `stopped` and `left_out` are reasons, or None."""

    probe: Probe
    start: int
    stop: int = 0
    stopped: str | None = None
    left_out: str | None = None


@dataclass(slots=True)
class Observed:
    """Observations of a standing test, tick by tick.

    Attributes:
        rows: joint angles read and targets sent after them, (18,), contacts, (6,), and torques, (18,).
    """

    sections: list[Section] = field(default_factory=list)
    measured: bool = True
    rows: list[tuple[FloatArray, ...]] = field(default_factory=list)

    def __len__(self) -> int:
        return len(self.rows)

    def add(self, state: RobotState, targets_rad: FloatArray) -> None:
        """Append a state and the targets sent after it."""
        self.measured = self.measured and state.measured
        contacts, torques = state.foot_contacts, state.joint_torques_nm
        self.rows.append(
            (
                state.joint_positions_rad,
                np.array(targets_rad),
                np.full(N_LEGS, np.nan) if contacts is None else contacts.astype(float),
                np.full(N_LEGS * JOINTS_PER_LEG, np.nan) if torques is None else torques,
            )
        )

    def columns(self) -> tuple[FloatArray, ...]:
        """The four values of `rows` over time, (T, 18) or (T, 6); NaN if unknown."""
        return tuple(np.array([row[index] for row in self.rows]) for index in range(4))


def lean_rad(quaternion: FloatArray) -> FloatArray:
    """The body's z axis in the world, x and y, leading shape + (2,): for small angles the lean."""
    w, x, y, z = np.moveaxis(quaternion, -1, 0)
    return np.stack([2 * (x * z + w * y), 2 * (y * z - w * x)], axis=-1)


#: Legs that must not carry a tripod by the observations so far, with the reason.
UnsafeLegs = Callable[[Observed], Mapping[int, str]]


class StandingTest(Controller):
    """Makes probes one after the other while the robot stands, and observes the legs.

    A probe ends early if the body leans by more than `MOST_TILT_RAD`, or fewer than `LEAST_FEET` standing
    feet have contact: its legs are put down, and the next one begins. `unsafe` is asked before each tripod.

    Raises LimitError for a robot whose joints have no room around the stance.
    """

    def __init__(
        self,
        robot: Robot,
        period_s: float,
        *,
        probes: Sequence[Probe] = ALL_PROBES,
        unsafe: UnsafeLegs = lambda _: {},
    ) -> None:
        self.observed = Observed()
        self._robot, self._unsafe = robot, unsafe
        self._paths = [(probe, probe_targets_rad(robot, probe, period_s)) for probe in probes]
        self._return_steps = max(1, round(RETURN_S / period_s))
        self._path: FloatArray | None = None
        self._begun_at = self._lost_ticks = 0
        self._upright: FloatArray | None = None
        self._now_rad = robot.stance_angles_rad

    def targets_rad(self, step: int, state: RobotState) -> FloatArray:
        """Joint targets of the current probe, (18,)."""
        if self._upright is None and state.base_quaternion_world is not None:
            self._upright = lean_rad(state.base_quaternion_world)
        if self._path is not None and step - self._begun_at >= len(self._path):
            self._end()
        if self._path is None:
            self._begin(step)
        elif (why := self._unsafe_now(state)) is not None:
            self._take_back(step, why)
        if self._path is not None:
            self._now_rad = self._path[step - self._begun_at]
        self.observed.add(state, self._now_rad)
        return self._now_rad

    def done(self, step: int, state: RobotState) -> bool:
        """Whether all probes have been made or left out."""
        return not self._paths and (self._path is None or step - self._begun_at >= len(self._path) - 1)

    def _begin(self, step: int) -> None:
        now = len(self.observed)
        while self._paths:
            probe, path = self._paths.pop(0)
            why = None
            if probe.kind == "tripod":
                unsafe = self._unsafe(self.observed)
                why = next((unsafe[leg] for leg in probe.legs if leg in unsafe), None)
            self.observed.sections.append(Section(probe, now, now, left_out=why))
            if why is None:
                self._path, self._begun_at, self._lost_ticks = path, step, 0
                return

    def _end(self) -> None:
        self._path = None
        section = self.observed.sections[-1]
        if section.stopped is None:
            section.stop = len(self.observed)

    def _take_back(self, step: int, why: str) -> None:
        section = self.observed.sections[-1]
        section.stopped, section.stop = why, len(self.observed)
        share = (np.arange(self._return_steps) + 1)[:, np.newaxis] / self._return_steps
        self._path = (1 - share) * self._now_rad + share * self._robot.stance_angles_rad
        self._begun_at = step

    def _unsafe_now(self, state: RobotState) -> str | None:
        section = self.observed.sections[-1]
        if section.stopped is not None:
            return None
        tilt_rad = math.inf
        if self._upright is not None and state.base_quaternion_world is not None:
            tilt_rad = float(np.linalg.norm(lean_rad(state.base_quaternion_world) - self._upright))
            if tilt_rad > MOST_TILT_RAD:
                return f"the body leant by {math.degrees(tilt_rad):.0f} degrees"
        if state.foot_contacts is not None:
            down = ~np.isin(np.arange(1, N_LEGS + 1), section.probe.raised)
            few = np.count_nonzero(state.foot_contacts & down) < LEAST_FEET and tilt_rad > LOST_TILT_RAD
            self._lost_ticks = self._lost_ticks + 1 if few else 0
            if self._lost_ticks >= LOST_TICKS:
                return f"fewer than {LEAST_FEET} other feet had contact"
        return None
