"""Moves a robot as ROS commands: on the robot's thread, under its own lease, through the guard."""

from collections.abc import Callable
from typing import Any

import numpy as np

from hexctl.control.drive.arbiter import Arbiter, Velocity
from hexctl.control.drive.drive_controller import DriveController
from hexctl.control.guard import Guard
from hexctl.control.monitor.recovery import default_recovery, make_recovery
from hexctl.errors import CommandRefusedError, EStopError, HexctlError, RobotFaultError
from hexctl.gait.body_pose import LEVEL, BodyPose
from hexctl.server.idle import IdleSupervisor
from hexctl.server.leases import Lease
from hexctl.server.requests import RequestHandler
from hexctl.server.ros.settings import LiveSettings
from hexctl.types import FloatArray, RobotState
from hexctl.wire.ros.motion_commands import Called, RosCommand, Service, WantedJoints, WantedVelocity
from hexctl.wire.stop import ESTOP, OVER_ROS

#: The lease of ROS, and a velocity, expire after this silence.
EXPIRY_OF_ROS_S = 0.5

#: Poses that differ by at most this, in rad, are equal.
SAME_RAD = 1e-6

#: Velocities in m/s and rad/s are clipped to these, and smaller ones are zero, to keep squares finite.
FASTEST, SLOWEST = 100.0, 1e-6

#: Writes joint angles (18,) through the guard; the second argument is the time of the request.
Write = Callable[[FloatArray, float], None]


