"""A flood of well-formed commands under a wrong lease: `python -m faults.programs.flood ENDPOINT ROBOT`.

Says `ready`, waits for a line, and floods for a while. Over `udp/HOST:PORT` it is one of datagrams that mean
nothing.
"""

import os
import socket
import sys
import time
from collections.abc import Callable

import numpy as np

from faults.programs.controller import say
from hexctl.robot.loader import load_robot
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_messages import LEASE_ID_BYTES, CommandTag, encode_positions, prepare_codec
from hexctl.wire.zenoh_session import open_session

#: How long, and how many messages a second.
FLOOD_S, RATE_HZ = 1.0, 2000

#: Messages at a time: more sleeps than this cost more than what is sent.
BURST = 20


def flood(send: Callable[[], object]) -> None:
    """Call a function at the rate of the flood."""
    sys.stdin.readline()
    begun_s, sent = time.monotonic(), 0
    while (passed_s := time.monotonic() - begun_s) < FLOOD_S:
        while sent < passed_s * RATE_HZ:
            send()
            sent += 1
        time.sleep(BURST / RATE_HZ)


def main(place: str, robot: str) -> None:
    """Flood a robot, or a port."""
    if place.startswith("udp/"):
        host, _, port = place.removeprefix("udp/").rpartition(":")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as end:
            say("ready")
            flood(lambda: end.sendto(os.urandom(60), (host, int(port))))
        return
    model = load_robot(robot)
    keys = KeyMap.of(model.name)
    prepare_codec()
    payload = encode_positions(model.stance_angles_rad + 0.3 * np.sin(np.arange(18)))
    with open_session(Link(endpoint=place), Role.CONTROLLER, keys) as session:
        say("ready")

        def send() -> None:
            tag = CommandTag(
                sequence=1,
                stamp_ns=time.monotonic_ns(),
                time_to_live_ms=200,
                lease_id=os.urandom(LEASE_ID_BYTES),
                lease_sequence=1,
            )
            session.put(keys.command, payload, attachment=tag.packed())

        flood(send)


if __name__ == "__main__":
    main(*sys.argv[1:])
