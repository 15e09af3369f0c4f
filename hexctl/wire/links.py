"""Links: endpoint of a robot, role of a peer, and keys of messages."""

import ipaddress
import re
import shlex
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from enum import Enum
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.errors import InputError, argument
from hexctl.options import RARE, Typed


class Role(Enum):
    """Role of one end of a link; also the common name of its certificate, and the name of its folder.

    A robot listens and publishes. Controllers command, stop, and may set a robot's pose. Viewers only read.
    """

    ROBOT = "robot"
    CONTROLLER = "controller"
    VIEWER = "viewer"


#: First part of every default key.
ROOT = "hexctl"


@dataclass(frozen=True, slots=True, kw_only=True)
class KeyMap:
    """Key of each kind of message; every value is a full key expression.

    Attributes:
        command: joint targets to the robot, sensor_msgs/JointState.
        joint_states: joint angles from the robot, sensor_msgs/JointState.
        odom: pose from the robot, nav_msgs/Odometry.
        battery: sensor_msgs/BatteryState.
        status: state of the server, JSON.
        imu: orientation that the robot itself measures, sensor_msgs/Imu.
        truth: true pose of a simulated robot, nav_msgs/Odometry.
        pose: external pose to the robot, such as motion capture, nav_msgs/Odometry.
        describe: queryable: robot description, protocol version, joint order, JSON.
        lease: queryable: the right to command, JSON.
        estop: queryable: stop, or clear a stop, JSON.
        failure: queryable of a simulated robot: let a leg fail, or heal, JSON.
    """

    command: str
    joint_states: str
    odom: str
    battery: str
    status: str
    imu: str
    truth: str
    pose: str
    describe: str
    lease: str
    estop: str
    failure: str

    @classmethod
    def of(cls, robot_name: str) -> "KeyMap":
        """Default keys of a robot: `hexctl/<robot>/<kind>`."""
        return cls(**{kind: f"{ROOT}/{robot_name}/{kind}" for kind in KINDS})

    def renamed(self, names: dict[str, str]) -> "KeyMap":
        """Copy with custom keys; raises InputError for unknown kinds, invalid or repeated Zenoh keys."""
        for kind, key in names.items():
            if kind not in KINDS:
                raise InputError(f"keys: got {kind!r}; allowed: {', '.join(KINDS)}")
            _check_key(kind, key)
        renamed = replace(self, **names)
        taken: dict[str, str] = {}
        for kind in KINDS:
            key = getattr(renamed, kind)
            if key in taken:
                raise InputError(f"keys: got {key!r} for {taken[key]} and {kind}; allowed: a key each")
            taken[key] = kind
        return renamed


KINDS = tuple(field.name for field in fields(KeyMap))


def _check_key(kind: str, key: str) -> None:
    """Refuse empty parts, wildcards, and the characters that Zenoh reserves."""
    parts = key.split("/")
    if not all(parts) or any(sign in key for sign in "*$?#@ "):
        raise InputError(
            f"keys: got {key!r} for {kind}; allowed: names joined by single slashes, none of * $ ? # @"
        )


PROTOCOLS = ("tcp", "tls", "quic")
ENCRYPTED = ("tls", "quic")

# Nothing follows the port: settings there would override certificates in Zenoh.
_FORM = re.compile(r"(?P<protocol>[a-z]+)/(?P<host>\[[0-9A-Fa-f:.]+\]|[A-Za-z0-9._-]+):(?P<port>[0-9]{1,5})")
_LIKE_AN_ADDRESS = re.compile(r"[0-9.]+")


@dataclass(frozen=True, slots=True)
class Endpoint:
    """An address on the network, of a protocol in `PROTOCOLS`; IPv6 hosts have no brackets."""

    protocol: str
    host: str
    port: int

    @classmethod
    def parse(cls, text: str, what: str = "endpoint") -> "Endpoint":
        """Endpoint of a text such as `tcp/127.0.0.1:7447`, named `what` in messages; raises InputError."""
        match = _FORM.fullmatch(text)
        if (
            match is None
            or match["protocol"] not in PROTOCOLS
            or not 0 < int(match["port"]) < 65_536
            or not _is_host(match["host"])
        ):
            raise InputError(
                f"{what}: got {text!r}; allowed: PROTOCOL/HOST:PORT with tcp, tls or quic, "
                "such as tcp/127.0.0.1:7447 or tls/robot.local:7447"
            )
        return cls(match["protocol"], match["host"].strip("[]"), int(match["port"]))

    def __str__(self) -> str:
        """Text in Zenoh's form."""
        return f"{self.protocol}/{self.place}"

    @property
    def place(self) -> str:
        """Host and port as text."""
        return f"[{self.host}]:{self.port}" if ":" in self.host else f"{self.host}:{self.port}"

    @property
    def encrypted(self) -> bool:
        """Whether the link is encrypted and both ends present certificates."""
        return self.protocol in ENCRYPTED

    @property
    def is_loopback(self) -> bool:
        """Whether only processes of this computer can be the other end."""
        return is_loopback(self.host)

    @property
    def is_everywhere(self) -> bool:
        """Whether it means all addresses of this computer, for listening only."""
        address = _address(self.host)
        return address is not None and address.is_unspecified


