"""Viewers in one process: `python -m tests.server.viewing ENDPOINT COUNT`.

They print `viewing` once all have subscribed. They are clients of Zenoh with its default settings: a robot
notices
only after 10 s that one is silent, and by then much waits for it.
"""

import sys
import threading
from contextlib import ExitStack

from hexctl.wire.links import KeyMap
from hexctl.wire.zenoh_session import PUBLISHED, open_configured


def main() -> None:
    """View until the process is ended."""
    keys = KeyMap.of("ant")
    settings = {"mode": "client", "connect/endpoints": [sys.argv[1]], "scouting/multicast/enabled": False}
    with ExitStack() as stack:
        for _ in range(int(sys.argv[2])):
            session = stack.enter_context(open_configured(settings))
            for kind in PUBLISHED:
                session.declare_subscriber(getattr(keys, kind), lambda _: None)
        sys.stdout.write("viewing\n")
        sys.stdout.flush()
        threading.Event().wait()


if __name__ == "__main__":
    main()
