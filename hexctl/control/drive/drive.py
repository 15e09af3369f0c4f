"""A robot driven by velocity commands: `hexctl.Drive`."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from pathlib import Path
from types import NoneType, TracebackType
from typing import Any, Self

import numpy as np

from hexctl.backends.base import LegServos, as_robot, check_stance, connection_notes
from hexctl.backends.clock import Tick
from hexctl.backends.registry import BackendOptions, check_options, make_servos
from hexctl.backends.sim.world import DEFAULT_WORLD, World, load_world
from hexctl.control.controllers import Controller
from hexctl.control.drive.arbiter import Arbiter, Decision, Velocity
from hexctl.control.drive.drive_controller import DriveController
from hexctl.control.guard import Guard
from hexctl.control.log import Recorders
from hexctl.control.loop import TickObserver, run_step
from hexctl.control.monitor.recovery import Recovery, default_recovery, make_recovery
from hexctl.control.policy.policy import Policy
from hexctl.control.policy.policy_motion import SLOW_S, PolicyMotion
from hexctl.control.sit_down import sit_down
from hexctl.control.trace import TrialFrame
from hexctl.control.trial_plan import FEET, Feet
from hexctl.control.walks.ground_contact import contact_notes, step_height
from hexctl.errors import EStopError, InputError, check_type
from hexctl.gait.body_pose import LEVEL, BodyPose
from hexctl.gait.gait import Gait, make_gait
from hexctl.options import check_names
from hexctl.robot.failure import Failure, NoticedFailure
from hexctl.robot.failure_grammar import AskedFailures, read_failures
from hexctl.robot.loader import RobotFile, load_robot_file
from hexctl.robot.model import Robot
from hexctl.robot.rotations import yaw_rad
from hexctl.types import FloatArray, JointTargets, RobotState

#: Allowed values of `hold`.
DRIVE_HOLDS = ("auto", "none")

NOT_CONNECTED = "drive: got a request before the robot is connected; allowed: inside `with Drive(...)`"


class Drive:
    """A robot that follows velocity commands, on any backend, tick by tick.

        with Drive("ant") as drive:
            drive.command(forward_m_s=0.1)
            for _ in range(500):
                state = drive.step()

    Each `step` is one control period: as fast as possible in a simulation, in real time on a robot.
    Velocities are limited to what the gait can walk, and change without a jump. On a real robot the guard
    stops it after 0.2 s without a step.

    Args:
        robot: a shipped name, a robot file, or a robot; not given with servos.
        backend: as for `hexctl.run`; not given with servos.
        servos: custom servos, not connected, with or without a `Guard`.
        gait: a name, a code, slots or a gait.
        body_raise: above the stance, -0.2 to 0.2 of the robot's size; None is that of the gait.
        recovery: for a failed leg: `glide`, `stop`, `walk-on`, `package.module:Class` or a recovery; None is
            `glide` in a simulation and `stop` elsewhere.
        hold: `auto` corrects slip by the measured pose or yaw; `none` does not.
        level: keep the body level by its measured roll and pitch.
        feet: `planned`, or `adaptive` for uneven ground: feet lift higher and, with foot contacts, search the
            ground below.
        policy: walks in place of the gait, within the ranges of its command; a Policy, or its file.
        failure: of legs, as in `RunSpec`; a simulation breaks them.
        failures_known: False if the walk has to detect simulated failures.
        recorders: take every tick, as in `run_trial`.
        options: fields of `BackendOptions`; times of events count from the first stand.

    Raises InputError for invalid input, before anything is opened or moves.
    """

    def __init__(
        self,
        robot: str | Path | Robot | None = None,
        *,
        backend: str | None = None,
        servos: LegServos | None = None,
        gait: str | int | Sequence[int] | Gait = "tripod",
        body_raise: float | None = None,
        recovery: str | Recovery | None = None,
        hold: str = "auto",
        level: bool = False,
        feet: Feet = "planned",
        policy: Policy | str | Path | None = None,
        failure: AskedFailures = (),
        failures_known: bool = True,
        arbiter: Arbiter | None = None,
        recorders: Recorders | None = None,
        **options: Any,
    ) -> None:
        check_names(Drive, options, BackendOptions)
        self._failures, events = read_failures(failure)
        if events:
            options["events"] = (*options.get("events", ()), *events)
        self._known = self._failures if failures_known else ()
        self._controller: DriveController | None = None
        self.hold = hold
        if feet not in FEET:
            raise InputError(f"feet: got {feet}; allowed: {', '.join(FEET)}")
        self._level, self._feet = level, feet
        self._robot_file: RobotFile | None = None
        check_type(servos, (LegServos, NoneType), "servos", "LegServos, as SimServos('ant') gives, or None")
        if servos is None:
            servos = self._made_servos(robot or "ant", backend or "sim", options)
        else:
            _check_alone(robot, backend, options)
        self._guard = servos if isinstance(servos, Guard) else Guard(servos)
        self.robot = self._guard.robot
        self.arbiter = Arbiter() if arbiter is None else arbiter
        if recovery is None:
            recovery = default_recovery(simulated=self._guard.simulation is not None)
        self.recovery = recovery
        self._gait = self._gait_of(gait)
        if body_raise is not None:
            self._gait = replace(self._gait, posture=replace(self._gait.posture, body_raise=body_raise))
        self._policy = Policy.load(policy) if isinstance(policy, str | Path) else policy
        check_type(self._policy, (Policy, NoneType), "policy", "a Policy, the path of an ONNX file, or None")
        if self._policy is not None:
            PolicyMotion(self.robot, self._policy, self._guard.clock.period_s)  # refuses what is not measured
        self._recorders: Recorders | None = None
        self._observers: list[TickObserver] = []
        self.record(recorders)
        self._stack = ExitStack()
        self._zero_index: int | None = None
        self._stood = False  # since the robot was connected or reset
        self.notes: tuple[str, ...] = ()

    def __enter__(self) -> Self:
        """Connect the robot, which stands up with the first step.

        Raises RobotFaultError if it cannot be reached, InputError if its servos cannot reach its stance.
        """
        check_stance(self._guard.unwrapped)
        with ExitStack() as stack:
            stack.enter_context(self._guard)
            self.notes = (
                *connection_notes(self._guard.unwrapped, self._known),
                *contact_notes(self._feet, self._guard.peek()),
            )
            self._begin()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._controller = None
        self.record(None)
        self._stack.__exit__(kind, error, trace)

    def reset(self) -> RobotState:
        """Stand up and come to rest in the stance; clears a stop. Raises what `step` raises."""
        self._connected  # noqa: B018  raises
        guard = self._guard
        if guard.simulation is not None:
            guard.close()
            guard.connect()
        guard.clear()
        self.arbiter.clear()
        self._begin()
        state = self.step()
        while not self.at_rest:
            state = self.step()
        return state

    def reconnect(self) -> None:
        """Connect again after a cleared stop; raises RobotFaultError for a stopped or busy robot."""
        self._connected  # noqa: B018  raises
        self._guard.close()
        self.arbiter.clear()  # first: a stop that comes meanwhile stays
        self._guard.connect()
        self._guard.clear()
        self._begin()

    def step(self, poll: Callable[[], None] | None = None) -> RobotState:
        """Wait for the next control period, follow the command, and return the state at its beginning.

        `poll` is called after the period has begun, for commands that count in it. Raises EStopError when the
        guard has stopped the robot, which sits down first with hot servos or a low battery, RobotFaultError
        when it or its link fails.
        """
        controller = self._connected
        tick = self._guard.clock.tick()
        if self._zero_index is None:
            self._zero_index = tick.index
        if poll is not None:
            poll()
        try:
            state = run_step(self._guard, controller, tick, tick.index - self._zero_index, self._observers)
        except EStopError:
            sit_down(self._guard, lambda: self.arbiter.stopped is not None, poll)
            raise
        if not self._stood and controller.mode == "driving":
            self._stood = True
            if self._guard.simulation is not None:
                self._guard.simulation.walk_begins()
        return state

    def record(self, recorders: Recorders | None) -> None:
        """Record from the next step on, or no longer for None; previous recorders get their last ticks."""
        if self._recorders is not None:
            self._recorders.flush()
        self._recorders = recorders
        self._observers = [] if recorders is None else [_EventNotes(self, recorders), recorders]
        if recorders is not None:
            recorders.log.controller = self._controller

    def pause(self) -> None:
        """Suspend the guard's watchdog until the next step; the robot holds its pose."""
        self._guard.pause_watchdog()

    def command(self, forward_m_s: float = 0.0, left_m_s: float = 0.0, turn_rad_s: float = 0.0) -> None:
        """Walk with a velocity in the body frame, counter-clockwise; raises InputError unless finite."""
        self.arbiter.source("motion").command(Velocity(forward_m_s, left_m_s, turn_rad_s))

    def pose_body(self, pose: BodyPose = LEVEL) -> None:
        """Move the body over its feet, and stay there; without a pose the body is level. Thread-safe.

        A pose beyond the legs' reach is scaled down (`pose_share`). A stop stops the body too.
        """
        self.arbiter.pose(pose)

    def share(self, forward: float = 0.0, left: float = 0.0, turn: float = 0.0) -> Velocity:
        """The velocity for shares -1 to 1 of the maximum with the intact legs. Thread-safe."""
        shares = (forward, left, turn)
        return Velocity(*(share * most for share, most in zip(shares, self._connected.most, strict=True)))

    def stand(self) -> None:
        """Stand up, or step the feet to their places; clears a stop, also one for a failed leg."""
        self.arbiter.clear()
        self._connected.stand()

    def sit(self) -> None:
        """Come to a stand, lower the body and stay down until `stand`."""
        self.arbiter.source("motion").release()
        self._connected.sit()

    def stop(self, reason: str = "stop") -> None:
        """Freeze, also with a leg in the air, and follow no command until `stand`. Thread-safe."""
        self.arbiter.stop(reason)

    @property
    def gait(self) -> Gait:
        """The requested gait; set a name, a code, slots or a gait to change it in stride."""
        return self._gait

    @gait.setter
    def gait(self, gait: str | int | Sequence[int] | Gait) -> None:
        """Change the gait in stride; only a `Gait` changes the posture too.

        Raises InputError unless it is a gait of the robot.
        """
        new = self._gait_of(gait)
        if not isinstance(gait, Gait):
            new = replace(new, posture=self._gait.posture)
        if self._controller is not None:
            self._controller.change_gait(new)
        self._gait = new

    @property
    def hold(self) -> str:
        """`auto` corrects slip, `none` does not; may be set."""
        return self._hold

    @hold.setter
    def hold(self, hold: str) -> None:
        """Raises InputError for another word."""
        if hold not in DRIVE_HOLDS:
            raise InputError(f"hold: got {hold}; allowed: {', '.join(DRIVE_HOLDS)}")
        self._hold = hold
        if self._controller is not None:
            self._controller.holds = hold == "auto"

    @property
    def recovery(self) -> Recovery:
        """The response to failed legs; set a name or a recovery, for legs that fail from now on."""
        return self._recovery

    @recovery.setter
    def recovery(self, recovery: str | Recovery) -> None:
        """Raises InputError for an unknown name."""
        made = make_recovery(recovery) if isinstance(recovery, str) else recovery
        check_type(made, Recovery, "recovery", "a Recovery")
        if self._controller is not None:
            self._controller.change_recovery(made)
        self._recovery = made

    @property
    def level(self) -> bool:
        """Whether the body is kept level by its measured roll and pitch; may be set."""
        return self._level

    @level.setter
    def level(self, level: bool) -> None:
        self._level = level
        if self._controller is not None:
            self._controller.level = level

    @property
    def body_pose(self) -> BodyPose:
        """The pose of the body over its feet now, without levelling."""
        return BodyPose.of(self._connected.walk.poser.commanded)

    @property
    def body_goal(self) -> BodyPose:
        """The commanded pose, as far as the legs reach it."""
        return BodyPose.of(self._connected.walk.poser.goals)

    @property
    def pose_share(self) -> float:
        """Share of the commanded body pose that the legs reach."""
        return self._connected.pose_share

    def reach(self, pose: BodyPose) -> float:
        """Share of a body pose that the legs would reach."""
        return self._connected.walk.reach(pose)

    @property
    def gait_now(self) -> Gait:
        """The gait that it walks with or changes to; differs from `gait` once a leg has failed."""
        return self._connected.walk.gaits[0]

    @property
    def mode(self) -> str:
        """`standing up`, `driving`, `sitting down` or `sitting`."""
        return self._connected.mode

    @property
    def at_rest(self) -> bool:
        """Whether no target moves: it stands, sits, or is frozen by a stop."""
        return self._connected.at_rest

    @property
    def decision(self) -> Decision:
        """The command followed in the last step, and its source."""
        return self._connected.decision

    @property
    def velocity(self) -> Velocity:
        """The velocity commanded to the legs now: within limits, and without jumps."""
        return Velocity(*self._connected.velocity_body.tolist())

    @property
    def stopped(self) -> str | None:
        """Why the robot follows no command, by the guard or the arbiter, or None."""
        return self._guard.stopped or self.arbiter.stopped

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Given and detected failures of legs."""
        return self._connected.known_failures()

    @property
    def noticed(self) -> tuple[NoticedFailure, ...]:
        """Failures detected so far, and the responses."""
        return self._connected.noticed_failures()

    @property
    def controller(self) -> Controller:
        """The source of the joint targets."""
        return self._connected

    @property
    def guard(self) -> Guard:
        """The guarded servos."""
        return self._guard

    @property
    def _connected(self) -> DriveController:
        if self._controller is None:
            raise InputError(NOT_CONNECTED)
        return self._controller

    def _begin(self) -> None:
        self._zero_index, self._stood = None, False
        self._controller = DriveController(
            self.robot,
            self._gait,
            self._guard.accepted_rad(),
            period_s=self._guard.clock.period_s,
            arbiter=self.arbiter,
            recovery=self._recovery,
            hold=self._hold == "auto",
            level=self._level,
            failures=self._known,
            feet=self._feet,
            policy=self._policy,
            limit_s=SLOW_S if self._guard.clock.waits else None,
        )
        if self._recorders is not None:
            self._recorders.log.controller = self._controller

    def _gait_of(self, gait: str | int | Sequence[int] | Gait) -> Gait:
        if isinstance(gait, Gait):
            return gait
        return make_gait(self.robot, gait, height=step_height(self.robot, self._feet))

    def _made_servos(self, robot: str | Path | Robot, backend: str, options: dict[str, Any]) -> LegServos:
        """Servos of a backend; raises InputError for options that it would ignore."""
        check_type(backend, str, "backend", "a name or package.module:Class; own servos go to `servos`")
        if not isinstance(robot, Robot):
            self._robot_file = load_robot_file(robot)
            robot = self._robot_file.robot
        check_options(backend, **options)
        if not isinstance(world := options.pop("world", None), World):
            world = load_world(DEFAULT_WORLD if world is None else world)
        return make_servos(
            backend,
            BackendOptions(
                robot=as_robot(robot),
                robot_file=self._robot_file,
                world=world,
                failures=self._failures,
                **options,
            ),
        )


def _check_alone(robot: object, backend: str | None, options: Mapping[str, Any]) -> None:
    given = [name for name, value in {"robot": robot, "backend": backend}.items() if value is not None]
    if given or options:
        raise InputError(
            f"drive: got servos and {', '.join([*given, *options])} too; allowed: one or the other"
        )


class _EventNotes(TickObserver):
    def __init__(self, drive: Drive, recorders: Recorders) -> None:
        self._drive, self._recorders = drive, recorders
        self._told: dict[str, str] = {}

    def record(self, tick: Tick, state: RobotState, requested_rad: FloatArray, sent: JointTargets) -> None:
        drive, recorders = self._drive, self._recorders
        if recorders.log.frame is None and drive.mode == "driving":
            recorders.begin_phase("walk", _frame_of(state))
        recorders.log.note(self._changed())
        recorders.log.note_events(drive.guard)

    def _changed(self) -> list[str]:
        drive, before = self._drive, self._told
        gait = ",".join(map(str, drive.gait.slots))
        self._told = {
            "stop": "stop cleared" if drive.stopped is None else f"stopped: {drive.stopped}",
            "mode": drive.mode,
            "gait": f"told: slots {gait}, body at {drive.gait.posture.body_raise:+.3f}",
        }
        return [text for name, text in self._told.items() if before.get(name, text) != text]


def _frame_of(state: RobotState) -> TrialFrame:
    """Frame of recordings: where the robot stands and faces when driving begins."""
    position, quaternion = state.base_position_world, state.base_quaternion_world
    yaw = 0.0 if quaternion is None else float(yaw_rad(quaternion))
    return TrialFrame(np.full(3, np.nan) if position is None else position, yaw, yaw)
