"""A viewer of a served robot: `python -m faults.programs.viewer ENDPOINT`; it takes every state."""

import sys
import time

from faults.programs.controller import say
from hexctl.backends.zenoh.zenoh_client import subscribe_states
from hexctl.wire.links import Link


def main(endpoint: str) -> None:
    """Look on until killed."""
    with subscribe_states(Link(endpoint=endpoint)):
        say("looking")
        time.sleep(3600)


if __name__ == "__main__":
    main(*sys.argv[1:])
