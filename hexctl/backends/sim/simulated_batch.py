"""Many simulations, stepped together by `mujoco.batch`."""

import copy
from collections.abc import Sequence
from typing import Any

import numpy as np
from mujoco.batch import Batch, SimulationError

from hexctl.backends.base import TruePose
from hexctl.backends.sim.sensing import JointTorques, SensorMemory
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.simulated_failure import FIRST_SPEED, FailuresToCome, jam_rad
from hexctl.backends.sim.simulation_model import FIRST_JOINT, waiting_commands
from hexctl.columns import SENSED, Column
from hexctl.mujoco_import import mujoco
from hexctl.types import FloatArray, RobotState


def batch_layout(servos: SimServos) -> tuple[object, ...]:
    """Ticks, delays and model sizes, which must be equal in simulations stepped together."""
    model, world = servos.compiled.physics.model.ptr, servos.world
    sizes = [getattr(model, name) for name in dir(model) if name.startswith("n") and name != "names"]
    counts = tuple(size for size in sizes if isinstance(size, int))
    return (servos.robot.fingerprint, servos.robot.sensors, world.time_step_s, world.latency_steps, *counts)


class SimBatch:
    """Copies of connected simulations: same model, same state, same future noise.

    A copy stepped with the targets of its original gives bit-identical states.

    Args:
        servos: one simulation, or several of the same `batch_layout`, with separate worlds and failures.
        n: copies of each simulation, in consecutive rows.
        threads: threads that simulate; 0 uses all cores.

    Attributes: running: which simulations are still stepped, (n,); diverged ones are not, and a caller may
    clear others. States of the others are invalid.
    """

    def __init__(
        self, servos: SimServos | Sequence[SimServos], n: int | Sequence[int], threads: int = 0
    ) -> None:
        each = [servos] if isinstance(servos, SimServos) else list(servos)
        counts = [n] if isinstance(n, int) else list(n)
        self._batch = Batch(each[0].compiled.physics.model.ptr, sum(counts), threads)
        # Separate models: an event changes that of its simulation, and a load the friction of its row.
        self._separate = len(each) > 1 or any(one.events or one.compiled.gears for one in each)
        stops = np.cumsum(counts).tolist()
        rows = [slice(stop - count, stop) for stop, count in zip(stops, counts, strict=True)]
        self._copies = [_Copies(one, self._batch, part) for one, part in zip(each, rows, strict=True)]
        self._set_models()
        self._nstep = each[0].world.steps_per_tick
        self._qpos, self._ctrl = self._batch.bind("qpos"), self._batch.bind("ctrl")
        self.running = np.ones(sum(counts), dtype=bool)

    def tick(self) -> None:
        """Step every running simulation by one control period."""
        if any([part.let_fail() for part in self._copies]):  # noqa: C419  all of them
            self._set_models()
        after = self._copies[0].sensors.steps_after
        self._step(self._nstep - after)
        for part in self._copies:
            part.sensors.keep()
        if after:
            self._step(after)
        for part in self._copies:
            part.rub()
            part.draw()

    def _set_models(self) -> None:
        if self._separate:
            self._batch.set_models([model for part in self._copies for model in part.models])

    def _step(self, nstep: int) -> None:
        if not self.running.any():
            return
        everyone = self.running.all()
        try:
            self._batch.step(None if everyone else np.flatnonzero(self.running), nstep=nstep)
        except SimulationError as error:
            self.running[error.ids] = False
        if self._batch.warning.any():
            self.running &= ~self._batch.warning.any(axis=(-2, -1))

    @property
    def true_pose(self) -> TruePose:
        """Current positions (n, 3) and orientations (n, 4) of the bases."""
        return self._qpos[:, :3], self._qpos[:, 3:FIRST_JOINT]

    def read(self) -> RobotState:
        """States after the last tick, with the worlds' sensor noise; arrays of leading shape (n,).

        Robots without a pose in this tick have NaN; the time is that of the first one.
        """
        states = [part.read() for part in self._copies]
        return states[0] if len(states) == 1 else _together(states)

    def write(self, joint_positions_rad: FloatArray) -> None:
        """Command the simulated servos; targets (n, 18) in rad."""
        for part in self._copies:
            self._ctrl[part.rows] = part.drive(joint_positions_rad[part.rows])


