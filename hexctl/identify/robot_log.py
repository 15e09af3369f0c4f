"""Logs of a robot's joints, replayed in a simulation on the stand or on the floor."""

import copy
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from threading import local
from typing import Any, ClassVar, Self

import numpy as np

from hexctl.backends.sim.actuators import behind_play
from hexctl.errors import InputError
from hexctl.identify.parameters import OF_TRUNK, RobotValues, play_shares
from hexctl.identify.powered_servos import PoweredServos
from hexctl.robot.model import Robot
from hexctl.types import N_LEGS, ArrayFields, FloatArray

#: Parameters that the joints of a robot determine: the torque if they reach it, the speed only on a bench.
OF_JOINTS = (
    "stiffness_nm_per_rad",
    "damping_nm_s_per_rad",
    "rotor_inertia_kg_m2",
    "dry_friction_nm",
    "max_torque_nm",
    "dead_time_s",
    "coxa_stiffness_ratio",
    "femur_stiffness_ratio",
    "play_deg",
)

#: Longest dead time of a search, for which the simulation keeps commands.
MOST_DEAD_S = 0.062

#: Length of the part of a log and step of the physics in a first search.
COARSE_LOG_S, COARSE_STEP_S = 12.0, 0.004

#: Largest difference of mounts and links from those of a recording, as a share of a leg.
SAME_SHAPE = 0.05

#: A link is slow if it repeats its readings for longer than this after commands moved by this much.
STALE_S, STALE_RAD = 0.1, np.radians(5.0)

#: A joint moves if readings change by more than this; it cannot stop for a few of them in between.
MOVING_RAD, FEW_READINGS = np.radians(1.0), 5

#: Counts of servos are larger. Recorded angles have an error far below this share of a count.
LEAST_COUNT_RAD, COUNT_SHARE = 1e-4, 0.05

#: Least number of different readings that show counts.
ENOUGH_COUNTS = 10

#: Least length of a log.
LEAST_S = 5.0


