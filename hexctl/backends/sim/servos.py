"""The simulated robot as leg servos, and its clock."""

from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Self

import numpy as np

from hexctl.backends.base import OwnServos, TruePose, check_connected, check_targets
from hexctl.backends.clock import Clock, Standstill, Tick, WallClock
from hexctl.backends.sim.actuators import ActuatorModel
from hexctl.backends.sim.sensing import LOST_COMMANDS, JointTorques, Losses, SensorMemory, Sensors
from hexctl.backends.sim.servo_physics import ServoPower
from hexctl.backends.sim.simulated_failure import FIRST_SPEED, FailuresToCome, jam_rad, jammed_angles_rad
from hexctl.backends.sim.simulation_model import (
    FIRST_JOINT,
    TOUCH,
    Simulation,
    make_simulation,
    waiting_commands,
)
from hexctl.backends.sim.world import World, as_world
from hexctl.errors import SimulationDivergedError, check_type
from hexctl.mujoco_import import mujoco
from hexctl.robot.failure import Failure, FailureEvent, Failures, checked_failures, drawn_failure
from hexctl.robot.model import Robot
from hexctl.robot.sensors import SENSORS
from hexctl.types import FloatArray, JointTargets, RobotState


class SimClock(Clock):
    """Advances by stepping the physics: one control period per tick.

    With a pace clock each step waits for the wall clock, whose overruns it counts; the simulation never
    skips.
    """

    def __init__(self, step: Callable[[], None], pace: WallClock | None = None) -> None:
        super().__init__()
        self._step = step
        self._pace, self.waits = pace, pace is not None

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self.index * self.period_s

    @property
    def due_in_s(self) -> float:
        """Wait of the pace before the next step; 0 without one."""
        return 0.0 if self._pace is None else self._pace.due_in_s

    def pause(self) -> None:
        """Count no overruns of the pace until the next tick."""
        if self._pace is not None:
            self._pace.pause()

    def standing_still(self) -> Standstill | None:
        """Standstill of the pace."""
        return None if self._pace is None else self._pace.standing_still()

    def tick(self) -> Tick:
        """The next point in simulated time, after stepping the physics by one period."""
        late_s = 0.0
        if self._pace is not None:
            late_s = self._pace.tick().late_s
            self.overruns, self.standstill = self._pace.overruns, self._pace.standstill
        self._step()
        self.index += 1
        return Tick(self.index, self.index * self.period_s, late_s)


