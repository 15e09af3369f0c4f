"""The bare reference of the link: sends back what comes, at once: `-m benchmarks.echo PORT`."""

import signal
import sys
import threading
from typing import Any

import zenoh

from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session

THERE, BACK = "bench/there", "bench/back"
KEYS = KeyMap.of("echo").renamed({"command": THERE, "joint_states": BACK})


def main(port: str) -> None:
    """Echo until told to stop."""
    over = threading.Event()
    signal.signal(signal.SIGTERM, lambda *_: over.set())
    link = Link(endpoint=f"tcp/127.0.0.1:{port}")
    with open_session(link, Role.ROBOT, KEYS) as session:
        publisher = session.declare_publisher(
            BACK,
            congestion_control=zenoh.CongestionControl.DROP,
            priority=zenoh.Priority.REAL_TIME,
            express=True,
        )

        def echo(sample: Any) -> None:
            publisher.put(sample.payload, attachment=sample.attachment)

        session.declare_subscriber(THERE, echo)
        print("ready", flush=True)
        over.wait()


if __name__ == "__main__":
    main(*sys.argv[1:])
