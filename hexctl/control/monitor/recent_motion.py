"""Recent motion of joints, and the kind of failure that it shows."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

from hexctl.control.monitor.leg_support import OFF_RAD
from hexctl.robot.failure import Failure
from hexctl.types import JOINT_KINDS, N_JOINTS, ArrayFields, BoolArray, FloatArray, leg_slice

#: Default and maximum window, in cycles, that separates still joints from moving ones.
STILL_CYCLES, MOST_STILL_CYCLES = 0.25, 1.5

#: Minimum ticks of the memory, besides a cycle.
MORE_ROWS = 40

#: Motions of targets are alike if their mean squared difference is below this share of the targets' variance.
ALIKE = 0.25

#: Latest part of that window that shows missing power, in cycles.
POWER_CYCLES = 0.125

#: A joint is still if it moves by less than this, or by this share of its targets.
STILL_RAD, STILL_SHARE = math.radians(2.0), 0.25

#: Minimum motion of the targets that shows whether a joint is still.
TELLING_RAD = math.radians(4.0)

#: A joint takes part in a failure if its evidence is this share of an alarm, or of the worst joint's.
TAKES_PART = 0.4


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class LegMotion(ArrayFields):
    """Motion of the joints of one leg in the last part of a cycle, newest tick first, each (ticks, 3).

    Targets were sent before the measurement, and `latest_ticks` show whether a servo has power.
    """

    measured_rad: FloatArray
    targets_rad: FloatArray
    torques_nm: FloatArray
    latest_ticks: int

    def dead(self, none_nm: FloatArray) -> BoolArray | None:
        """Which joints recently gave less torque than `none_nm`, (3,); None if not measured."""
        if not np.isfinite(self.torques_nm[0]).all():
            return None
        dead: BoolArray = np.abs(self.torques_nm[: self.latest_ticks]).max(axis=0) < none_nm
        return dead

    def off_target(self) -> BoolArray:
        """Which joints are off their targets now, (3,)."""
        off: BoolArray = np.abs(self.measured_rad[0] - self.targets_rad[0]) > OFF_RAD
        return off

    def moves(self) -> tuple[FloatArray, BoolArray]:
        """Motion of each joint as a share of its targets', and whether that moved enough to judge, (3,)."""
        range_rad = np.ptp(self.targets_rad, axis=0)
        moves = np.ptp(self.measured_rad, axis=0) / np.maximum(range_rad, STILL_RAD / STILL_SHARE)
        return moves, range_rad > TELLING_RAD


