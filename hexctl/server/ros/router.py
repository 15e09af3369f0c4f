"""The ROS router of a served robot: it keeps its port, and whoever reaches it may stop the robot."""

from dataclasses import replace

from hexctl.errors import InputError, argument
from hexctl.wire.links import Endpoint, Link

#: Router of ROS nodes on their computer.
DEFAULT_ROUTER = "tcp/localhost:7447"

#: Endpoint of a robot when the ROS router of its computer has the default port.
ENDPOINT_BESIDE_ROUTER = "tcp/127.0.0.1:7448"


def link_beside_router(link: Link, router: str) -> Link:
    """Link that leaves the router its port; raises InputError if the options name that port."""
    own, ros = Endpoint.parse(link.endpoint), Endpoint.parse(router)
    here = ros.is_loopback and (own.is_loopback or own.is_everywhere)
    if own.port != ros.port or not here:
        return link
    if link.named:
        raise InputError(
            f"{argument('listen')}: got {link.endpoint}, where {argument('ros')} expects the ROS router; "
            f"allowed: another port, such as {ENDPOINT_BESIDE_ROUTER}"
        )
    return replace(link, endpoint=ENDPOINT_BESIDE_ROUTER, named=True)


def router_warnings(link: Link, router: str, *, drive: bool) -> tuple[str, ...]:
    """Warnings for the operator before anything moves; `drive` is whether ROS may move the robot."""
    beside = f"its usual port is left to the ROS router: clients need --connect {link.endpoint}"
    who = f"whoever reaches the ROS router at {router}"
    may = f"{who} may stop this robot; what would move it is not taken without --ros-drive"
    if drive:
        may = f"{who} may drive this robot (--ros-drive): ROS asks for no password"
    return (*((beside,) if link.endpoint == ENDPOINT_BESIDE_ROUTER else ()), may)
