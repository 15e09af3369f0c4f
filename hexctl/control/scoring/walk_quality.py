"""Quality of a walk: mechanical energy, cost of transport, lean and steadiness."""

import math

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.gait.foot_trajectory import RAMP_DURATION_S
from hexctl.robot.model import Robot
from hexctl.types import GRAVITY_M_S2, N_JOINTS, BoolArray, FloatArray, RobotState

#: Number of ticks per block of the sums: a tick then costs two copies.
BLOCK_TICKS = 64

#: Ticks of the soft start, in which speed and lean are not those of the gait.
RAMP_TICKS = math.ceil(RAMP_DURATION_S / PERIOD_S)

#: Ticks over which a velocity is taken: over 0.1 s, sensor noise of s metres adds 14 * s m/s to each axis.
VELOCITY_TICKS = 5


class WalkEffort:
    """Mechanical energy that actuators put into walks, of batch shape () for one robot, (n,) for n.

    Braking does not count, because servos do not feed it back:

        E = sum over periods k and joints of max(0, tau[k] * (q[k] - q[k-1]))

    A batch equals single robots to the last bit.
    """

    def __init__(self, batch_shape: tuple[int, ...] = ()) -> None:
        self._torques_nm = np.zeros((BLOCK_TICKS + 1, *batch_shape, N_JOINTS))
        self._angles_rad = np.zeros((BLOCK_TICKS + 1, *batch_shape, N_JOINTS))
        self._walking = np.ones((BLOCK_TICKS + 1, *batch_shape, 1), dtype=bool)
        self._work_j = np.zeros((*batch_shape, N_JOINTS))
        self._rows = 0
        self._known = True

    def add(self, state: RobotState, commanded_rad: FloatArray, walking: BoolArray | None = None) -> None:
        """Take the next tick; `walking`, (n,), flags the robots of a batch that still walk."""
        if state.joint_torques_nm is None or not state.measured:
            self._known = False
            return
        row = self._rows
        self._torques_nm[row] = state.joint_torques_nm
        self._angles_rad[row] = state.joint_positions_rad
        if walking is not None:
            self._walking[row, ..., 0] = walking
        self._rows = row + 1
        if row == BLOCK_TICKS:
            self._sum_up()

    def energy_j(self, index: tuple[int, ...] = ()) -> float | None:
        """Energy of one robot so far; None if a state came without torques or measured angles."""
        joints_j = self.joints_j
        energy_j = math.nan if joints_j is None else float(np.add.reduce(joints_j[index]))
        return energy_j if math.isfinite(energy_j) else None

    @property
    def joints_j(self) -> FloatArray | None:
        """Energy of each joint so far, leading shape + (18,), or None as above and without a tick."""
        if self._rows:
            self._sum_up()
        return self._work_j if self._known and self._rows else None

    def _sum_up(self) -> None:
        """Add the rows to the sum; the last one begins the next block."""
        rows = self._rows
        torques_nm, angles_rad = self._torques_nm[:rows], self._angles_rad[:rows]
        work_j = torques_nm[1:] * (angles_rad[1:] - angles_rad[:-1])
        counts = self._walking[1:rows] & ~(work_j <= 0)  # unknown values make the sum unknown
        self._work_j = self._work_j + np.add.reduce(np.where(counts, work_j, 0.0), axis=0)
        for each in (self._torques_nm, self._angles_rad, self._walking):
            each[0] = each[rows - 1]
        self._rows = 1


def cost_of_transport(robot: Robot, energy_j: float | None, distance_m: float | None) -> float | None:
    """Cost of transport E / (m g d), without unit and payload; None without an energy or progress.

    Source: Lee and Harris (2018), https://doi.org/10.3389/frobt.2018.00111.
    """
    if energy_j is None or distance_m is None or distance_m <= 0:
        return None
    return energy_j / (robot.mass_kg * GRAVITY_M_S2 * distance_m)


def lean_deg(quaternions_world: FloatArray) -> float | None:
    """RMS lean in degrees of orientations (w, x, y, z), (T, 4), after the soft start; None if all are NaN."""
    late = quaternions_world[RAMP_TICKS:]
    known = late[np.isfinite(late[:, 0])]
    if not len(known):
        return None
    # The body's z axis is turned by twice the angle whose sine is the length of (x, y).
    lean_rad = 2 * np.arcsin(np.minimum(np.hypot(known[:, 1], known[:, 2]), 1.0))
    return math.degrees(math.sqrt(float((lean_rad**2).mean())))


def unsteadiness_m_s(positions_world: FloatArray) -> float | None:
    """RMS deviation of the velocity of positions (T, 3) from its mean after the soft start, in m/s, or None.

    It measures the mean kinetic energy of swaying: Cavagna, Heglund and Taylor (1977), Am. J. Physiol. 233,
    R243-R261.
    """
    late = positions_world[RAMP_TICKS:]
    moved = late[VELOCITY_TICKS:] - late[:-VELOCITY_TICKS]
    velocities = moved[np.isfinite(moved).all(axis=-1)] / (VELOCITY_TICKS * PERIOD_S)
    if len(velocities) < 2:
        return None
    off = velocities - velocities.mean(axis=0)
    return math.sqrt(float((off**2).sum(axis=-1).mean()))