class SimServos(OwnServos):
    """A MuJoCo hexapod in a world, with or without failed legs.

    Deterministic for the same robot, world, failures, seed, trial and library versions.

    Args:
        world: a World, or the name or path of one, such as `slippery` or `randomised:7`; flat unless given.
        failures: those from the start, one, several or None; `unknown` ones are drawn.
        seed: draws the bumps and calibration errors of the world, an `unknown` failure, and with `trial` the
            sensor noise.
        facing_rad: initial yaw.
        realtime: pace the clock with wall time; otherwise the physics runs as fast as it can.
        events: scheduled failures and healings, counted from `walk_begins`, besides those of the world.
        all_sensors: simulate every sensor, also those that the robot lacks.
    """

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        world: World | str | Path | None = None,
        failures: Failures = (),
        seed: int = 0,
        trial: int = 0,
        facing_rad: float = 0.0,
        realtime: bool = False,
        events: Sequence[FailureEvent] = (),
        all_sensors: bool = False,
    ) -> None:
        super().__init__(robot, SimClock(self._step, WallClock() if realtime else None))
        check_type(all_sensors, bool, "all_sensors")
        if all_sensors:
            self._robot = replace(self._robot, sensors=SENSORS)
        self.world = as_world(world)
        broken = checked_failures(failures, "failures")
        check_type(seed, int, "seed")
        check_type(trial, int, "trial")
        check_type(facing_rad, float, "facing_rad")
        check_type(realtime, bool, "realtime")
        for event in events:
            check_type(event, FailureEvent, "events", "FailureEvents")
        self.events = tuple(sorted((*self.world.events, *events), key=lambda event: event.at_s))
        self._first_failures = tuple(drawn_failure(self._robot, one, seed) for one in broken)
        self.seed = seed
        self.trial = trial
        self.facing_rad = facing_rad
        self._compiled: Simulation | None = None
        self._to_come = FailuresToCome((), 0.0)
        self._push_n, self._push_ticks = np.zeros(3), 0

    @property
    def simulation(self) -> Self:
        """The servos themselves."""
        return self

    @property
    def compiled(self) -> Simulation:
        """The compiled simulation; raises RobotFaultError before `connect`."""
        check_connected(self._compiled is not None, "the simulated robot")
        assert self._compiled is not None  # noqa: S101  narrows the type after the check
        return self._compiled

    def connect(self) -> None:
        """Compile the model and stand the robot on the floor."""
        if self._compiled is None:
            try:
                self._compile()
            except BaseException:
                self._compiled = None
                raise

    def _compile(self) -> None:
        broken = self._first_failures
        compiled = make_simulation(self._robot, self.world, broken, self.seed, facing_rad=self.facing_rad)
        self._compiled = compiled
        self._power = self._make_power()
        self.loss = Losses(self.world.lost_commands, LOST_COMMANDS, self.seed, self.trial)
        data = compiled.physics.data.ptr
        # Views of MuJoCo's own memory: they stay valid and save the wrapper's cost on every tick.
        self._qpos, self._ctrl, self._warnings = data.qpos, data.ctrl, data.warning.number
        self._steps_per_tick = self.world.steps_per_tick
        self._gears = compiled.gears
        self._friction_nm = compiled.physics.model.ptr.dof_frictionloss[FIRST_SPEED:]
        jammed_at_rad = jammed_angles_rad(self._robot, broken)
        self.actuators = ActuatorModel.at_rest(compiled, self._robot.stance_angles_rad, jammed_at_rad)
        self._waiting_rad = waiting_commands(compiled.physics.model, data.history)
        self.actuators.hold(self._waiting_rad)
        torques = JointTorques.of(compiled)
        self.sent_rad = self._robot.stance_angles_rad.copy()
        self.sensors = Sensors.of(
            SensorMemory.of(torques, partial(getattr, data), self.actuators.asked_rad, self.sent_rad),
            torques,
            compiled.joint_offsets_rad,
            measured=self._robot.sensors,
            world=self.world,
            seed=self.seed,
            trial=self.trial,
        )

    @property
    def true_pose(self) -> TruePose | None:
        """True position and orientation of the base; None before `connect`."""
        if self._compiled is None:
            return None
        return self._qpos[:3].copy(), self._qpos[3:FIRST_JOINT].copy()

    def true_state(self) -> RobotState:
        """Pose, angles and contacts as they are, without sensors; raises RobotFaultError before `connect`."""
        touch = self.compiled.physics.data.ptr.sensordata[TOUCH]
        position_world, quaternion_world = self._qpos[:3].copy(), self._qpos[3:FIRST_JOINT].copy()
        return RobotState(
            joint_positions_rad=self._qpos[FIRST_JOINT:].copy(),
            stamp_s=self._clock.now_s,
            measured=True,
            base_position_world=position_world,
            base_quaternion_world=quaternion_world,
            foot_contacts=touch > 0,
        )

    def push(self, force_world_n: FloatArray, duration_s: float) -> None:
        """Push the trunk at its centre of mass with a force, (3,), from the next control period on."""
        check_connected(self._compiled is not None, "the simulated robot")
        self._push_n, self._push_ticks = force_world_n, round(duration_s / self._clock.period_s)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Current failures, by leg; before `connect` those at the start."""
        if self._compiled is None:
            return self._first_failures
        by_leg = self._compiled.failed.by_leg
        return tuple(by_leg[leg] for leg in sorted(by_leg))

    def walk_begins(self) -> None:
        """Set the zero of event times to the next control period."""
        self._to_come = FailuresToCome(self.events, self._clock.period_s)

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        """Let a leg fail, or heal for None, before the next step of the physics.

        A joint sticks at its current angle, and a leg locks at its last targets. Raises RobotFaultError
        before `connect`, InputError for a failure of another leg or an `unknown` one.
        """
        compiled, powered = self.compiled, self._power.on
        FailureEvent(at_s=0.0, leg=leg, failure=failure)  # refuses what cannot be
        self._power.switch(on=True)
        compiled.failed.change(leg, failure)
        self._power = self._make_power()
        self._power.switch(on=powered)
        self.sensors.torques = JointTorques.of(compiled)
        jammed_rad = jam_rad(compiled.failed, self._qpos, self._ctrl)
        self.actuators.leg_changed(leg, jammed_rad, self._ctrl, self._waiting_rad)

    def read(self) -> RobotState:
        """State after the last tick, with the sensor noise of the world."""
        check_connected(self._compiled is not None, "the simulated robot")
        return self.sensors.read(self._clock.now_s)

    def write(self, targets: JointTargets) -> JointTargets:
        """Command the simulated servos; a jammed joint ignores its target."""
        check_connected(self._compiled is not None, "the simulated robot")
        check_targets(targets)
        if not self._power.on:
            self._switch_power(on=True)
        positions = targets.joint_positions_rad
        np.copyto(self.sent_rad, positions)
        plain = self.actuators.plain
        np.copyto(self._ctrl, positions if plain else self.actuators.drive(positions, self.loss.lost))
        return targets

    def disable_torque(self) -> bool:
        """Take the power from the servos until the next targets; the friction of their gears stays."""
        check_connected(self._compiled is not None, "the simulated robot")
        self._switch_power(on=False)
        return True

    def close(self) -> None:
        """Free the simulation."""
        if self._compiled is not None:
            self._compiled.physics.free()
            self._compiled = None
            del self._qpos, self._ctrl, self._warnings, self._waiting_rad, self._friction_nm
            del self.sensors, self._power

    def _make_power(self) -> ServoPower:
        """Switch of the power, initially on, with the current values."""
        model, gear_damping = self.compiled.physics.model, self._robot.servo.gear_damping_nm_s_per_rad
        return ServoPower(model, slice(FIRST_SPEED, None), gear_damping)

    def _switch_power(self, *, on: bool) -> None:
        self._power.switch(on=on)
        self.sensors.torques = JointTorques.of(self.compiled)

    def _step(self) -> None:
        if self._push_ticks:
            self._push_ticks -= 1
            self._apply_push(self._push_n if self._push_ticks else np.zeros(3))
        for event in self._to_come.due():
            self.change_leg(event.leg, event.failure)
        physics, after = self.compiled.physics, self.sensors.steps_after
        self._advance(physics, self._steps_per_tick - after)
        self.sensors.keep()
        if after:
            self._advance(physics, after)
        if self._gears is not None:
            self._friction_nm[:] = self._gears.limit_nm(*self.sensors.memory.servos_now)
        self.sensors.draw()
        self.loss.draw()

    def _apply_push(self, force_world_n: FloatArray) -> None:
        model, data = self.compiled.physics.model.ptr, self.compiled.physics.data.ptr
        data.xfrc_applied[model.jnt_bodyid[0], :3] = force_world_n

    def _advance(self, physics: Any, steps: int) -> None:
        """Step without dm_control's `step`, which takes 7 us more; raises SimulationDivergedError."""
        before = self._warnings.tolist()
        mujoco.mj_step(physics.model.ptr, physics.data.ptr, steps)
        if self._warnings.tolist() != before:
            new = np.flatnonzero(self._warnings != before).tolist()
            names = ", ".join(mujoco.mjtWarning(kind).name for kind in new)
            raise SimulationDivergedError(f"the simulation became unstable: {names}")