class _Copies:
    """Copies of one simulation in some rows of a batch."""

    def __init__(self, servos: SimServos, batch: Any, rows: slice) -> None:
        self.rows, n = rows, rows.stop - rows.start
        self._simulation, self._period_s = servos.compiled, servos.clock.period_s
        self._loss, self._actuators = copy.deepcopy(servos.loss), servos.actuators.copies(n)
        self._sent_rad = np.tile(servos.sent_rad, (n, 1))
        self._start_index, self._ticks = round(servos.clock.now_s / self._period_s), 0
        physics, row = self._simulation.physics, np.empty(batch.nstate)
        self.models = [physics.model.ptr] * n
        self._own_models()
        mujoco.mj_getState(physics.model.ptr, physics.data.ptr, row, mujoco.mjtState.mjSTATE_INTEGRATION)
        batch.state[rows] = row
        memory = SensorMemory.of(
            servos.sensors.torques,
            lambda name: batch.bind(name)[rows],
            self._actuators.asked_rad,
            self._sent_rad,
        )
        self.sensors = servos.sensors.copies(memory, n)
        self._ctrl, self._to_come = batch.bind("ctrl")[rows], FailuresToCome(servos.events, self._period_s)
        self._waiting_rad = waiting_commands(physics.model, batch.bind("history")[rows])

    def _own_models(self) -> None:
        """Give each row a model, with its friction, if that depends on the load."""
        if self._simulation.gears is not None:
            friction_nm = [model.dof_frictionloss for model in self.models]
            self.models = [copy.copy(self._simulation.physics.model.ptr) for _ in friction_nm]
            for model, row_nm in zip(self.models, friction_nm, strict=True):
                model.dof_frictionloss[:] = row_nm

    def let_fail(self) -> bool:
        """Apply due failures and healings, if any; the walk begins with the second control period."""
        due = self._to_come.due()
        for event in due:
            self._simulation.failed.change(event.leg, event.failure)
            self.sensors.torques = JointTorques.of(self._simulation)
            jammed_rad = jam_rad(self._simulation.failed, self.sensors.memory.qpos, self._ctrl)
            self._actuators.leg_changed(event.leg, jammed_rad, self._ctrl, self._waiting_rad)
        if due:
            self._own_models()
        return bool(due)

    def rub(self) -> None:
        """Let the friction follow the load."""
        if (gears := self._simulation.gears) is not None:
            limits_nm = gears.limit_nm(*self.sensors.memory.servos_now)
            for model, row_nm in zip(self.models, limits_nm, strict=True):
                model.dof_frictionloss[FIRST_SPEED:] = row_nm

    def draw(self) -> None:
        self.sensors.draw()
        self._loss.draw()
        self._ticks += 1

    def read(self) -> RobotState:
        return self.sensors.read((self._start_index + self._ticks) * self._period_s)

    def drive(self, joint_positions_rad: FloatArray) -> FloatArray:
        np.copyto(self._sent_rad, joint_positions_rad)
        return self._actuators.drive(joint_positions_rad, self._loss.lost)


def _together(states: Sequence[RobotState]) -> RobotState:
    sensed = {column.source: _stacked(column, states) for column in SENSED}
    return RobotState(stamp_s=states[0].stamp_s, measured=states[0].measured, age_s=states[0].age_s, **sensed)


def _stacked(column: Column, states: Sequence[RobotState]) -> Any:
    """Rows of several simulations, NaN for missing ones; None if all are missing."""
    parts = [getattr(state, column.source) for state in states]
    if all(part is None for part in parts):
        return None
    counts = [len(state.joint_positions_rad) for state in states]
    rows = [
        np.full((count, *column.shape), np.nan) if part is None else part
        for part, count in zip(parts, counts, strict=True)
    ]
    return np.concatenate(rows)
