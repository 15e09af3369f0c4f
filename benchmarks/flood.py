"""A flood of well-formed commands under a wrong lease, and what gets through of the right client's.

As a program, `-m benchmarks.flood PORT RATE`, one client of the flood: it says `ready`, begins with the first
line that it is told, and ends with the second, when it says how many it sent a second.
"""

import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager

import zenoh

from benchmarks.link import free_port, served
from benchmarks.plans import ant
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from hexctl.backends.clock import PERIOD_S, WallClock
from hexctl.backends.zenoh.zenoh_client import LeaseClient, ask
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_messages import CommandTag, encode_positions, prepare_codec
from hexctl.wire.zenoh_session import open_session

KEYS = KeyMap.of("ant")

#: Messages a second of all clients of the flood together, and how many they are.
RATE_HZ = 20_000
CLIENTS = 4

#: How long a flood lasts before it counts, and how long a client of it rests between two bursts.
BEFORE_S, REST_S = 2.0, 0.002


def flood_rows(scale: Scale) -> Iterator[Row]:
    """What gets through of a client's commands during a flood."""
    prepare_codec()
    share, foreign_hz = _beside(scale.flood_s)
    note = f"during {foreign_hz:.0f} foreign ones a second that were read"
    yield Row(f"flood.{RATE_HZ}.through", share, "share", Bar(low=0.99), note)


def _beside(duration_s: float) -> tuple[float, float]:
    """Share of commands obeyed, and foreign ones read a second."""
    port = free_port()
    endpoint = f"tcp/127.0.0.1:{port}"
    with ExitStack() as stack:
        stack.enter_context(served(port, "sim"))
        stack.enter_context(_flood(port))
        session = stack.enter_context(open_session(Link(endpoint=endpoint), Role.CONTROLLER, KEYS))
        lease = LeaseClient(session, KEYS.lease)
        lease.acquire()
        before = _counts(session)
        sent = _command(session, lease, duration_s)
        after = _counts(session)
        lease.release()
    foreign_hz = (after["stale_owner"] - before["stale_owner"]) / duration_s
    return (after["accepted"] - before["accepted"]) / sent, foreign_hz


def _counts(session: zenoh.Session) -> dict[str, int]:
    counts: dict[str, int] = ask(session, KEYS.describe, timeout_s=5.0)[0]["status"]["commands"]
    return counts


def _command(session: zenoh.Session, lease: LeaseClient, duration_s: float) -> int:
    """Command a stance at 50 Hz for a time; how many commands that were."""
    publisher = _publisher(session)
    payload, clock = encode_positions(ant().stance_angles_rad), WallClock()
    sent = round(duration_s / PERIOD_S)
    for sequence in range(1, sent + 1):
        clock.tick()
        publisher.put(payload, attachment=_tag(sequence, lease.lease_id, lease.sequence))
    time.sleep(REST_S)
    return sent


@contextmanager
def _flood(port: int) -> Iterator[None]:
    """Have a robot flooded by several clients until the block ends."""
    command = [sys.executable, "-m", "benchmarks.flood", str(port), str(RATE_HZ / CLIENTS)]
    pipes = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
    clients = [subprocess.Popen(command, text=True, **pipes) for _ in range(CLIENTS)]  # type: ignore[call-overload]
    try:
        for client in clients:
            client.stdout.readline()
        for client in clients:
            client.stdin.write("\n")
            client.stdin.flush()
        time.sleep(BEFORE_S)
        yield
    finally:
        for client in clients:
            client.communicate("\n")


def main(port: str, rate_hz: str) -> None:
    """Flood a robot until told to stop."""
    until = threading.Event()

    def wait_for_the_end() -> None:
        sys.stdin.readline()
        until.set()

    with open_session(Link(endpoint=f"tcp/127.0.0.1:{port}"), Role.CONTROLLER, KEYS) as session:
        publisher = _publisher(session)
        payload, tag = encode_positions(ant().stance_angles_rad), _tag(1 << 40, b"x" * 16, 1)
        print("ready", flush=True)
        sys.stdin.readline()
        threading.Thread(target=wait_for_the_end, daemon=True).start()
        begun_s, sent = time.monotonic(), 0
        while not until.is_set():
            due = round((time.monotonic() - begun_s) * float(rate_hz))
            while sent < due and not until.is_set():
                publisher.put(payload, attachment=tag)
                sent += 1
            until.wait(REST_S)
        print(round(sent / (time.monotonic() - begun_s)))


def _publisher(session: zenoh.Session) -> zenoh.Publisher:
    """As controllers declare it."""
    return session.declare_publisher(
        KEYS.command,
        congestion_control=zenoh.CongestionControl.DROP,
        priority=zenoh.Priority.REAL_TIME,
        express=True,
    )


def _tag(sequence: int, lease_id: bytes, lease_sequence: int) -> bytes:
    return CommandTag(
        sequence=sequence,
        stamp_ns=time.monotonic_ns(),
        time_to_live_ms=200,
        lease_id=lease_id,
        lease_sequence=lease_sequence,
    ).packed()


if __name__ == "__main__":
    main(*sys.argv[1:])
