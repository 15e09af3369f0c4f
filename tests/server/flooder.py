"""A process that sends one datagram again and again to a port of this computer, at a rate.

`python -u -m tests.server.flooder PORT HEX PER_SECOND`; a rate of 0 is as fast as the process can.
"""

import ctypes
import signal
import socket
import sys
import time

#: Datagrams of one system call, and pauses between two calls.
MOST_AT_ONCE, PERIOD_S = 256, 0.001


class _Vector(ctypes.Structure):
    _fields_ = (("base", ctypes.c_void_p), ("size", ctypes.c_size_t))


class _Message(ctypes.Structure):
    _fields_ = (
        ("name", ctypes.c_void_p),
        ("name_size", ctypes.c_uint32),
        ("vectors", ctypes.c_void_p),
        ("vector_count", ctypes.c_size_t),
        ("control", ctypes.c_void_p),
        ("control_size", ctypes.c_size_t),
        ("flags", ctypes.c_int),
        ("sent", ctypes.c_uint),
        ("padding", ctypes.c_uint),
    )


def flood(port: int, data: bytes, per_s: float) -> None:
    """Send a datagram again and again until SIGTERM, and then print at which rate."""
    kept = ctypes.create_string_buffer(data, len(data))
    vector = _Vector(ctypes.addressof(kept), len(data))
    messages = (_Message * MOST_AT_ONCE)()
    for message in messages:
        message.vectors, message.vector_count = ctypes.addressof(vector), 1
    send = ctypes.CDLL(None).sendmmsg
    began_s, sent = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        stranger.connect(("127.0.0.1", port))
        try:
            while True:
                missing = (time.monotonic() - began_s) * per_s - sent if per_s else MOST_AT_ONCE
                if missing >= 1:
                    sent += max(0, send(stranger.fileno(), messages, int(min(missing, MOST_AT_ONCE)), 0))
                if missing < MOST_AT_ONCE:
                    time.sleep(PERIOD_S)
        finally:
            sys.stdout.write(f"{sent / (time.monotonic() - began_s):.0f} datagrams a second\n")


if __name__ == "__main__":
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    sys.stdout.write("flooding\n")
    flood(int(sys.argv[1]), bytes.fromhex(sys.argv[2]), float(sys.argv[3]))
