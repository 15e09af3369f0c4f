"""A process that sends one datagram again and again to a port of this computer, at a rate.

`python -u -m tests.server.flooder PORT HEX PER_SECOND`; a rate of 0 is as fast as the process can.
"""

import socket
import sys
import time

PERIOD_S, AT_ONCE = 0.001, 256


def flood(port: int, data: bytes, per_s: float) -> None:
    """Send a datagram again and again."""
    begun_s, sent = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        while True:
            due = int((time.monotonic() - begun_s) * per_s) - sent if per_s else AT_ONCE
            for _ in range(due):
                stranger.sendto(data, ("127.0.0.1", port))
            sent += due
            if per_s:
                time.sleep(PERIOD_S)


if __name__ == "__main__":
    sys.stdout.write("flooding\n")
    flood(int(sys.argv[1]), bytes.fromhex(sys.argv[2]), float(sys.argv[3]))