class RecentMotion:
    """Recent motion of all joints.

    Attributes:
        cycles: of one tick now, leading shape; they may rise above the initial ones.
    """

    def __init__(self, shape: tuple[int, ...], cycles: FloatArray) -> None:
        self.cycles = cycles
        longest = (1 / cycles).max()
        rows = math.ceil(max(MORE_ROWS + longest, MOST_STILL_CYCLES * longest))
        self._rows: FloatArray = np.full((3, rows, *shape, N_JOINTS), np.nan)
        self._row, self._robots = 0, np.indices(shape)

    def measured(self, joint_positions_rad: FloatArray, torques_nm: FloatArray | None) -> None:
        """Take the measurements of a tick, leading shape + (18,)."""
        self._rows[0, self._row] = joint_positions_rad
        self._rows[2, self._row] = np.nan if torques_nm is None else torques_nm

    def sent(self, targets_rad: FloatArray) -> None:
        """Take the targets sent in the tick, leading shape + (18,)."""
        self._rows[1, self._row] = targets_rad
        self._row = (self._row + 1) % self._rows.shape[1]

    def last(self, ticks: int) -> FloatArray | None:
        """Measured angles, targets and torques of the last ticks, (3, ticks) + leading shape + (18,).

        The last targets are not sent yet: they are old ones. None if the memory is shorter; NaN before the
        first tick.
        """
        count, first = self._rows.shape[1], self._row + 1 - ticks
        if first >= 0:
            return self._rows[:, first : self._row + 1]
        return None if ticks > count else self._rows[:, np.arange(first, self._row + 1)]

    def repeats(self, ticks: int) -> BoolArray:
        """Whether the targets of the last ticks are about those of one cycle earlier, leading shape.

        False before that.
        """
        targets, count = self._rows[1], self._rows.shape[1]
        newest = self._row - 1 - np.arange(ticks)
        cycle = np.rint(1 / self.cycles).astype(int)
        rows = np.subtract.outer(newest, cycle) % count
        change = targets[newest % count] - targets[(rows, *self._robots)]
        off = targets - np.add.reduce(targets, axis=0) / count
        variances = np.add.reduce(off * off, axis=0) / count
        mean_square = np.add.reduce(change * change, axis=(0, -1)) / (ticks * N_JOINTS)
        same: BoolArray = mean_square <= ALIKE * (np.add.reduce(variances, axis=-1) / N_JOINTS)
        return same

    def of_leg(self, leg: int, row: tuple[int, ...] = (), *, cycles: float = STILL_CYCLES) -> LegMotion:
        """Motion of a leg, 1..6, of one robot of a batch, in the last cycles, up to `MOST_STILL_CYCLES`."""
        index: tuple[Any, ...] = (*row, leg_slice(leg))
        cycle_ticks, rows = float(1 / self.cycles[row]), self._rows.shape[1]
        ticks = max(2, round(cycles * cycle_ticks))
        # The newest rows: measured in this tick, sent in the one before.
        newest = (self._row - np.arange(min(ticks, rows))) % rows
        return LegMotion(
            measured_rad=self._rows[0][(newest, *index)],
            targets_rad=self._rows[1][((newest - 1) % rows, *index)],
            torques_nm=self._rows[2][(newest, *index)],
            latest_ticks=1 + round(POWER_CYCLES * cycle_ticks),
        )


def failure_shown(
    leg: int, motion: LegMotion, rho: FloatArray, *, follows: bool, none_nm: FloatArray, powered: bool = False
) -> Failure:
    """The failure of a leg, 1..6, as far as its motion shows.

    Joints without torque are limp. A leg whose joints follow without load is missing. Of joints that do not
    move with their targets, one is stuck, all are locked. With `powered` servos have power, and do not
    follow.
    """
    dead = None if powered else motion.dead(none_nm)
    idle = motion.off_target() & (False if dead is None else dead)
    all_dead = dead is not None and bool(dead.all())
    if all_dead and not follows:
        return Failure(leg=leg, kind="limp")
    if follows and not powered and (all_dead or not idle.any()):
        return Failure(leg=leg, kind="missing")
    moves, telling = motion.moves()
    still = moves < STILL_SHARE
    if (telling & still).sum() > 1 and not (telling & ~still).any():
        return Failure(leg=leg, kind="locked")
    takes_part = rho > TAKES_PART * rho.max()
    if (idle & takes_part).any():
        return _limp(leg, idle & takes_part)
    worst = int(np.argmax(rho))
    measures_torque = bool(np.isfinite(motion.torques_nm[0]).all())
    if measures_torque and not still[worst] and telling.any():
        # It has power: another joint holds it back.
        worst = int(np.argmin(np.where(telling, moves, np.inf)))
    if measures_torque or still[worst]:
        angle_rad = float(motion.measured_rad[0, worst])
        return Failure(leg=leg, kind="stuck", joint=JOINT_KINDS[worst], angle_rad=angle_rad)
    return _limp(leg, takes_part)


def _limp(leg: int, joints: BoolArray) -> Failure:
    """A leg with limp joints (3,): a single joint, else the leg."""
    return Failure(leg=leg, kind="limp", joint=JOINT_KINDS[joints.argmax()] if joints.sum() == 1 else None)
