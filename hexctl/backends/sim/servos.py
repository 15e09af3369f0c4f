"""The simulated robot as LegServos."""

import numpy as np

from hexctl.backends.base import LegServos
from hexctl.backends.checks import check_connected, check_targets
from hexctl.backends.clock import Clock, WallClock
from hexctl.backends.sim.clock import SimClock
from hexctl.backends.sim.dm import PhysicsError
from hexctl.backends.sim.noise import Noise
from hexctl.backends.sim.physics import FIRST_JOINT, Simulation, make_simulation
from hexctl.backends.sim.train import ServoTrain
from hexctl.backends.sim.world import World
from hexctl.errors import SimulationDivergedError
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import JointTargets, RobotState


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
        self.train = ServoTrain.at_rest(simulation, self._robot.stance_angles_rad)
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
