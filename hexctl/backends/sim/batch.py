"""Many simulations that start from one state, stepped together by `mujoco.batch`."""

import copy

import mujoco
import numpy as np
from mujoco.batch import Batch, SimulationError

from hexctl.backends.base import TruePose
from hexctl.backends.sim.model import FIRST_JOINT, TOUCH
from hexctl.backends.sim.sensing import Snapshot, sensed
from hexctl.backends.sim.servos import SimServos
from hexctl.types import FloatArray, RobotState


class SimBatch:
    """n copies of a connected simulation as it stands now: same model, same state, same noise to come.

    A copy that is stepped with the same targets as the original gives the same states to the last bit.

    Attributes:
        running: which simulations are still stepped, (n,); one that diverges drops out by itself, and a
            caller may clear others. The state of one that has dropped out means nothing.
    """

    def __init__(self, servos: SimServos, n: int, threads: int = 0) -> None:
        self._simulation = servos.simulation
        self._noise = copy.deepcopy(servos.noise)
        self._faulty_pose = copy.deepcopy(servos.faulty_pose)
        self._loss = copy.deepcopy(servos.loss)
        self._pose_loss = copy.deepcopy(servos.pose_loss)
        self._actuators = servos.actuators.copies(n)
        self._world = servos.world
        self._late = None if servos.late is None else servos.late.copies(servos.world, n)
        self._nstep = servos.world.steps_per_tick
        self._period_s = servos.clock.period_s
        self._start_index, self._ticks = round(servos.clock.now_s / self._period_s), 0
        physics = self._simulation.physics
        model, data = physics.model.ptr, physics.data.ptr
        self._batch = Batch(model, n, threads)
        row = np.empty(self._batch.nstate)
        mujoco.mj_getState(model, data, row, mujoco.mjtState.mjSTATE_INTEGRATION)
        self._batch.state[:] = row
        self._qpos, self._ctrl = self._batch.bind("qpos"), self._batch.bind("ctrl")
        self._touch = self._batch.bind("sensordata")[:, TOUCH]
        self._torques = servos.torques
        self._qvel, self._forces = (
            self._batch.bind("qvel"),
            servos.torques.forces_in(self._batch.bind("history")),
        )
        self.running = np.ones(n, dtype=bool)

    def tick(self) -> None:
        """Step every running simulation by one control period."""
        after = 0 if self._late is None else self._late.steps_after
        self._step(self._nstep - after)
        if self._late is not None:
            self._late.keep(self._measured())
        if after:
            self._step(after)
        self._noise.draw()
        self._loss.draw()
        self._pose_loss.draw()
        self._ticks += 1

    def _step(self, nstep: int) -> None:
        """Step every running simulation; one that diverges no longer runs."""
        if not self.running.any():
            return
        everyone = self.running.all()
        try:
            self._batch.step(None if everyone else np.flatnonzero(self.running), nstep=nstep)
        except SimulationError as error:
            self.running[error.ids] = False
        if self._batch.warning.any():
            self.running &= ~self._batch.warning.any(axis=-1)

    def _measured(self) -> Snapshot:
        """What is measured now, without errors."""
        torques_nm = self._torques.applied(self._forces, self._qvel)
        return Snapshot(self._qpos.copy(), self._touch.copy(), torques_nm)

    @property
    def true_pose(self) -> TruePose:
        """Positions (n, 3) and orientations (n, 4) of the bases as they are."""
        return self._qpos[:, :3], self._qpos[:, 3:FIRST_JOINT]

    def read(self) -> RobotState:
        """States after the last tick, with the world's sensor noise; arrays of leading shape (n,)."""
        measured = self._measured() if self._late is None else self._late.oldest
        age_s = self._world.latency_steps * self._world.time_step_s
        return sensed(
            measured,
            self._noise,
            self._faulty_pose,
            offsets_rad=self._simulation.joint_offsets_rad,
            stamp_s=(self._start_index + self._ticks) * self._period_s - age_s,
            age_s=age_s,
            posed=not self._pose_loss.lost,
        )

    def write(self, positions_rad: FloatArray) -> None:
        """Command the simulated servos; targets (n, 18) in rad."""
        self._ctrl[:] = self._actuators.drive(positions_rad, self._loss.lost)
