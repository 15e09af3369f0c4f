"""A page's client in a process of its own: `python -m tests.cli.stopping.finger PORT`.

It is told by lines what to do: `v 0.5 0 0` puts a finger down there and streams as the page does, `release`
lifts it, `stop` and `stand` press those buttons with another finger, `close` closes the socket as a tab that
is closed does. Prints `open` when it may drive.
"""

import json
import select
import sys
import threading
from contextlib import suppress

from websockets.exceptions import ConnectionClosed
from websockets.sync.client import ClientConnection, connect
from websockets.typing import Origin, Subprotocol

#: Time between two messages of the page.
STREAM_S = 0.04


def _drain(page: ClientConnection) -> None:
    """Take what the robot says, as a page does."""
    with suppress(ConnectionClosed):
        while True:
            page.recv()


def main(port: str) -> None:
    """Drive until the input ends."""
    own = f"127.0.0.1:{port}"
    protocol = Subprotocol("hexctl.drive.1")
    with connect(f"ws://{own}/drive", origin=Origin(f"http://{own}"), subprotocols=[protocol]) as page:
        threading.Thread(target=_drain, args=(page,), daemon=True).start()
        sys.stdout.write("open\n")
        sys.stdout.flush()
        velocity: list[float] | None = None
        while True:
            wait_s = None if velocity is None else STREAM_S
            if select.select([sys.stdin], [], [], wait_s)[0]:
                word, *numbers = sys.stdin.readline().split() or ["close"]
                if word == "close":
                    return
                if word in ("stop", "stand"):
                    page.send(json.dumps({"do": word}))
                    continue
                velocity = [float(number) for number in numbers] if word == "v" else None
                if velocity is None:
                    page.send(json.dumps({"release": True}))
            if velocity is not None:
                page.send(json.dumps({"v": velocity}))


if __name__ == "__main__":
    main(sys.argv[1])