def is_loopback(host: str) -> bool:
    """Whether a host is this computer."""
    address = _address(host)
    return host == "localhost" if address is None else address.is_loopback


def _is_host(text: str) -> bool:
    address = _address(text.strip("[]"))
    if address is not None:
        return not address.is_multicast and (address.version == 6) == text.startswith("[")
    return not text.startswith("[") and _LIKE_AN_ADDRESS.fullmatch(text) is None


def _address(text: str) -> ipaddress.IPv4Address | ipaddress.IPv6Address | None:
    try:
        return ipaddress.ip_address(text)
    except ValueError:
        return None


#: Clears a stop of the robot at the default endpoint.
CLEAR_COMMAND = "hexctl estop --clear"

#: Default endpoint of `hexctl serve` and of every client.
DEFAULT_ENDPOINT = "tcp/127.0.0.1:7447"


#: Matches every robot on a link, in place of a name.
ANY_ROBOT = "*"


@dataclass(frozen=True, slots=True, kw_only=True)
class Link:
    """One end of a link.

    Attributes:
        endpoint: a Zenoh endpoint, such as `tls/robot.local:7447`: target of a client, or address of a robot.
        credentials: folder of `hexctl keys new`, or None without certificates.
        insecure: allows a link to another computer without certificates.
        names: custom keys of a robot, by kind.
        plain: True for a robot with only the ROS 2 messages: no description is compared, no lease taken,
            and its own watchdog decides what happens when commands stop.
        named: False if neither endpoint nor link file was given: any robot may be there. Not compared.
    """

    endpoint: str = DEFAULT_ENDPOINT
    credentials: Path | None = None
    insecure: bool = False
    names: Mapping[str, str] = field(default_factory=dict)
    plain: bool = False
    named: bool = field(default=True, compare=False)

    def keys(self, robot_name: str) -> KeyMap:
        """Keys of a robot, or of `ANY_ROBOT`, on this link; raises InputError for names not allowed."""
        return KeyMap.of(robot_name).renamed(dict(self.names))

    @property
    def clear_command(self) -> str:
        """Command that clears a stop of the robot at this link; custom names need the link file."""
        words = [CLEAR_COMMAND]
        if self.endpoint != DEFAULT_ENDPOINT:
            words.append(f"--connect {shlex.quote(self.endpoint)}")
        if self.credentials is not None:
            words.append(f"--keys {shlex.quote(str(self.credentials))}")
        return " ".join([*words, *(["--insecure"] if self.insecure else [])])


def load_link(
    link: str | None = None,
    *,
    connect: str | None = None,
    credentials: Path | None = None,
    insecure: bool = False,
    given_as: str = "connect",
) -> Link:
    """Link of a file, or the default one; the other arguments override it. They are the `LinkOptions`.

    `given_as` is the endpoint's option in messages. Relative credentials in a file start at the file's
    folder. Raises InputError with file, key, value and allowed values.
    """
    if connect:
        Endpoint.parse(connect, argument(given_as))
    found = Link(named=connect is not None)
    if link is not None:
        from hexctl.wire.link_file import read_link_file  # a stop must not wait for its library

        found = Link(**read_link_file(link))
    return replace(
        found,
        endpoint=connect or found.endpoint,
        credentials=found.credentials if credentials is None else credentials,
        insecure=insecure or found.insecure,
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class CertificateOptions:
    """Certificates of either end of a link, and its file."""

    PANEL: ClassVar = "Connection"

    credentials: Annotated[str | Path | None, Typed(flag="keys")] = None
    """Folder of certificates that hexctl keys new made; needed beyond this computer. (default: none)"""

    insecure: Annotated[bool, RARE] = False
    """Go without certificates beyond this computer: every client there can move the robot."""

    link: Annotated[str | None, RARE] = None
    """YAML file that says where a robot is, its certificates and the names of its messages
    (docs/reference/zenoh.md). (default: none)
    """


@dataclass(frozen=True, slots=True, kw_only=True)
class LinkOptions(CertificateOptions):
    """Endpoint and certificates of a robot on the network."""

    connect: str | None = None
    """Where hexctl serve listens, such as tcp/HOST:7447 or tls/HOST:7447. (default: tcp/127.0.0.1:7447)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class WatchOptions(LinkOptions):
    """Robot on the network to watch instead of recordings."""

    connect: str | None = None
    """Watch the robot behind this hexctl serve, such as tcp/127.0.0.1:7447, without commanding it. (default:
    none, recordings are shown)
    """
