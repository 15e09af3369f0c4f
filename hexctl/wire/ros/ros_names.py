"""Names of ROS 2 nodes, topics and services in Zenoh keys and liveliness tokens.

By the design document of rmw_zenoh, data of a topic have the key

    DOMAIN/topic/pkg::msg::dds_::Type_/HASH

A node, and an endpoint of it, have liveliness tokens, which `ros2 node list` and `ros2 topic list` show:

    @ros2_lv/DOMAIN/SESSION/NODE/NODE/NN/ENCLAVE/NAMESPACE/node
    @ros2_lv/DOMAIN/SESSION/NODE/ENTITY/KIND/ENCLAVE/NAMESPACE/node/TOPIC/type/HASH/QOS

A slash within a name is written as `%`.
"""

import re
from dataclasses import dataclass
from enum import Enum
from functools import cache

import xxhash

from hexctl.errors import InputError, argument, check_type
from hexctl.wire import ros_cdr

#: Limit on Linux: ROS computes its ports from the domain.
MAX_DOMAIN = 232

#: Humble has no type hashes; its keys contain this instead.
NO_HASH = "TypeHashNotSupported"

#: Hashes (REP 2016) of service types, which ros_cdr's store lacks.
SERVICE_HASHES = {
    "std_srvs/srv/Trigger": "RIHS01_eeff2cd6fa5ad9d27cdf4dec64818317839b62f212a91e6b5304b634b2062c5f",
    "rcl_interfaces/srv/DescribeParameters": (
        "RIHS01_845b484d71eb0673dae682f2e3ba3c4851a65a3dcfb97bddd82c5b57e91e4cff"
    ),
    "rcl_interfaces/srv/GetParameters": (
        "RIHS01_bf9803d5c74cf989a5de3e0c2e99444599a627c7ff75f97b8c05b01003675cbc"
    ),
    "rcl_interfaces/srv/GetParameterTypes": (
        "RIHS01_da199c878688b3e530bdfe3ca8f74cb9fa0c303101e980a9e8f260e25e1c80ca"
    ),
    "rcl_interfaces/srv/ListParameters": (
        "RIHS01_3e6062bfbb27bfb8730d4cef2558221f51a11646d78e7bb30a1e83afac3aad9d"
    ),
    "rcl_interfaces/srv/SetParameters": (
        "RIHS01_56eed9a67e169f9cb6c1f987bc88f868c14a8fc9f743a263bc734c154015d7e0"
    ),
    "rcl_interfaces/srv/SetParametersAtomically": (
        "RIHS01_0e192ef259c07fc3c07a13191d27002222e65e00ccec653ca05e856f79285fcd"
    ),
}

GID_BYTES = 16

_ROOT = "@ros2_lv"
_NODE_ID = 0
#: Unset enclave (a folder of certificates).
_NO_ENCLAVE = "%"
_PART = re.compile(r"[A-Za-z_][A-Za-z0-9_]*")


class Kind(Enum):
    """Kind of an endpoint in its token."""

    PUBLISHER = "MP"
    SUBSCRIPTION = "MS"
    SERVICE = "SS"


@dataclass(frozen=True, slots=True)
class Qos:
    """Quality of service of a reliable endpoint; latched (transient local) is for later subscribers."""

    depth: int = 10
    latched: bool = False

    def __str__(self) -> str:
        """Text of a token: reliability, durability, history and depth, deadline, lifespan, liveliness."""
        return f":{'1' if self.latched else ''}:,{self.depth}:,:,:,,"


@cache
def type_hash(kind: str) -> str:
    """Hash of a type (REP 2016), such as that of `std_msgs/msg/String`: `RIHS01_` and 64 digits."""
    return SERVICE_HASHES.get(kind) or ros_cdr.type_hash(kind)


def dds_type(kind: str) -> str:
    """Name of a type in keys: `std_msgs::msg::dds_::String_` for `std_msgs/msg/String`."""
    package, group, name = kind.split("/")
    return f"{package}::{group}::dds_::{name}_"


def mangled(name: str) -> str:
    """Name with its slashes as `%`; the root namespace is `%`."""
    return name.replace("/", "%") or "%"


@dataclass(frozen=True, slots=True, kw_only=True)
class RosNode:
    """A node in a domain; the namespace is empty for the root, `humble` omits type hashes."""

    name: str = "hexctl"
    domain: int = 0
    namespace: str = ""
    humble: bool = False

    def __post_init__(self) -> None:
        check_type(self.domain, int, "ros_domain")
        check_type(self.namespace, str, "ros_namespace", "names joined by slashes")
        if not 0 <= self.domain <= MAX_DOMAIN:
            raise InputError(f"{argument('ros_domain')}: got {self.domain}; allowed: 0 to {MAX_DOMAIN}")
        object.__setattr__(self, "namespace", _namespace(self.namespace))

    @property
    def full_name(self) -> str:
        """Name with its namespace, without a leading slash: `lab/ant/hexctl`."""
        return f"{self.namespace}/{self.name}".removeprefix("/")

    def resolved(self, topic: str) -> str:
        """Full name of a topic: `/scan` as it is, `~/stop` under the node, others in the namespace."""
        if topic.startswith("/"):
            return topic
        if topic.startswith("~/"):
            return f"{self.namespace}/{self.name}/{topic[2:]}"
        return f"{self.namespace}/{topic}"

    def token(self, session_id: str) -> str:
        """Liveliness token of the node in a Zenoh session."""
        return f"{self._begin(session_id, _NODE_ID)}/NN/{self._end}"

    def _begin(self, session_id: str, entity_id: int) -> str:
        return f"{_ROOT}/{self.domain}/{session_id}/{_NODE_ID}/{entity_id}"

    @property
    def _end(self) -> str:
        return f"{_NO_ENCLAVE}/{mangled(self.namespace)}/{self.name}"


def _namespace(given: str) -> str:
    parts = given.strip("/").split("/") if given.strip("/") else []
    if not all(_PART.fullmatch(part) for part in parts):
        raise InputError(
            f"{argument('ros_namespace')}: got {given!r}; allowed: names of letters, digits and _ that begin "
            "with no digit, joined by slashes"
        )
    return "".join(f"/{part}" for part in parts)


@dataclass(frozen=True, slots=True)
class RosEndpoint:
    """A publisher, a subscription or a service of a node.

    Attributes:
        topic: as in ROS: `joint_states`, `/diagnostics` or `~/estop`.
        entity_id: unique number within the node.
    """

    node: RosNode
    kind: Kind
    topic: str
    message: str
    entity_id: int
    qos: Qos = Qos()

    @property
    def name(self) -> str:
        """Full name of the topic or service."""
        return self.node.resolved(self.topic)

    @property
    def hash(self) -> str:
        """Hash of the type, or Humble's replacement."""
        return NO_HASH if self.node.humble else type_hash(self.message)

    @property
    def key(self) -> str:
        """Key of its data."""
        return f"{self.node.domain}{self.name}/{dds_type(self.message)}/{self.hash}"

    def token(self, session_id: str) -> str:
        """Liveliness token in a Zenoh session."""
        begin, end = self.node._begin(session_id, self.entity_id), self.node._end  # noqa: SLF001  its own node
        names = f"{mangled(self.name)}/{dds_type(self.message)}/{self.hash}"
        return f"{begin}/{self.kind.value}/{end}/{names}/{self.qos}"

    def gid(self, session_id: str) -> bytes:
        """Identifier in the attachments of its messages, 16 bytes: XXH3-128 of its token, low half first."""
        return xxhash.xxh3_128_intdigest(self.token(session_id).encode()).to_bytes(GID_BYTES, "little")
