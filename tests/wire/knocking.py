"""Robots to knock at, and sessions that come with whatever settings they like."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import zenoh

from hexctl.wire.links import KeyMap, Link
from hexctl.wire.zenoh_session import open_configured

KEYS = KeyMap.of("ant")


@dataclass
class ListeningRobot:
    """A robot's session that answers, and keeps what reaches it.

    Attributes:
        heard: kind, payload of everything that came.
    """

    link: Link
    session: zenoh.Session
    heard: list[tuple[str, bytes]] = field(default_factory=list)

    def listen(self) -> None:
        """Declare what a robot declares, and subscribe to its own words too."""
        for kind in ("command", "pose", "joint_states", "status"):
            self.session.declare_subscriber(getattr(KEYS, kind), self._keeper(kind))
        for kind in ("describe", "lease", "estop"):
            self.session.declare_queryable(getattr(KEYS, kind), self._answerer(kind))
        self.publisher = self.session.declare_publisher(KEYS.joint_states)

    def _keeper(self, kind: str) -> Any:
        return lambda sample: self.heard.append((kind, bytes(sample.payload)))

    def _answerer(self, kind: str) -> Any:
        def answer(query: Any) -> None:
            self.heard.append((kind, bytes(query.payload or b"")))
            query.reply(getattr(KEYS, kind), b"robot")
            query.drop()

        return answer


def answers(session: zenoh.Session, key: str, payload: bytes = b"") -> list[bytes]:
    """What is answered at a key."""
    return [bytes(reply.ok.payload) for reply in session.get(key, payload=payload, timeout=1.0) if reply.ok]


def tls(folder: Path, side: str) -> dict[str, Any]:
    """The settings of TLS with a folder's certificate, to `connect` or to `listen`."""
    return {
        "transport/link/tls/root_ca_certificate": f"{folder}/ca.pem",
        f"transport/link/tls/{side}_certificate": f"{folder}/certificate.pem",
        f"transport/link/tls/{side}_private_key": f"{folder}/key.pem",
        "transport/link/tls/enable_mtls": True,
    }


def knocking(endpoint: str, settings: dict[str, Any], mode: str = "client") -> zenoh.Session:
    """Open a session that hexctl would not: any settings, any mode."""
    way = {"connect/endpoints": [endpoint], "connect/timeout_ms": 1000, "listen/endpoints": []}
    return _opened({"mode": mode, **way, **settings})


def posing_as_robot(endpoint: str, settings: dict[str, Any]) -> zenoh.Session:
    """Open a session that listens where a robot would."""
    return _opened({"mode": "peer", "listen/endpoints": [endpoint], **settings})


def _opened(settings: dict[str, Any]) -> zenoh.Session:
    silent: dict[str, Any] = {f"scouting/{how}/enabled": False for how in ("multicast", "gossip")}
    return open_configured({**settings, **silent, "connect/exit_on_failure": True})
