"""How to reach a robot on the network, or to be one: an endpoint, credentials and key names."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

from hexctl.wire.keys import KeyMap

#: Where `hexctl serve` listens and every client connects unless told otherwise.
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """One end of a link.

    Attributes:
        endpoint: a Zenoh endpoint, such as `tcp/127.0.0.1:7447` or `tls/robot.local:7447`: where a client
            connects, or where a robot listens.
        credentials: folder that `hexctl keys new` made, or None for a link without certificates.
        insecure: True where somebody typed that a link beyond loopback may do without certificates.
        names: keys of a robot that has names of its own, by kind.
        plain: True for a robot that speaks the ROS 2 messages and nothing else of hexctl's: no description is
            compared, no lease taken, and what happens when commands stop coming is up to it.
    """

    endpoint: str = DEFAULT_ENDPOINT
    credentials: Path | None = None
    insecure: bool = False
    names: Mapping[str, str] = field(default_factory=dict)
    plain: bool = False

    def keys(self, robot_name: str) -> KeyMap:
        """Return the keys of a robot on this link.

        Raises InputError for names that cannot be.
        """
        return KeyMap.of(robot_name).renamed(dict(self.names))
