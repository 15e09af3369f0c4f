"""Options of a served robot in ROS 2, and their effect on its own endpoint."""

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from hexctl.errors import InputError, argument, check_type
from hexctl.robot.model import Robot
from hexctl.time_source import TimeSource
from hexctl.wire.links import Endpoint, Link
from hexctl.wire.ros.ros_names import RosNode

if TYPE_CHECKING:
    from hexctl.server.ros.bridge import RosBridge

#: Router of ROS nodes on their computer.
DEFAULT_ROUTER = "tcp/localhost:7447"

#: Endpoint of a robot when the ROS router of its computer has the default port.
ENDPOINT_BESIDE_ROUTER = "tcp/127.0.0.1:7448"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosOptions:
    """A robot as a node of ROS 2.

    Attributes:
        router: address of the ROS router, `tcp/HOST:PORT`.
        namespace: of the node and its topics; empty for the root.
        humble: whether keys are those of ROS 2 Humble.
        drive: whether ROS may move the robot; it may always stop it.

    Raises InputError for an invalid value.
    """

    router: str = DEFAULT_ROUTER
    domain: int = 0
    namespace: str = ""
    humble: bool = False
    drive: bool = False

    def __post_init__(self) -> None:
        check_type(self.router, str, "ros", "the address of a ROS router, as tcp/localhost:7447")
        Endpoint.parse(self.router, argument("ros"))
        check_type(self.humble, bool, "ros_humble")
        check_type(self.drive, bool, "ros_drive")
        self.node  # noqa: B018  raises

    @property
    def node(self) -> RosNode:
        """Names of the node."""
        return RosNode(domain=self.domain, namespace=self.namespace, humble=self.humble)

    def link_beside_router(self, link: Link) -> Link:
        """Link that leaves the router its port; raises InputError if the options name that port."""
        own, router = Endpoint.parse(link.endpoint), Endpoint.parse(self.router)
        here = router.is_loopback and (own.is_loopback or own.is_everywhere)
        if own.port != router.port or not here:
            return link
        if link.named:
            raise InputError(
                f"{argument('listen')}: got {link.endpoint}, where {argument('ros')} expects the ROS router; "
                f"allowed: another port, such as {ENDPOINT_BESIDE_ROUTER}"
            )
        return replace(link, endpoint=ENDPOINT_BESIDE_ROUTER, named=True)

    def bridge(self, robot: Robot, *, sit_after_s: float, insecure: bool, time: TimeSource) -> "RosBridge":
        """Node of a robot, not started; `insecure` allows a router on another computer."""
        from hexctl.server.ros.bridge import RosBridge
        from hexctl.server.ros.settings import RosSettings

        settings = RosSettings(sit_after_s=sit_after_s, ros_drive=self.drive)
        return RosBridge(
            robot, self.node, router=self.router, settings=settings, insecure=insecure, time=time
        )

    def warnings(self, link: Link) -> tuple[str, ...]:
        """Warnings for the operator before anything moves."""
        beside = f"its usual port is left to the ROS router: clients need --connect {link.endpoint}"
        return (*((beside,) if link.endpoint == ENDPOINT_BESIDE_ROUTER else ()), *self._who_may())

    def _who_may(self) -> tuple[str, ...]:
        who = f"whoever reaches the ROS router at {self.router}"
        if self.drive:
            return (f"{who} may drive this robot (--ros-drive): ROS asks for no password",)
        return (f"{who} may stop this robot; what would move it is not taken without --ros-drive",)
