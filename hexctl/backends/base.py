"""The abstract leg-servo interface: the only way to a robot, simulated or real."""

from abc import ABC, abstractmethod
from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import TYPE_CHECKING, Protocol, Self, runtime_checkable

from hexctl.backends.clock import Clock
from hexctl.errors import CommandRefusedError, InputError, RobotFaultError, check_type
from hexctl.robot.failure import Failure, Failures, difference_note, each_failure, failure_text
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.robot.sensors import in_words
from hexctl.robot.servos.raw_map import RawMap, joints_without_stance, stance_problems
from hexctl.types import N_JOINTS, FloatArray, JointTargets, RobotState, all_finite

if TYPE_CHECKING:
    from hexctl.wire.description import RobotIdentity
    from hexctl.wire.links import Link

#: Position (3,) and orientation (4,), with the same leading shape.
TruePose = tuple[FloatArray, FloatArray]

#: Note on a robot, or a simulated board, that this process moves itself.
UNSERVED = (
    "without hexctl serve there is no keeper and no estop: for a real robot run hexctl serve with these "
    "options, then this command with --backend zenoh"
)


class SimulationFacet(Protocol):
    """State and controls of a simulation, for scores and recordings; controllers must not use it."""

    @property
    def true_pose(self) -> TruePose | None:
        """True position (3,) in m and orientation (4,) of the base in the world; None before `connect`."""

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Current failures, by leg; before `connect` those at the start."""

    def change_leg(self, leg: int, failure: Failure | None) -> None:
        """Let a leg fail now, or heal for None.

        Raises RobotFaultError before `connect`, InputError for an impossible failure.
        """

    def walk_begins(self) -> None:
        """Set the zero of the times of scheduled failures."""


class RemoteFacet(Protocol):
    """The link to a server, and what the server reports of its robot."""

    @property
    def link(self) -> "Link":
        """Endpoint, credentials and key names of the link."""

    @property
    def identity(self) -> "RobotIdentity | None":
        """Robot that answered and who started it; None before `connect`, and on a plain link."""

    @property
    def simulated(self) -> Mapping[str, str] | None:
        """World and failure of a simulation as text, `world` and `failure`; None for a robot."""

    @property
    def failures(self) -> tuple[Failure, ...] | None:
        """Last reported failures of a simulation, by leg; None for a robot."""


class LegServos(ABC):
    """Eighteen leg servos with a clock.

    One tick is: `clock.tick()`, `read()`, `write()`. `hexctl.testing.LegServosConformance` tests
    implementations.
    """

    @property
    @abstractmethod
    def robot(self) -> Robot:
        """Description of the robot that the servos move."""

    @property
    @abstractmethod
    def clock(self) -> Clock:
        """The clock that triggers each tick."""

    @property
    def simulation(self) -> SimulationFacet | None:
        """What only a simulation knows and can do; None for real servos."""
        return None

    @property
    def remote(self) -> RemoteFacet | None:
        """The link to the robot's server and what that reports; None without a server."""
        return None

    @property
    def moves_hardware(self) -> bool:
        """Whether this process itself moves a robot, or a simulated board."""
        return self.simulation is None and self.remote is None

    @property
    def link_counts(self) -> dict[str, int]:
        """Messages received, lost, dropped ... on the link so far, by name; empty without a link."""
        return {}

    @abstractmethod
    def connect(self) -> None:
        """Connect; a second call changes nothing. Raises RobotFaultError if the robot cannot be reached."""

    @abstractmethod
    def read(self) -> RobotState:
        """Newest state, without waiting. Raises RobotFaultError when not connected or the robot is lost."""

    @abstractmethod
    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets; return the targets actually sent, after limits.

        Raises CommandRefusedError for a wrong shape or non-finite values, RobotFaultError when not connected.
        """

    def pause_watchdog(self) -> None:  # noqa: B027  most servos have no watchdog
        """Expect no command until the next one: until then, silence is not a failure."""

    def disable_torque(self) -> bool:
        """Let the joints go limp until the next `write`; False if the servos cannot."""
        return False

    @abstractmethod
    def close(self) -> None:
        """Release the robot and everything opened; a second call changes nothing."""

    def __enter__(self) -> Self:
        try:
            self.connect()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


class OwnServos(LegServos):
    """Servos that hold their robot, given by name, file or object, and their clock."""

    def __init__(self, robot: Robot | str | Path, clock: Clock) -> None:
        self._robot, self._clock = as_robot(robot), clock

    @property
    def robot(self) -> Robot:
        """The robot that the servos belong to."""
        return self._robot

    @property
    def clock(self) -> Clock:
        """The clock of this end."""
        return self._clock


class ServosWrapper(LegServos):
    """Forwards everything to the wrapped servos; subclasses override what they change."""

    def __init__(self, servos: LegServos) -> None:
        check_type(servos, LegServos, "servos", "LegServos, as SimServos('ant') gives")
        self.wrapped = servos

    @property
    def unwrapped(self) -> LegServos:
        """The innermost servos, without any wrapper."""
        return self.wrapped.unwrapped if isinstance(self.wrapped, ServosWrapper) else self.wrapped

    @property
    def robot(self) -> Robot:
        """Robot of the wrapped servos."""
        return self.wrapped.robot

    @property
    def clock(self) -> Clock:
        """Clock of the wrapped servos."""
        return self.wrapped.clock

    @property
    def simulation(self) -> SimulationFacet | None:
        """Simulation facet of the wrapped servos; None for real servos."""
        return self.wrapped.simulation

    @property
    def remote(self) -> RemoteFacet | None:
        """Link to the server of the wrapped servos; None without a server."""
        return self.wrapped.remote

    @property
    def moves_hardware(self) -> bool:
        """Whether the wrapped servos move a robot, or a simulated board, from this process."""
        return self.wrapped.moves_hardware

    @property
    def link_counts(self) -> dict[str, int]:
        """Messages on the link of the wrapped servos so far, by name."""
        return self.wrapped.link_counts

    def connect(self) -> None:
        """Connect the wrapped servos."""
        self.wrapped.connect()

    def read(self) -> RobotState:
        """Newest state of the wrapped servos."""
        return self.wrapped.read()

    def write(self, targets: JointTargets) -> JointTargets:
        """Send targets to the wrapped servos; the result is what was sent."""
        return self.wrapped.write(targets)

    def pause_watchdog(self) -> None:
        """Expect no command until the next one."""
        self.wrapped.pause_watchdog()

    def disable_torque(self) -> bool:
        """Let the joints go limp until the next `write`; False if the wrapped servos cannot."""
        return self.wrapped.disable_torque()

    def close(self) -> None:
        """Close the wrapped servos."""
        self.wrapped.close()


@runtime_checkable
class CalibratedServos(Protocol):
    """Leg servos whose calibration can be replaced while they hold."""

    @property
    def servo_map(self) -> RawMap:
        """Conversion between joint angles and raw servo positions."""

    def remap(self, servo_map: RawMap) -> None:
        """Use another calibration from now on: no servo moves, its raw position means another angle."""


def check_stance(servos: LegServos) -> None:
    """Raise InputError for servos with a servo map whose limits exclude the stance of a joint."""
    if not isinstance(servos, CalibratedServos):
        return
    if problems := stance_problems(joints_without_stance(servos.servo_map, servos.robot)):
        more = f"; {len(problems) - 1} more joints alike" if problems[1:] else ""
        raise InputError(f"servos.{problems[0]}{more}; calibrate again: hexctl calibrate FILE")


def check_targets(targets: JointTargets) -> None:
    """Raise CommandRefusedError unless the targets are 18 finite angles."""
    positions = targets.joint_positions_rad
    if positions.shape != (N_JOINTS,):
        raise CommandRefusedError(f"targets: got shape {positions.shape}; allowed: ({N_JOINTS},)")
    if not all_finite(positions):
        raise CommandRefusedError(f"targets: got {positions.tolist()}; allowed: finite angles in rad")


def check_connected(connected: bool, who: str) -> None:
    """Raise RobotFaultError unless connected."""
    if not connected:
        raise RobotFaultError(f"{who} is not connected; call connect() first, or use it in a with statement")


def as_robot(robot: Robot | str | Path) -> Robot:
    """The given robot, or the one of a shipped name or robot file.

    Raises InputError for a file that cannot be loaded, WrongTypeError for any other type.
    """
    if isinstance(robot, str | Path):
        return load_robot(robot)
    check_type(robot, Robot, "robot", "a Robot, or the name or path of a robot file")
    return robot


def connection_notes(servos: LegServos, assumed: Failures) -> list[str]:
    """Notes on the robot, faults of its servos, and failures that differ from the `assumed` ones."""
    simulation, remote = servos.simulation, servos.remote
    identity = None if remote is None else remote.identity
    notes = [] if identity is None else [f"the robot is {identity}"]
    if servos.moves_hardware:
        notes.append(UNSERVED)
    if simulation is not None and (note := difference_note(simulation.failures, assumed)) is not None:
        notes.append(note)
    state = servos.read()
    notes += [f"servos: {warning}" for warning in state.warnings]
    if servos.moves_hardware and (missing := _unreported(servos.robot, state)):
        notes.append(
            f"the robot reports no {missing}, which its simulation measures: list `sensors` in its file"
        )
    there = None if remote is None else (remote.simulated or {}).get("failure")
    here = failure_text(*each_failure(assumed))
    if there not in (None, here):
        notes.append(f"the simulated robot there has failure {there}, this end walks as with failure {here}")
    return notes


def _unreported(robot: Robot, state: RobotState) -> str:
    """Sensors of the robot file without a report, in words; others may report later, or from elsewhere."""
    silent = {
        "joint_positions": not state.measured,
        "joint_loads": state.joint_torques_nm is None,
        "foot_contacts": state.foot_contacts is None,
    }
    missing = [sensor for sensor in robot.sensors if silent.get(sensor)]
    return in_words(missing) if missing else ""


def failures_in_force(servos: LegServos) -> tuple[Failure, ...] | None:
    """Current failures of a simulation, by leg, local or remote; None if unknown."""
    facet: SimulationFacet | RemoteFacet | None = servos.simulation
    if facet is None:
        facet = servos.remote
    return None if facet is None else facet.failures


def simulation_of(servos: LegServos) -> SimulationFacet:
    """Simulation facet of the servos; raises InputError for real servos."""
    if servos.simulation is None:
        raise InputError(
            "failure: got one for a real robot; allowed: for a robot of hexctl serve --backend sim"
        )
    return servos.simulation