@dataclass(frozen=True, eq=False, repr=False)
class RobotLog(ArrayFields):
    """Commanded and measured joint angles of a robot.

    Attributes:
        robot: as assumed: all but its servos is right.
        on_stand: whether the trunk was held and no foot touched anything.
        time_s: (T,).
        commanded_rad: sent at each time, (T, 18), rounded to counts as servos with counts do.
        measured_rad: read before the command of the same row, (T, 18).
    """

    name: str
    robot: Robot
    on_stand: bool
    time_s: FloatArray
    commanded_rad: FloatArray
    measured_rad: FloatArray
    step_s: float = 0.002
    units: ClassVar[int] = N_LEGS

    @cached_property
    def _simulation(self) -> Any:
        from hexctl.backends.sim.simulation_model import make_simulation
        from hexctl.backends.sim.world import World

        world = World(on_stand=self.on_stand, servo_delay_s=MOST_DEAD_S, time_step_s=self.step_s)
        return make_simulation(self.robot, world)

    def _asked_rad(self, play_deg: float) -> FloatArray:
        """Commands behind a mean play of the joints, (T, 18)."""
        half_rad, asked_rad = play_shares(self.robot) * np.radians(play_deg) / 2, self.commanded_rad.copy()
        for row in range(1, len(asked_rad)):
            asked_rad[row] = behind_play(asked_rad[row - 1], self.commanded_rad[row], half_rad)
        return asked_rad

    @cached_property
    def _own(self) -> local:
        """Models of parallel search threads."""
        return local()

    @property
    def parameters(self) -> tuple[str, ...]:
        """The weight of the trunk bends the joints of a robot that stands on its feet."""
        return OF_JOINTS if self.on_stand else (*OF_JOINTS, *OF_TRUNK)

    def errors_rad(self, values: RobotValues) -> FloatArray:
        """Simulated less measured angles, (T, 18); stiffnesses of joints keep their proportions."""
        import mujoco

        from hexctl.backends.sim.simulated_failure import FIRST_SPEED
        from hexctl.backends.sim.simulation_model import FIRST_JOINT, waiting_commands

        if not hasattr(self._own, "model"):
            self._own.model = copy.copy(self._simulation.physics.model.ptr)
        model, data = self._own.model, mujoco.MjData(self._own.model)
        self._set_trunk(model, values)
        # A low voltage lowers torque and speed, and leaves the back-EMF.
        power = values.max_torque_nm / self.robot.joint_max_torque_nm.mean()
        values = replace(values, no_load_speed_rad_s=power * values.no_load_speed_rad_s)
        stiffness = np.tile(values.kind_stiffnesses_nm_per_rad, N_LEGS)
        servos = PoweredServos(model, slice(FIRST_SPEED, None), values, stiffness)
        start, asked_rad = self._simulation.physics.data, self._asked_rad(values.play_deg)
        data.qpos[:FIRST_JOINT] = start.qpos[:FIRST_JOINT]
        data.qpos[FIRST_JOINT:] = self.measured_rad[0]
        data.ctrl[:] = asked_rad[0]
        data.history[:] = start.history
        waiting_commands(model, data.history)[:] = asked_rad[0][:, np.newaxis]
        found_rad = np.empty_like(self.measured_rad)
        at_step = np.rint((self.time_s - self.time_s[0]) / model.opt.timestep).astype(int)
        for row, steps in enumerate(np.diff(at_step, append=at_step[-1]).tolist()):
            found_rad[row] = data.qpos[FIRST_JOINT:]
            data.ctrl[:] = asked_rad[row]
            servos.step(data, steps)
        return found_rad - self.measured_rad

    @property
    def stale_s(self) -> float:
        """Longest time above `STALE_S` with repeated readings after commands moved; 0 without one."""
        new = np.r_[True, np.diff(self.measured_rad, axis=0).any(axis=1)]
        reading = np.cumsum(new) - 1
        moved_rad = np.abs(self.commanded_rad - self.commanded_rad[new][reading]).max(axis=1)
        rows = np.bincount(reading, moved_rad > STALE_RAD).max()
        stood_s = float(rows * np.diff(self.time_s).mean())
        return stood_s if stood_s > STALE_S else 0.0

    @property
    def repeated_share(self) -> float:
        """Share of the readings of moving joints that repeat the last one."""
        moved = np.diff(self.measured_rad, axis=0)
        repeated, of = 0, 1
        for count in range(FEW_READINGS):
            before, after = moved[: -count - 1], moved[count + 1 :]
            seen = (np.minimum(np.abs(before), np.abs(after)) > MOVING_RAD) & (before * after > 0)
            for row in range(1, count + 1):
                seen &= moved[row : len(seen) + row] == 0
            repeated, of = repeated + count * int(seen.sum()), of + (count + 1) * int(seen.sum())
        return repeated / of

    @property
    def skipped_share(self) -> float:
        """Share of the ticks without a reading."""
        between_s = np.diff(self.time_s)
        return float(1 - len(between_s) * np.median(between_s) / between_s.sum())

    def coarse(self) -> Self:
        """The part with the fastest commands, simulated with larger steps, for a first search."""
        rows = round(COARSE_LOG_S / float(np.diff(self.time_s).mean()))
        speeds = np.abs(np.diff(self.commanded_rad, axis=0)).sum(axis=1)
        passed = np.concatenate([[0.0], np.cumsum(speeds)])
        first = int(np.argmax(passed[rows:] - passed[:-rows])) if rows < len(passed) else 0
        part = slice(first, first + rows)
        return replace(
            self,
            time_s=self.time_s[part],
            commanded_rad=self.commanded_rad[part],
            measured_rad=self.measured_rad[part],
            step_s=COARSE_STEP_S,
        )

    def _set_trunk(self, model: Any, values: RobotValues) -> None:
        """Change mass and centre of the trunk; its moments of inertia are proportional to the mass."""
        simulated, trunk = self._simulation.physics.model, model.body(f"{self.robot.name}/trunk").id
        share = values.trunk_mass_kg / simulated.body_mass[trunk]
        model.body_mass[trunk] = values.trunk_mass_kg
        model.body_inertia[trunk] = share * simulated.body_inertia[trunk]
        model.body_ipos[trunk, :2] = values.trunk_com_x_m, values.trunk_com_y_m


