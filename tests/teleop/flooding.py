"""A client of the page that floods it: `python -m tests.teleop.flooding PORT KIND RATE`.

It sends messages of a kind at a rate in 1/s, or as fast as it can at `full`, and connects again whenever its
connection is closed. `connect` connects and leaves as fast as it can. It ends when its input does.
"""

import os
import socket
import sys
import threading
import time
from contextlib import suppress

#: Messages by kind.
MESSAGES = {"valid": b'{"v":[0.1,0,0]}', "invalid": b'{"v":[', "gait": b'{"do":"gait"}', "connect": b""}

#: Messages in one piece at full speed, and the pause between two pieces at a rate.
AT_ONCE, PAUSE_S = 5_000, 0.005


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


def flood(port: int, kind: str, rate: str) -> None:
    """Send until the connection is closed."""
    message, sent, begun_s = frame(MESSAGES[kind]), 0, time.monotonic()
    with opened(port) as link:
        threading.Thread(target=_drain, args=(link,), daemon=True).start()
        while kind != "connect":
            due = AT_ONCE
            if rate != "full":
                time.sleep(PAUSE_S)
                due = int((time.monotonic() - begun_s) * float(rate)) - sent
            link.sendall(message * due)
            sent += due


def main() -> None:
    """Flood until the input ends."""

    def end() -> None:
        sys.stdin.read()
        os._exit(0)

    threading.Thread(target=end, daemon=True).start()
    while True:
        with suppress(OSError):
            flood(int(sys.argv[1]), *sys.argv[2:])


if __name__ == "__main__":
    main()