class RosDriver:
    """Follows velocities, body poses and joint angles from ROS, stands up and sits down.

    A velocity or a new body pose makes the robot stand up, if necessary, and walk or lean. After
    `EXPIRY_OF_ROS_S` without a velocity it stops walking and gives its lease back; a zero velocity stops it
    sooner. Joint angles are passed on; while they come, the others are refused. Another controller's lease,
    and a stop, refuse them all. Changed settings hold from the next control period on.
    """

    def __init__(
        self, guard: Guard, requests: RequestHandler, idle: IdleSupervisor, write: Write, live: LiveSettings
    ) -> None:
        self._guard, self._requests, self._idle, self._write = guard, requests, idle, write
        self._live, self._applied = live, live.now
        self._gait = live.now.gait_of(guard.robot)
        self._time = guard.clock.time
        self._arbiter = Arbiter(self._time.now, expiry_s=EXPIRY_OF_ROS_S)
        self._source = self._arbiter.source("cmd_vel")
        self._lease: Lease | None = None
        self._zero_index: int | None = None
        self._pilot: DriveController | None = None
        self._sent_rad: FloatArray | None = None
        self._next_step = 0
        self._joints_until_s = -EXPIRY_OF_ROS_S
        self._sits = False
        self._pose = LEVEL
        self._refused = 0
        self._new_pilot(guard.robot.stance_angles_rad)  # limits of its gait take a second, once
        self._pilot = None

    def status(self) -> dict[str, Any]:
        """Motion (`none`, `joints`, or the mode of a drive), and the share of the body pose within reach."""
        motion = "joints" if self._time.now() <= self._joints_until_s else "none"
        if self._pilot is not None and self._lease is not None:
            motion = self._pilot.mode
        reached = 1.0 if self._pilot is None else self._pilot.pose_share
        return {"motion": motion, "refused": self._refused, "pose_share": reached}

    def obey(self, command: RosCommand, at_s: float) -> None:
        """Take a command that arrived at `at_s` by the robot's time source."""
        if isinstance(command, Called):
            command.answer(*self._answer(command.service, at_s))
        else:
            try:
                if isinstance(command, WantedVelocity):
                    self._follow(command.velocity, at_s)
                elif isinstance(command, BodyPose):
                    self._lean(command, at_s)
                else:
                    self._pass(command, at_s)
            except HexctlError:
                self._refused += 1

    def tick(self, index: int, state: RobotState) -> None:
        """Write the targets of control period `index` of the guard's clock, if ROS moves the robot."""
        if self._live.now is not self._applied:
            self._apply()
        if self._guard.stopped == ESTOP:
            self._drop()
        if self._lease is None or self._pilot is None:
            return
        now_s = self._time.now()
        if not self._requests.is_current(self._lease, now_s) or self._guard.stopped is not None:
            self._drop()
            return
        pilot = self._pilot
        if self._zero_index is None:  # steps continue after a rest of any length
            self._zero_index = index - self._next_step
        self._next_step = index - self._zero_index + 1
        targets_rad = pilot.targets_rad(index - self._zero_index, state)
        try:
            self._write(targets_rad, now_s)
        except (CommandRefusedError, EStopError, RobotFaultError):
            self._drop()
            return
        self._sent_rad = self._guard.accepted_rad().copy()
        if self._sits and pilot.mode == "sitting":
            self._release()
            self._drop()
            self._idle.go_limp()
        elif pilot.at_rest and not self._sits and self._source.desired(now_s) is None:
            self._release()
        else:
            self._lease = self._requests.leases.renew(self._lease.lease_id, now_s, EXPIRY_OF_ROS_S)

    def _apply(self) -> None:
        settings = self._applied = self._live.now
        self._idle.sit_after_s = settings.sit_after_s
        self._gait = settings.gait_of(self._guard.robot)
        if self._pilot is not None:
            self._pilot.change_gait(self._gait)
            self._pilot.level = settings.level

    def _follow(self, velocity: FloatArray, at_s: float) -> None:
        velocity = np.where(np.abs(velocity) < SLOWEST, 0.0, np.clip(velocity, -FASTEST, FASTEST))
        if self._lease is None and not velocity.any():
            return  # a planner that repeats zero must not hold the robot
        self._ready_pilot(at_s, stands=bool(velocity.any()))
        forward, left, turn = velocity.tolist()
        self._source.command(Velocity(forward, left, turn))

    def _lean(self, pose: BodyPose, at_s: float) -> None:
        if pose == self._pose and (self._pilot is not None or pose == LEVEL):
            return  # a node that repeats its pose must not hold the robot
        self._ready_pilot(at_s, stands=True)
        if self._arbiter.pose(pose):
            self._pose = pose

    def _pass(self, command: WantedJoints, at_s: float) -> None:
        if self._lease is not None and self._pilot is not None:
            raise CommandRefusedError("the robot walks a velocity; allowed: zero velocity first")
        self._lease_robot(at_s)
        self._pilot = None
        self._joints_until_s = at_s + EXPIRY_OF_ROS_S
        self._write(command.joint_positions_rad, at_s)

    def _answer(self, service: Service, at_s: float) -> tuple[bool, str]:
        """Whether the service is done or begun, and a line on it."""
        if service is Service.CLEAR_STOP:
            return self._clear_stop(at_s)
        try:
            self._check_no_joints(at_s)
            self._lease_robot(at_s)
            return True, self._sit() if service is Service.SIT else self._stand()
        except HexctlError as error:
            self._refused += 1
            return False, str(error)

    def _clear_stop(self, at_s: float) -> tuple[bool, str]:
        stop = self._requests.latch.current()
        if stop is None:
            return True, "it was not stopped"
        answer = self._requests.clear(stop.stop_id, at_s, by=OVER_ROS, keys=(self._requests.ros_key,))
        if "error" in answer:
            return False, answer["error"]
        stopped = answer["stopped"]
        self._drop()
        return stopped is None, "no longer stopped" if stopped is None else f"stopped: {stopped}"

    def _stand(self) -> str:
        pilot = self._drive()
        self._sits = False
        self._source.release()
        self._pose = LEVEL
        self._arbiter.clear()  # a stop by the recovery
        pilot.stand()
        return "standing up"

    def _sit(self) -> str:
        self._pose = LEVEL
        if self._pilot is not None:
            self._sits = True
            self._source.release()
            self._pilot.sit()
        else:
            self._release()
            self._drop()
            self._idle.sit(self._guard.clock.now_s)
        return "sitting down"

    def _check_no_joints(self, at_s: float) -> None:
        if at_s <= self._joints_until_s:
            raise CommandRefusedError("joint commands are arriving; allowed: end them first")

    def _ready_pilot(self, at_s: float, *, stands: bool) -> None:
        """Take the lease and start the pilot; if `stands`, end sitting down."""
        self._check_no_joints(at_s)
        self._lease_robot(at_s)
        pilot = self._drive()
        if self._sits and stands:
            self._sits = False
            pilot.stand()

    def _lease_robot(self, at_s: float) -> None:
        """Acquire or extend the lease; raises HexctlError during another client's lease or a stop."""
        if self._lease is not None and self._requests.is_current(self._lease, at_s):
            self._lease = self._requests.leases.renew(self._lease.lease_id, at_s, EXPIRY_OF_ROS_S)
        else:
            sent, guard = self._sent_rad, self._guard  # compared before a lease resets the accepted targets
            as_it_was = sent is not None and np.allclose(guard.accepted_rad(), sent, 0, SAME_RAD)
            self._lease = self._requests.acquire(OVER_ROS, at_s, EXPIRY_OF_ROS_S)
            if not as_it_was:
                self._pilot = None

    def _drive(self) -> DriveController:
        """The previous pilot continues if the robot still stands as it left it."""
        return self._new_pilot(self._guard.accepted_rad()) if self._pilot is None else self._pilot

    def _new_pilot(self, start_rad: FloatArray) -> DriveController:
        guard = self._guard
        self._sits = False
        self._pose = LEVEL
        self._source.forget()
        self._arbiter.clear()
        self._sent_rad = start_rad.copy()
        self._next_step, self._zero_index = 0, None
        self._pilot = DriveController(
            guard.robot,
            self._gait,
            start_rad,
            period_s=guard.clock.period_s,
            arbiter=self._arbiter,
            recovery=make_recovery(default_recovery(simulated=guard.simulation is not None)),
            level=self._applied.level,
        )
        return self._pilot

    def _release(self) -> None:
        if self._lease is not None:
            self._requests.release(self._lease, self._time.now())
        self._lease = self._zero_index = None

    def _drop(self) -> None:
        self._lease = self._pilot = self._sent_rad = None
        self._sits = False
        self._source.forget()
        self._joints_until_s = -EXPIRY_OF_ROS_S