def read_robot_log(path: Path, robot: Robot | None = None) -> RobotLog:
    """Log of a recording (.rrd); a robot replaces that of the recording.

    Rows without a measured angle are left out. Raises InputError for a file that is damaged, too short or no
    recording, motions on a stand that did not end, and a robot of another shape.
    """
    from hexctl.recording.recorded_trial import read_trial

    trial = read_trial(path)
    robot = robot or trial.robot
    _check_shape(path, trial.robot, robot)
    # A walk on a stand makes no progress.
    if trial.on_stand and trial.properties.get("status") not in ("ok", "no_progress"):
        raise InputError(
            f"{path}: got motions that did not end; allowed: complete ones; hexctl identify without a log "
            "makes them again"
        )
    measured = np.isfinite(trial.measured_rad).all(axis=-1) & np.isfinite(trial.commanded_rad).all(axis=-1)
    time_s = trial.time_s[measured]
    lasted_s = float(time_s[-1] - time_s[0]) if len(time_s) else 0.0
    if lasted_s < LEAST_S:
        raise InputError(f"{path}: got {lasted_s:.1f} s with joint angles; allowed: at least {LEAST_S:g} s")
    measured_rad = trial.measured_rad[measured]
    commanded_rad = in_counts(trial.commanded_rad[measured], measured_rad)
    return RobotLog(path.name, robot, trial.on_stand, time_s, commanded_rad, measured_rad)


def in_counts(commanded_rad: FloatArray, measured_rad: FloatArray) -> FloatArray:
    """Commands rounded to the counts of the readings, (T, 18); those of joints without counts are kept.

    Legs bend by few counts under their weight: commands that are not rounded change all torques by a tenth.
    """
    rounded_rad = commanded_rad.copy()
    for joint, angles_rad in enumerate(measured_rad.T):
        if (counts := _counts_of(angles_rad)) is not None:
            count_rad, zero_rad = counts
            numbers = np.rint((commanded_rad[:, joint] - zero_rad) / count_rad)
            rounded_rad[:, joint] = zero_rad + count_rad * numbers
    return rounded_rad


def _counts_of(angles_rad: FloatArray) -> tuple[float, float] | None:
    """Size of a count and the angle of one; None for readings that are no counts."""
    values_rad = np.unique(angles_rad)
    steps_rad = np.diff(values_rad)
    if np.count_nonzero(steps_rad > LEAST_COUNT_RAD) < ENOUGH_COUNTS:
        return None
    steps = np.rint(steps_rad / steps_rad[steps_rad > LEAST_COUNT_RAD].min())
    numbers = np.concatenate([[0.0], np.cumsum(steps)])
    count_rad, zero_rad = np.polyfit(numbers, values_rad, 1)
    off_rad = np.abs(values_rad - zero_rad - count_rad * numbers).max()
    return (float(count_rad), float(zero_rad)) if off_rad < COUNT_SHARE * count_rad else None


def _check_shape(path: Path, recorded: Robot, robot: Robot) -> None:
    """Refuse a recording of a robot with other mounts or links: it is of another robot."""
    off_m = max(
        float(np.abs(recorded.mount_positions_body - robot.mount_positions_body).max()),
        float(np.abs(recorded.link_lengths_m - robot.link_lengths_m).max()),
    )
    if off_m > SAME_SHAPE * robot.link_lengths_m.sum():
        raise InputError(
            f"{path}: got a recording of {recorded.name}, whose mounts or links differ by {1000 * off_m:.0f} "
            f"mm from those of {robot.name}; allowed: recordings of the robot of --robot"
        )
