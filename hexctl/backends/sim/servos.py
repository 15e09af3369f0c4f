"""The simulated robot as LegServos: its clock, sensor noise and actuator model."""

import math
from collections import deque
from collections.abc import Callable, Sequence
from typing import Self

import numpy as np

from hexctl.backends.base import LegServos, check_connected, check_targets
from hexctl.backends.clock import Clock, Tick, WallClock
from hexctl.backends.sim.dm import PhysicsError
from hexctl.backends.sim.model import FIRST_JOINT, Simulation, make_simulation
from hexctl.backends.sim.world import SensorNoise, World
from hexctl.errors import SimulationDivergedError
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import N_JOINTS, FloatArray, JointTargets, RobotState


class SimClock(Clock):
    """Makes the next tick come by stepping the physics one period.

    With a pace clock each step waits for the wall, whose overruns it counts; the simulation never skips.
    """

    def __init__(self, step: Callable[[], None], pace: WallClock | None = None) -> None:
        super().__init__()
        self._step = step
        self._pace = pace
        self._index = 0

    @property
    def now_s(self) -> float:
        """Return the simulated time."""
        return self._index * self.period_s

    @property
    def due_in_s(self) -> float:
        """Return how long the pace will wait before the next step; 0 without one."""
        return 0.0 if self._pace is None else self._pace.due_in_s

    def rest(self) -> None:
        """Count no overruns of the pace for the time until the next tick."""
        if self._pace is not None:
            self._pace.rest()

    def tick(self) -> Tick:
        """Step the physics by one period and return the new point in simulated time."""
        late_s = 0.0
        if self._pace is not None:
            late_s = self._pace.tick().late_s
            self.overruns = self._pace.overruns
        self._step()
        self._index += 1
        return Tick(self._index, self._index * self.period_s, late_s)


N_DRAWS = N_JOINTS + 4


class Noise:
    """A seeded stream of measurement errors: 18 joints, 3 of position, 1 of yaw."""

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
        """Return the errors of the joint angles, (18,)."""
        return self._errors[:N_JOINTS]

    @property
    def position_m(self) -> FloatArray:
        """Return the error of the base position, (3,)."""
        return self._errors[N_JOINTS:-1]

    def turned(self, quaternion: FloatArray) -> FloatArray:
        """Return orientations (..., 4) turned about the vertical by the yaw error."""
        cos, sin = math.cos(self._errors[-1] / 2), math.sin(self._errors[-1] / 2)
        w, x, y, z = (quaternion[..., index] for index in range(4))
        return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


class ActuatorModel:
    """Turns the targets of each tick into what the actuators are told; one robot's, or n robots' at once.

    The play is the hysteresis of a loose gear: the shaft rests until the servo has crossed the play, and then
    follows it by half of it behind.

    Attributes:
        plain: whether targets reach the actuators as they are.
    """

    def __init__(self, simulation: Simulation, shaft_rad: FloatArray, late_rad: Sequence[FloatArray]) -> None:
        """Take over where the shafts are and which targets are still on their way, oldest first."""
        self._simulation = simulation
        self._half_play_rad = math.radians(simulation.world.servo_backlash_deg) / 2
        self._shaft_rad = shaft_rad
        self._late_rad = deque(late_rad)
        self.plain = not (
            simulation.jammed.any()
            or simulation.joint_offsets_rad.any()
            or self._late_rad
            or self._half_play_rad
        )

    @classmethod
    def at_rest(cls, simulation: Simulation, stance_rad: FloatArray) -> Self:
        """Return the train of a robot that has stood in its stance for a while."""
        late_rad = [stance_rad] * simulation.world.delay_ticks
        return cls(simulation, stance_rad + simulation.joint_offsets_rad, late_rad)

    def copies(self, n: int) -> "ActuatorModel":
        """Return the train of n robots that stand where this one stands; it takes (n, 18)."""
        late_rad = [np.tile(positions_rad, (n, 1)) for positions_rad in self._late_rad]
        return ActuatorModel(self._simulation, np.tile(self._shaft_rad, (n, 1)), late_rad)

    def drive(self, positions_rad: FloatArray) -> FloatArray:
        """Return what the actuators get in a tick for its joint targets, (18,) or (n, 18)."""
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

    Deterministic for the same robot, world, failure, seed, trial and library versions: the seed draws the
    world, bumps and calibration errors included, and with the trial's number the noise of its sensors.
    `facing_rad` is the yaw in which it is put down. With `realtime` the clock waits for the wall; otherwise
    physics runs as fast as it can.
    """

    injects_failure = True

    def __init__(
        self,
        robot: Robot,
        *,
        world: World | None = None,
        failure: Failure | None = None,
        seed: int = 0,
        trial: int = 0,
        facing_rad: float = 0.0,
        realtime: bool = False,
    ) -> None:
        self._robot = robot
        self.world = world or World()
        self.failure = failure
        self.seed = seed
        self.trial = trial
        self.facing_rad = facing_rad
        self._clock = SimClock(self._step, WallClock() if realtime else None)
        self._simulation: Simulation | None = None
        self._limp = False

    @property
    def robot(self) -> Robot:
        """Return the simulated robot."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """Return the clock that steps the physics."""
        return self._clock

    @property
    def simulation(self) -> Simulation:
        """Return the compiled simulation.

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
        data = simulation.physics.data.ptr
        # Views of MuJoCo's own memory: they stay valid and save the wrapper's cost on every tick.
        self._qpos, self._ctrl, self._touch = data.qpos, data.ctrl, data.sensordata
        self.train = ActuatorModel.at_rest(simulation, self._robot.stance_angles_rad)
        self._offsets_rad = simulation.joint_offsets_rad if simulation.joint_offsets_rad.any() else None

    def read(self) -> RobotState:
        """Return the state after the last tick, with the world's sensor noise."""
        check_connected(self._simulation is not None, "the simulated robot")
        qpos = self._qpos.copy()
        joints, position, quaternion = qpos[FIRST_JOINT:], qpos[:3], qpos[3:FIRST_JOINT]
        if self._offsets_rad is not None:
            joints = joints - self._offsets_rad
        if not self.noise.silent:
            joints = joints + self.noise.joints_rad
            position = position + self.noise.position_m
            quaternion = self.noise.turned(quaternion)
        now_s = self._clock.now_s
        return RobotState(joints, now_s, True, position, quaternion, self._touch > 0)

    def write(self, targets: JointTargets) -> JointTargets:
        """Give the targets to the simulated servos; a jammed joint ignores them."""
        check_connected(self._simulation is not None, "the simulated robot")
        check_targets(targets)
        if self._limp:
            self._set_springs(1.0)
        positions = targets.positions_rad
        np.copyto(self._ctrl, positions if self.train.plain else self.train.drive(positions))
        return targets

    def relax(self) -> bool:
        """Take the springs out of the servos until the next targets; their damping stays."""
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
        try:
            self.simulation.physics.step(self.world.steps_per_tick)
        except PhysicsError as error:
            raise SimulationDivergedError(f"the simulation became unstable: {error}") from error
        self.noise.draw()
