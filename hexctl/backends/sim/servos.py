"""The simulated robot as LegServos: its clock, sensor noise and actuator model."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Self

import numpy as np

from hexctl.backends.base import LegServos, as_robot, check_connected, check_targets
from hexctl.backends.clock import Clock, Tick, WallClock
from hexctl.backends.sim.dm import PhysicsError
from hexctl.backends.sim.model import FIRST_JOINT, Simulation, make_simulation
from hexctl.backends.sim.world import SensorNoise, World, as_world
from hexctl.errors import SimulationDivergedError, check_type
from hexctl.robot.failure import Failure, drawn_failure
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, ArrayFields, FloatArray, JointTargets, RobotState

#: Random numbers per tick: 18 joints, 3 of position, 1 of yaw.
N_DRAWS = N_JOINTS + 4


class SimClock(Clock):
    """Advances by stepping the physics: one control period per tick.

    With a pace clock each step waits for the wall, whose overruns it counts; the simulation never skips.
    """

    def __init__(self, step: Callable[[], None], pace: WallClock | None = None) -> None:
        super().__init__()
        self._step = step
        self._pace = pace
        self._index = 0

    @property
    def now_s(self) -> float:
        """Simulated time."""
        return self._index * self.period_s

    @property
    def due_in_s(self) -> float:
        """How long the pace will wait before the next step; 0 without one."""
        return 0.0 if self._pace is None else self._pace.due_in_s

    def pause(self) -> None:
        """Count no overruns of the pace for the time until the next tick."""
        if self._pace is not None:
            self._pace.pause()

    def tick(self) -> Tick:
        """The next point in simulated time, after stepping the physics by one period."""
        late_s = 0.0
        if self._pace is not None:
            late_s = self._pace.tick().late_s
            self.overruns = self._pace.overruns
        self._step()
        self._index += 1
        return Tick(self._index, self._index * self.period_s, late_s)


class Noise:
    """A seeded stream of measurement errors, drawn once per tick so that every reader sees the same.

    Attributes:
        silent: whether all errors are zero.
    """

    def __init__(self, sigma: SensorNoise, seed: int, trial: int = 0) -> None:
        # A stream of its own beside those of the bumps and of the joint offsets.
        self._stream = np.random.default_rng([seed, 2, trial])
        self._scale = np.array(
            [math.radians(sigma.joint_deg)] * N_JOINTS
            + [sigma.position_m] * 3
            + [math.radians(sigma.yaw_deg)]
        )
        self.silent = not self._scale.any()
        self._errors = np.zeros(N_DRAWS)

    def draw(self) -> None:
        """Draw the errors of the next tick."""
        if not self.silent:
            self._errors = self._stream.standard_normal(N_DRAWS) * self._scale

    @property
    def joints_rad(self) -> FloatArray:
        """Errors of the joint angles, (18,)."""
        return self._errors[:N_JOINTS]

    @property
    def position_m(self) -> FloatArray:
        """Error of the base position, (3,)."""
        return self._errors[N_JOINTS:-1]

    def turned(self, quaternion: FloatArray) -> FloatArray:
        """Orientations (..., 4) turned about the vertical by the yaw error."""
        cos, sin = math.cos(self._errors[-1] / 2), math.sin(self._errors[-1] / 2)
        w, x, y, z = (quaternion[..., index] for index in range(4))
        return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


class CommandLoss:
    """A seeded stream of which control periods lose their command, drawn once per tick.

    Attributes:
        lost: whether a command of this period is lost.
    """

    def __init__(self, share: float, seed: int, trial: int = 0) -> None:
        # A stream of its own beside those of the bumps, of the joint offsets and of the noise.
        self._stream = np.random.default_rng([seed, 3, trial])
        self._share = share
        self.lost = False

    def draw(self) -> None:
        """Draw the loss of the next tick."""
        if self._share:
            self.lost = bool(self._stream.random() < self._share)


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot(ArrayFields):
    """What is measured at one moment: qpos, leading shape + (25,), and foot forces, leading shape + (6,)."""

    qpos: FloatArray
    touch: FloatArray


class LateStates:
    """States on their way to the reader: each is `latency_steps` steps of the physics old when it is read.

    Attributes:
        steps_after: steps of the physics that follow the moment of measurement within a tick.
    """

    def __init__(self, world: World, now: Snapshot, on_their_way: Sequence[Snapshot] = ()) -> None:
        whole_ticks, self.steps_after = divmod(world.latency_steps, world.steps_per_tick)
        self._latest = deque(on_their_way or [now] * (whole_ticks + 1), maxlen=whole_ticks + 1)

    def keep(self, now: Snapshot) -> None:
        """Measure, once per tick."""
        self._latest.append(now)

    @property
    def oldest(self) -> Snapshot:
        """The state that is read."""
        return self._latest[0]

    def copies(self, world: World, n: int) -> "LateStates":
        """The states of n robots in the state of this one."""
        rows = [Snapshot(np.tile(one.qpos, (n, 1)), np.tile(one.touch, (n, 1))) for one in self._latest]
        return LateStates(world, rows[-1], rows)


class ActuatorModel:
    """From joint targets to actuator commands: loss, delay, calibration error, backlash and jammed joints.

    For one robot, or for n robots together. Backlash is a hysteresis: the shaft stands still until the servo
    has crossed the play, and then follows it half the play behind.

    Attributes:
        plain: whether targets reach the actuators unchanged.
    """

    def __init__(
        self,
        simulation: Simulation,
        heard_rad: FloatArray,
        shaft_rad: FloatArray,
        late_rad: Sequence[FloatArray],
    ) -> None:
        """Begin with the targets heard last, given shaft angles and the delayed targets, oldest first."""
        self._simulation = simulation
        self._heard_rad = heard_rad
        self._half_play_rad = math.radians(simulation.world.servo_backlash_deg) / 2
        self._shaft_rad = shaft_rad
        self._late_rad = deque(late_rad)
        self.plain = not (
            simulation.jammed.any()
            or simulation.joint_offsets_rad.any()
            or self._late_rad
            or self._half_play_rad
            or simulation.world.lost_commands
        )

    @classmethod
    def at_rest(cls, simulation: Simulation, stance_rad: FloatArray) -> Self:
        """The model of a robot that has stood in its stance for longer than the delay."""
        late_rad = [stance_rad] * simulation.world.delay_ticks
        return cls(simulation, stance_rad, stance_rad + simulation.joint_offsets_rad, late_rad)

    def copies(self, n: int) -> "ActuatorModel":
        """The model of n robots in the state of this one; it takes targets (n, 18)."""
        late_rad = [np.tile(positions_rad, (n, 1)) for positions_rad in self._late_rad]
        heard_rad, shaft_rad = np.tile(self._heard_rad, (n, 1)), np.tile(self._shaft_rad, (n, 1))
        return ActuatorModel(self._simulation, heard_rad, shaft_rad, late_rad)

    def drive(self, positions_rad: FloatArray, lost: bool = False) -> FloatArray:
        """Actuator commands of one tick for its joint targets, (18,) or (n, 18), which may be lost."""
        if lost:
            positions_rad = self._heard_rad
        elif self._simulation.world.lost_commands:
            self._heard_rad = positions_rad.copy()
        if self._late_rad:
            self._late_rad.append(positions_rad.copy())
            positions_rad = self._late_rad.popleft()
        shaft_rad = positions_rad + self._simulation.joint_offsets_rad
        if self._half_play_rad:
            shaft_rad = np.clip(
                self._shaft_rad, shaft_rad - self._half_play_rad, shaft_rad + self._half_play_rad
            )
            self._shaft_rad = shaft_rad
        return np.where(self._simulation.jammed, self._simulation.jammed_at_rad, shaft_rad)


class SimServos(LegServos):
    """A MuJoCo hexapod in a world, with a failed leg if one is given.

    Deterministic for the same robot, world, failure, seed, trial and library versions.

    Args:
        robot: the robot, or the name or path of its file.
        world: a World, or the name or path of one, such as `slippery` or `randomised:7`; flat unless given.
        failure: the failed leg, or None; the attribute is what breaks, also where an `unknown` one is given.
        seed: draws the bumps and calibration errors of the world, what an `unknown` failure breaks, and with
            `trial` the sensor noise.
        trial: number of the trial.
        facing_rad: yaw in which the robot is put down.
        realtime: pace the clock with wall time; otherwise the physics runs as fast as it can.
    """

    injects_failure = True

    def __init__(
        self,
        robot: Robot | str | Path,
        *,
        world: World | str | Path | None = None,
        failure: Failure | None = None,
        seed: int = 0,
        trial: int = 0,
        facing_rad: float = 0.0,
        realtime: bool = False,
    ) -> None:
        self._robot = as_robot(robot)
        self.world = as_world(world)
        check_type(failure, (Failure, type(None)), "failure", "a Failure, as Failure(leg=5), or None")
        check_type(seed, int, "seed")
        check_type(trial, int, "trial")
        check_type(facing_rad, float, "facing_rad")
        check_type(realtime, bool, "realtime")
        self.failure = drawn_failure(self._robot, failure, seed)
        self.seed = seed
        self.trial = trial
        self.facing_rad = facing_rad
        self._clock = SimClock(self._step, WallClock() if realtime else None)
        self._simulation: Simulation | None = None
        self._limp = False

    @property
    def robot(self) -> Robot:
        """The simulated robot."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """The clock that steps the physics."""
        return self._clock

    @property
    def simulation(self) -> Simulation:
        """The compiled simulation.

        Raises RobotFaultError before `connect`.
        """
        check_connected(self._simulation is not None, "the simulated robot")
        assert self._simulation is not None  # noqa: S101  narrows the type after the check
        return self._simulation

    def connect(self) -> None:
        """Compile the model and stand the robot on the floor."""
        if self._simulation is not None:
            return
        simulation = make_simulation(
            self._robot, self.world, self.failure, self.seed, facing_rad=self.facing_rad
        )
        self._simulation = simulation
        self._limp = False
        model = simulation.physics.model
        self._springs = [(model.actuator_gainprm[:, 0], model.actuator_gainprm[:, 0].copy())]
        self._springs += [(model.actuator_biasprm[:, 1], model.actuator_biasprm[:, 1].copy())]
        self.noise = Noise(self.world.sensor_noise, self.seed, self.trial)
        self.loss = CommandLoss(self.world.lost_commands, self.seed, self.trial)
        data = simulation.physics.data.ptr
        # Views of MuJoCo's own memory: they stay valid and save the wrapper's cost on every tick.
        self._qpos, self._ctrl, self._touch = data.qpos, data.ctrl, data.sensordata
        self.late = LateStates(self.world, self._measured()) if self.world.latency_steps else None
        self.actuators = ActuatorModel.at_rest(simulation, self._robot.stance_angles_rad)
        self._offsets_rad = simulation.joint_offsets_rad if simulation.joint_offsets_rad.any() else None

    def read(self) -> RobotState:
        """State after the last tick, with the sensor noise of the world."""
        check_connected(self._simulation is not None, "the simulated robot")
        measured = self._measured() if self.late is None else self.late.oldest
        qpos = measured.qpos
        joints, position, quaternion = qpos[FIRST_JOINT:], qpos[:3], qpos[3:FIRST_JOINT]
        if self._offsets_rad is not None:
            joints = joints - self._offsets_rad
        if not self.noise.silent:
            joints = joints + self.noise.joints_rad
            position = position + self.noise.position_m
            quaternion = self.noise.turned(quaternion)
        age_s = self.world.latency_steps * self.world.time_step_s
        stamp_s = self._clock.now_s - age_s
        return RobotState(joints, stamp_s, True, position, quaternion, measured.touch > 0, age_s)

    def write(self, targets: JointTargets) -> JointTargets:
        """Command the simulated servos; a jammed joint ignores its target."""
        check_connected(self._simulation is not None, "the simulated robot")
        check_targets(targets)
        if self._limp:
            self._set_springs(1.0)
        positions = targets.positions_rad
        plain = self.actuators.plain
        np.copyto(self._ctrl, positions if plain else self.actuators.drive(positions, self.loss.lost))
        return targets

    def disable_torque(self) -> bool:
        """Set the stiffness of the servos to zero until the next targets; their damping stays."""
        check_connected(self._simulation is not None, "the simulated robot")
        self._set_springs(0.0)
        return True

    def close(self) -> None:
        """Free the simulation."""
        if self._simulation is not None:
            self._simulation.physics.free()
            self._simulation = None
            del self._qpos, self._ctrl, self._touch, self._springs

    def _set_springs(self, share: float) -> None:
        for in_force, whole in self._springs:
            in_force[:] = share * whole
        self._limp = share == 0

    def _step(self) -> None:
        """Step the physics by one control period."""
        physics, after = self.simulation.physics, 0
        try:
            if self.late is not None:
                after = self.late.steps_after
                physics.step(self.world.steps_per_tick - after)
                self.late.keep(self._measured())
            if after or self.late is None:
                physics.step(after or self.world.steps_per_tick)
        except PhysicsError as error:
            raise SimulationDivergedError(f"the simulation became unstable: {error}") from error
        self.noise.draw()
        self.loss.draw()

    def _measured(self) -> Snapshot:
        """What is measured now, without errors."""
        return Snapshot(self._qpos.copy(), self._touch.copy())
