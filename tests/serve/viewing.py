"""Viewers in one process: `python -m tests.serve.viewing ENDPOINT COUNT`.

They print `viewing` once all have subscribed.
"""

import sys
import threading
from contextlib import ExitStack

from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.session import PUBLISHED, open_session


def main() -> None:
    """View until the process is ended."""
    link, keys = Link(endpoint=sys.argv[1]), KeyMap.of("ant")
    with ExitStack() as stack:
        for _ in range(int(sys.argv[2])):
            session = stack.enter_context(open_session(link, Role.VIEWER, keys))
            for kind in PUBLISHED:
                session.declare_subscriber(getattr(keys, kind), lambda _: None)
        sys.stdout.write("viewing\n")
        sys.stdout.flush()
        threading.Event().wait()


if __name__ == "__main__":
    main()
