"""Measurements of a simulated robot: torques, errors, age and losses."""

import copy
import math
from collections import deque
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from hexctl.backends.sim.flaws import SensorFaults, SensorNoise
from hexctl.backends.sim.simulated_failure import FIRST_SPEED
from hexctl.backends.sim.simulation_model import FIRST_JOINT, TOUCH, Simulation
from hexctl.backends.sim.world import World
from hexctl.robot.rotations import components
from hexctl.robot.sensors import Sensor
from hexctl.types import N_JOINTS, ArrayFields, BoolArray, FloatArray, RobotState

#: Index of the base's angular velocity in MuJoCo's velocities, about the axes of the base.
FIRST_TURN = 3

#: A back-EMF below this is a rounding error.
LEAST_BACK_EMF = 1e-12

#: Random numbers per tick: 18 joints, 3 of position, 1 of yaw.
N_DRAWS = N_JOINTS + 4


class Noise:
    """A seeded stream of measurement errors, drawn once per tick so that every reader sees the same."""

    def __init__(self, sigma: SensorNoise, seed: int, trial: int = 0) -> None:
        # A separate stream from those of the bumps and of the joint offsets.
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
        return turned(quaternion, self._errors[-1])


def turned(quaternion: FloatArray, angle_rad: float) -> FloatArray:
    """Orientations (..., 4) turned about the vertical."""
    cos, sin = math.cos(angle_rad / 2), math.sin(angle_rad / 2)
    w, x, y, z = components(quaternion)
    return np.stack([cos * w - sin * z, cos * x - sin * y, cos * y + sin * x, cos * z + sin * w], axis=-1)


class FaultyPose:
    """Position and orientation as faulty sensors show them, tick by tick."""

    def __init__(self, faults: SensorFaults) -> None:
        self._faults, self.none = faults, faults == SensorFaults()
        self._frozen: dict[tuple[float, float], tuple[FloatArray, FloatArray]] = {}

    def seen(
        self, position: FloatArray, quaternion: FloatArray, stamp_s: float, *, tracked: bool
    ) -> tuple[FloatArray, FloatArray]:
        """Displayed positions (..., 3) and orientations (..., 4) of the true ones at a time.

        Only a `tracked` pose freezes, not the orientation of an IMU alone.
        """
        faults = self._faults
        if faults.yaw_drift_deg_per_min:
            quaternion = turned(quaternion, math.radians(faults.yaw_drift_deg_per_min) * stamp_s / 60)
        if _in_force(faults.position_jump_s, stamp_s):
            position = position + np.array(faults.position_jump_m)
        # Each current interval has the pose of its beginning.
        now = _in_force(faults.pose_frozen_s, stamp_s) if tracked else []
        self._frozen = {interval: self._frozen.get(interval, (position, quaternion)) for interval in now}
        if not now:
            return position, quaternion
        first, second = self._frozen[max(now)]
        return np.broadcast_to(first, position.shape), np.broadcast_to(second, quaternion.shape)


def _in_force(intervals: Sequence[tuple[float, float]], time_s: float) -> list[tuple[float, float]]:
    return [(first_s, last_s) for first_s, last_s in intervals if first_s <= time_s < last_s]


#: Streams of lost commands and poses: bumps have 0, joint offsets 1, noise 2, unknown failures 4.
LOST_COMMANDS, LOST_POSES = 3, 5


class Losses:
    """A seeded stream of lost control periods, drawn once per tick."""

    def __init__(self, share: float, stream: int, seed: int, trial: int = 0) -> None:
        self._stream = np.random.default_rng([seed, stream, trial])
        self._share = share
        self.lost = False

    def draw(self) -> None:
        """Draw the loss of the next tick."""
        if self._share:
            self.lost = bool(self._stream.random() < self._share)


