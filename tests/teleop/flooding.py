"""A client of the page that floods it: `python -m tests.teleop.flooding PORT KIND RATE`.

It sends messages of a kind at a rate in 1/s, or as fast as it can at `full`, and connects again whenever its
connection is closed. `connect` connects and leaves as fast as it can. It ends when its input does.
"""

import os
import socket
import sys
import threading
import time
from collections.abc import Callable
from contextlib import suppress

#: Messages by kind.
MESSAGES = {"valid": b'{"v":[0.1,0,0]}', "invalid": b'{"v":[', "gait": b'{"do":"gait"}', "connect": b""}

#: Messages in one piece at full speed.
AT_ONCE = 5_000


def frame(payload: bytes) -> bytes:
    """A text frame of a client, masked by zeros."""
    return bytes([0x81, 0x80 | len(payload), 0, 0, 0, 0]) + payload


def opened(port: int) -> socket.socket:
    """A socket that the page has accepted."""
    own = f"127.0.0.1:{port}"
    link = socket.create_connection(("127.0.0.1", port), timeout=1.0)
    link.sendall(
        f"GET /drive HTTP/1.1\r\nHost: {own}\r\nOrigin: http://{own}\r\nUpgrade: websocket\r\n"
        "Connection: Upgrade\r\nSec-WebSocket-Key: MDEyMzQ1Njc4OWFiY2RlZg==\r\nSec-WebSocket-Version: 13\r\n"
        "Sec-WebSocket-Protocol: hexctl.drive.1\r\n\r\n".encode()
    )
    if not link.recv(4096).startswith(b"HTTP/1.1 101"):
        link.close()
        raise ConnectionError("the page refuses the connection")
    return link


def _drain(link: socket.socket) -> None:
    with suppress(OSError):
        while link.recv(65_536):
            pass


def flood(port: int, kind: str, pause: Callable[[], int]) -> None:
    """Send until the connection is closed; `pause` waits, and says how many messages follow."""
    message = frame(MESSAGES[kind])
    with opened(port) as link:
        threading.Thread(target=_drain, args=(link,), daemon=True).start()
        while kind != "connect":
            link.sendall(message * pause())


def _paced(rate: str) -> Callable[[], int]:
    """Pauses at a rate."""
    begun_s, sent = time.monotonic(), 0

    def pause() -> int:
        nonlocal sent
        if rate == "full":
            return AT_ONCE
        time.sleep(max(0.005, 1 / float(rate)))
        due = max(1, int((time.monotonic() - begun_s) * float(rate)) - sent)
        sent += due
        return min(due, int(float(rate)))

    return pause


def main() -> None:
    """Flood until the input ends."""
    port, kind, rate = int(sys.argv[1]), sys.argv[2], sys.argv[3]

    def end() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=end, daemon=True).start()
    pause = _paced(rate)
    while True:
        with suppress(OSError):
            flood(port, kind, pause)


if __name__ == "__main__":
    main()
