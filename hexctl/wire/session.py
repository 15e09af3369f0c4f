"""Open Zenoh sessions: a robot's, a controller's, a viewer's. Closed by default."""

import json
from enum import Enum

import zenoh

from hexctl.errors import InputError, RobotFaultError
from hexctl.wire.keys import KeyMap
from hexctl.wire.link import Link


class Role(Enum):
    """Who opens a session; also the name of its certificate."""

    ROBOT = "robot"
    CONTROLLER = "controller"
    VIEWER = "viewer"


def check_link(link: Link) -> None:
    """Raise InputError for an endpoint that cannot be, or one beyond loopback without certificates."""
    raise NotImplementedError


def open_session(link: Link, role: Role, keys: KeyMap) -> zenoh.Session:
    """Open a session; use it in a with statement, a process that does not close it never ends.

    A robot listens at the link's endpoint, everybody else connects to it. Raises InputError for a link that
    is not allowed, and RobotFaultError when there is no way to listen or to connect.
    """
    config = zenoh.Config()
    config.insert_json5("scouting/multicast/enabled", "false")
    config.insert_json5("scouting/gossip/enabled", "false")
    config.insert_json5("mode", json.dumps("peer" if role is Role.ROBOT else "client"))
    side = "listen" if role is Role.ROBOT else "connect"
    config.insert_json5(f"{side}/endpoints", json.dumps([link.endpoint]))
    if role is Role.ROBOT:
        config.insert_json5("connect/endpoints", "[]")
    try:
        return zenoh.open(config)
    except zenoh.ZError as error:
        raise RobotFaultError(f"no robot answers at {link.endpoint} ({error})") from error


__all__ = ["InputError", "Role", "check_link", "open_session"]
