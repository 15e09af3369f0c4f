"""The reference of all simulation benchmarks: bare `mujoco.mj_step`, with controls recorded before."""

import copy
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.actuators import ActuatorModel
from hexctl.backends.sim.servos import SimServos
from hexctl.control.log import TickLog
from hexctl.types import FloatArray

STATE = mujoco.mjtState.mjSTATE_INTEGRATION


@dataclass(frozen=True, slots=True)
class Start:
    """A simulation at one moment: its own model and the whole state."""

    model: Any
    state: FloatArray

    @classmethod
    def of(cls, servos: SimServos) -> "Start":
        """Return the connected simulation as it stands now; it may then move on or be closed."""
        physics = servos.compiled.physics
        return cls(copy.copy(physics.model.ptr), state_of(physics.model.ptr, physics.data.ptr))

    def data(self) -> Any:
        """Return a new MjData in this state."""
        data = mujoco.MjData(self.model)
        mujoco.mj_setState(self.model, data, self.state, STATE)
        return data


def state_of(model: Any, data: Any) -> FloatArray:
    """Return the whole state of a simulation."""
    state = np.empty(mujoco.mj_stateSize(model, STATE))
    mujoco.mj_getState(model, data, state, STATE)
    return state


def bare_steps(model: Any, data: Any, controls: Sequence[FloatArray]) -> None:
    """Step physics by one control period per row of controls, and do nothing else; the GIL is released."""
    step, ctrl = mujoco.mj_step, data.ctrl
    steps = round(PERIOD_S / model.opt.timestep)
    for row in controls:
        ctrl[:] = row
        step(model, data, steps)


def controls_of(log: TickLog, servos: SimServos) -> list[FloatArray]:
    """Return the actuator controls under which each logged tick was stepped, from the first tick on.

    What a tick sends acts from the next one on; the first is stepped with the controls of the start state.
    """
    stance_rad = servos.robot.stance_angles_rad
    sent = [stance_rad, *log["commanded_rad"][:-1]]
    train = ActuatorModel.at_rest(servos.compiled, stance_rad, stance_rad)
    return [train.drive(row) for row in sent]


def require_same_end(ours: FloatArray, bare: FloatArray, what: str) -> None:
    """Make sure that the reference did the same work: its last positions are ours to the last bit."""
    if not np.array_equal(ours, bare):
        worst = float(np.abs(ours - bare).max())
        raise RuntimeError(f"{what}: the reference ends {worst:g} from ours; it does other work")
