"""Options of a served robot and of its servos."""

from dataclasses import dataclass
from pathlib import Path
from types import NoneType
from typing import TYPE_CHECKING, Annotated, ClassVar

from hexctl.backends.registry import BackendOptions, backend_names, check_options
from hexctl.backends.robot_options import ServosOptions, lower_case
from hexctl.backends.sim.world import DEFAULT_WORLD
from hexctl.errors import InputError, argument, check_type
from hexctl.options import RARE, Panel, Range, Typed, check_fields, check_used
from hexctl.robot.failure import Failure, failure_text
from hexctl.robot.failure_grammar import option_of, read_failures_before
from hexctl.robot.loader import load_robot_file
from hexctl.server.idle import SIT_AFTER_RANGE_S, SIT_AFTER_S
from hexctl.wire.links import CertificateOptions, Endpoint
from hexctl.wire.ros.ros_names import MAX_DOMAIN, RosNode

if TYPE_CHECKING:
    from hexctl.backends.sim.world import World

#: The backend of a robot that is served already.
SERVED = "zenoh"

ROS_DOMAIN = Range(low=0, high=MAX_DOMAIN, whole=True)

ROS, CONNECTION = Panel("ROS"), Panel("Connection")

#: Router of ROS nodes on their computer.
DEFAULT_ROUTER = "tcp/localhost:7447"

#: Options that only a node of ROS 2 uses.
OF_ROS = ("ros_domain", "ros_namespace", "ros_drive", "ros_humble")


@dataclass(frozen=True, slots=True, kw_only=True)
class ServedOptions(ServosOptions, CertificateOptions):
    """Options that choose the served servos.

    Raises InputError for an invalid value, and for a simulation's option with other servos.
    """

    PANEL: ClassVar = "Robot"

    backend: Annotated[str, Typed(parse=lower_case, words="served_backends")] = "sim"
    """What moves: sim (simulation in real time), mavlink (a servo board), the driver of its servos, such as
    feetech or pca9685, mock (servos without a robot), or package.module:Class for custom servos.
    """

    def __post_init__(self) -> None:
        check_fields(self)
        check_type(self.robot, (str, Path), argument("robot"), "the name or path of a robot file")
        check_type(
            self.world, (str, Path, NoneType), argument("world"), "the name or path of a world, or None"
        )
        check_options(self.backend, world=self.world, seed=self.seed)
        for name, value in map(option_of, self.failures):
            check_options(self.backend, names={"failures": name}, failures=value)

    @property
    def failures(self) -> tuple[Failure, ...]:
        """Failures of the simulation, by leg; raises InputError for an invalid value."""
        instead = "one from the start, such as 5:limp; hexctl sim fail lets a leg fail later"
        return read_failures_before(self.failure, self.failed_leg, instead)

    @property
    def simulated(self) -> dict[str, str] | None:
        """World and failure of a simulation as text, for the status; None for other servos."""
        if self.backend != "sim":
            return None
        return {"world": str(self.world or DEFAULT_WORLD), "failure": failure_text(*self.failures)}

    def backend_options(self, *, credentials: Path | None = None, insecure: bool = False) -> BackendOptions:
        """Options of the backend, in real time; `credentials` has the key of a servo board."""
        file = load_robot_file(str(self.robot))
        return BackendOptions.of(
            self,
            robot=file.robot,
            world=self._loaded_world(),
            realtime=True,
            robot_file=file,
            credentials=credentials,
            insecure=insecure,
            link=None,
        )

    def _loaded_world(self) -> "World | None":
        if self.backend != "sim" and self.world is None:
            return None
        from hexctl.backends.sim.world import load_world

        return load_world(str(self.world or DEFAULT_WORLD))


@dataclass(frozen=True, slots=True, kw_only=True)
class ServeOptions(ServedOptions):
    """Options of `hexctl serve`.

    Raises InputError for an invalid value.
    """

    listen: Annotated[str | None, CONNECTION] = None
    """Where to listen: PROTOCOL/HOST:PORT with tcp, tls or quic, such as tls/0.0.0.0:7447. (default:
    tcp/127.0.0.1:7447)
    """

    device_keys: Annotated[str | Path | None, CONNECTION, RARE] = None
    """With mavlink, folder with mavlink.key, the board's secret: only what it signed is accepted. (default:
    none)
    """

    sit_after_s: Annotated[float, SIT_AFTER_RANGE_S, CONNECTION, RARE] = SIT_AFTER_S
    """Seconds without a command until the robot sits and relaxes, {}."""

    ros: Annotated[str | None, ROS] = None
    """Join ROS 2 as a node over Zenoh (rmw_zenoh), through the router at tcp/HOST:PORT; without a value, at
    tcp/localhost:7447. (default: no ROS)
    """

    ros_domain: Annotated[int, ROS_DOMAIN, ROS, RARE] = 0
    """With --ros, the ROS domain, a whole number, {}: ROS_DOMAIN_ID there."""

    ros_namespace: Annotated[str, ROS, RARE] = ""
    """With --ros, namespace of node and topics, such as lab/ant. (default: none)"""

    ros_drive: Annotated[bool, ROS] = False
    """With --ros, let ROS move the robot: cmd_vel, robot_joint_command, ~/stand, ~/sit and ~/clear_stop.
    Whoever reaches the ROS router may then drive it.
    """

    ros_humble: Annotated[bool, ROS, RARE] = False
    """With --ros, keys as ROS 2 Humble has them, without type hashes."""

    def __post_init__(self) -> None:
        if self.backend == SERVED:
            others = ", ".join(name for name in backend_names() if name != SERVED)
            raise InputError(
                f"{argument('backend')}: got {SERVED}, whose robot is already served; allowed: {others}"
            )
        super(ServeOptions, self).__post_init__()
        check_options(
            self.backend,
            names={"credentials": "device_keys"},
            but=(SERVED,),
            port=self.port,
            credentials=self.device_keys,
        )
        if self.ros is None:
            check_used(self, OF_ROS, f"with {argument('ros')}")
        else:
            Endpoint.parse(self.ros, argument("ros"))
        self.ros_node  # noqa: B018  raises

    @property
    def ros_node(self) -> RosNode:
        """Names of its ROS 2 node."""
        return RosNode(domain=self.ros_domain, namespace=self.ros_namespace, humble=self.ros_humble)