@dataclass(frozen=True, slots=True, eq=False)
class JointTorques(ArrayFields):
    """Torques of the servos on the joints of simulated robots, averaged over a control period.

    A servo applies MuJoCo's actuator force less its back-EMF, which is simulated as joint damping. Friction
    and damping of its gears are not subtracted. Joints of a missing leg have no torque. A stuck joint's servo
    pushes against the jam: stiffness times error, up to its limit.

    Attributes:
        steps: steps of the physics in a control period.
        driven: joints that a servo drives, (18,); None for all.
        stuck: joints whose servos push against a jam, (18,); None for none.
        stiffness_nm_per_rad: of the servos, (18,).
        limit_nm: of the servos, (18,).
        back_emf_nm_s_per_rad: torque lost per speed, (18,); None for none.
    """

    steps: int
    driven: BoolArray | None
    stuck: BoolArray | None
    stiffness_nm_per_rad: FloatArray
    limit_nm: FloatArray
    back_emf_nm_s_per_rad: FloatArray | None

    @classmethod
    def of(cls, simulation: Simulation) -> Self:
        """Torques of a simulation; its failed legs may change them."""
        failed = simulation.failed
        driven, stuck = failed.driven, failed.stiff
        lost = np.array(simulation.physics.model.dof_damping[FIRST_SPEED:]) - failed.gear_damping_nm_s_per_rad
        back_emf = np.where(lost > LEAST_BACK_EMF, lost, 0.0)
        steps = simulation.world.steps_per_tick
        return cls(
            steps,
            None if driven.all() else driven,
            stuck if stuck.any() else None,
            *failed.servo_springs,
            back_emf if back_emf.any() else None,
        )

    def forces_in(self, history: FloatArray) -> FloatArray:
        """View of the forces in MuJoCo's memory, leading shape + (18, steps).

        The memory ends with 18 * (2 + 2 * steps) numbers of the sensors: for each actuator two numbers, then
        a time and a force for each of the last steps. Before them are the delayed commands.
        """
        sensed = history[..., -N_JOINTS * (2 + 2 * self.steps) :]
        rows = sensed.reshape(*history.shape[:-1], N_JOINTS, 2 + 2 * self.steps)
        return rows[..., 2 + self.steps :]

    def applied(
        self, forces_nm: FloatArray, qvel: FloatArray, qpos: FloatArray, asked_rad: FloatArray
    ) -> FloatArray:
        """Torques over the last period, leading shape + (18,), with the speed at its end.

        Shapes are leading shape + (24,) of `qvel`, (25,) of `qpos` and (18,) of the servos' targets.
        """
        torques: FloatArray = np.add.reduce(forces_nm, axis=-1)
        torques /= self.steps
        if self.back_emf_nm_s_per_rad is not None:
            torques -= self.back_emf_nm_s_per_rad * qvel[..., FIRST_SPEED:]
        if self.driven is not None:
            torques *= self.driven
        if self.stuck is not None:
            pushed = self.stiffness_nm_per_rad * (asked_rad - qpos[..., -N_JOINTS:])
            torques = np.where(self.stuck, np.clip(pushed, -self.limit_nm, self.limit_nm), torques)
        return torques


@dataclass(frozen=True, slots=True, eq=False)
class Snapshot(ArrayFields):
    """Measurements of one moment.

    Attributes:
        qpos: base position, base quaternion and 18 joints, leading shape + (25,).
        touch: foot forces, leading shape + (6,).
        torques_nm: of the actuators, leading shape + (18,).
        qvel: velocities of the base in the world and about its own axes, and joints, leading shape + (24,).
    """

    qpos: FloatArray
    touch: FloatArray
    torques_nm: FloatArray
    qvel: FloatArray

    def copies(self, n: int) -> "Snapshot":
        """The same for n robots."""
        return Snapshot(*(np.tile(getattr(self, field.name), (n, 1)) for field in fields(self)))


@dataclass(frozen=True, slots=True, eq=False)
class SensorMemory(ArrayFields):
    """Views of MuJoCo's own memory, updated by each step; leading shape () or (n,).

    Attributes:
        qpos: positions, leading shape + (25,).
        qvel: velocities, leading shape + (24,).
        touch: foot forces, leading shape + (6,).
        servos_now: forces and speeds of the actuators after the last step, leading shape + (18,) each.
        forces_nm: of the actuators in the last steps, as `JointTorques.forces_in` has them.
        asked_rad: targets of the servos, leading shape + (18,); of the actuator model.
        sent_rad: last targets, leading shape + (18,), which servos without sensors echo.
    """

    qpos: FloatArray
    qvel: FloatArray
    touch: FloatArray
    servos_now: tuple[FloatArray, FloatArray]
    forces_nm: FloatArray
    asked_rad: FloatArray
    sent_rad: FloatArray

    @classmethod
    def of(
        cls,
        torques: JointTorques,
        view: Callable[[str], FloatArray],
        asked_rad: FloatArray,
        sent_rad: FloatArray,
    ) -> Self:
        """Views from a function that returns those of `MjData` by name."""
        forces_nm, qvel, sensed = torques.forces_in(view("history")), view("qvel"), view("sensordata")
        now = sensed[..., :N_JOINTS], qvel[..., FIRST_SPEED:]
        return cls(view("qpos"), qvel, sensed[..., TOUCH], now, forces_nm, asked_rad, sent_rad)


@dataclass(slots=True, eq=False)
class Sensors:
    """Sensors of one simulated robot, or of n copies of one, with their flaws.

    Attributes:
        torques: a leg that fails changes it.
        offsets_rad: calibration errors of the joints, (18,).
        measured: sensors that the robot has; a trunk on a stand, which does not follow the legs, has no pose.
        age_s: of a state when it is read.
        steps_after: steps of the physics between the measurement and the end of a tick.
        late: delayed states, the oldest first, which is read; None without delay.
    """

    memory: SensorMemory
    torques: JointTorques
    offsets_rad: FloatArray
    noise: Noise
    faulty_pose: FaultyPose
    pose_loss: Losses
    measured: frozenset[str]
    age_s: float = 0.0
    steps_after: int = 0
    late: deque[Snapshot] | None = None

    @classmethod
    def of(
        cls,
        memory: SensorMemory,
        torques: JointTorques,
        offsets_rad: FloatArray,
        *,
        measured: Collection[Sensor],
        world: World,
        seed: int,
        trial: int,
    ) -> Self:
        """Sensors of a robot in a world; seed and trial number determine noise and losses."""
        noise = Noise(world.sensor_noise, seed, trial)
        pose_loss = Losses(world.lost_poses, LOST_POSES, seed, trial)
        own = frozenset(measured) - ({"imu", "position"} if world.on_stand else set())
        faulty_pose = FaultyPose(world.sensor_faults)
        sensors = cls(memory, torques, offsets_rad, noise, faulty_pose, pose_loss, own)
        if world.latency_steps:
            sensors.age_s = world.latency_steps * world.time_step_s
            whole_ticks, sensors.steps_after = divmod(world.latency_steps, world.steps_per_tick)
            sensors.late = deque([sensors._snapshot()] * (whole_ticks + 1), maxlen=whole_ticks + 1)
        return sensors

    def copies(self, memory: SensorMemory, n: int) -> "Sensors":
        """Sensors of n robots in this state, with the same future errors and losses."""
        late = None if self.late is None else deque([one.copies(n) for one in self.late], self.late.maxlen)
        return replace(
            self,
            memory=memory,
            noise=copy.deepcopy(self.noise),
            faulty_pose=copy.deepcopy(self.faulty_pose),
            pose_loss=copy.deepcopy(self.pose_loss),
            late=late,
        )

    def keep(self) -> None:
        """Measure a state for later reads, once per tick."""
        if self.late is not None:
            self.late.append(self._snapshot())

    def draw(self) -> None:
        """Draw the errors and the loss of the next tick."""
        self.noise.draw()
        self.pose_loss.draw()

    def read(self, now_s: float) -> RobotState:
        """State that the robots report at a time."""
        noise, stamp_s = self.noise, now_s - self.age_s
        seen = self._snapshot() if self.late is None else self.late[0]
        joints = seen.qpos[..., FIRST_JOINT:] - self.offsets_rad
        position, quaternion = seen.qpos[..., :3], seen.qpos[..., 3:FIRST_JOINT]
        if not noise.silent:
            joints = joints + noise.joints_rad
            position = position + noise.position_m
            quaternion = noise.turned(quaternion)
        own = self.measured
        tracked = "position" in own
        if not self.faulty_pose.none:
            position, quaternion = self.faulty_pose.seen(position, quaternion, stamp_s, tracked=tracked)
        pose_lost = tracked and self.pose_loss.lost
        turns = not pose_lost and not own.isdisjoint({"imu", "position"})
        echoes = "joint_positions" not in own
        return RobotState(
            self.memory.sent_rad.copy() if echoes else joints,
            stamp_s,
            not echoes,
            position if tracked and not pose_lost else None,
            quaternion if turns else None,
            seen.touch > 0 if "foot_contacts" in own else None,
            self.age_s,
            joint_torques_nm=seen.torques_nm if "joint_loads" in own else None,
            joint_velocities_rad_s=seen.qvel[..., FIRST_SPEED:] if "joint_velocities" in own else None,
            angular_velocity_body_rad_s=seen.qvel[..., FIRST_TURN:FIRST_SPEED] if "imu" in own else None,
        )

    def _snapshot(self) -> Snapshot:
        memory = self.memory
        torques_nm = self.torques.applied(memory.forces_nm, memory.qvel, memory.qpos, memory.asked_rad)
        return Snapshot(memory.qpos.copy(), memory.touch.copy(), torques_nm, memory.qvel.copy())
