"""Programs in separate processes that command, view or flood a served robot.

`python -m tests.server.programs sway ENDPOINT [again=1] [keys=FOLDER]` sways all joints until it is stopped.
With `again=1` it takes a new lease whenever one is lost, over one session; `keys` has its certificates.

`... view ENDPOINT COUNT` opens viewers and prints `viewing` once all have subscribed. They have the default
settings of Zenoh: a robot notices only after 10 s that one is silent, and by then much waits for it.

`... flood PORT HEX PER_SECOND` sends a datagram to this computer; a rate of 0 is as fast as it can.
"""

import socket
import sys
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from hexctl.backends.clock import realtime_priority
from hexctl.backends.zenoh import zenoh_client
from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.control.guard import Guard
from hexctl.errors import HexctlError
from hexctl.types import JointTargets
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import PUBLISHED, open_configured, open_session
from tests.robots import shipped

SWAY_RAD = 0.25
SWAY_HZ = 0.8

#: Pause between two groups of datagrams, and how many at a time at full speed.
PERIOD_S, AT_ONCE = 0.001, 256


def say(text: str) -> None:
    """Print a line and flush it."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


@contextmanager
def lent(session: Any) -> Iterator[Any]:
    """A session that is lent to one connection; what it declares ends with it.

    Otherwise the subscribers of all connections so far, each with a thread, would take the computer's time.
    """
    with ExitStack() as declared:

        def declare(method: str, *arguments: Any, **options: Any) -> Any:
            made = getattr(session, method)(*arguments, **options)
            declared.callback(made.undeclare)
            return made

        methods = ("declare_subscriber", "declare_publisher")
        yield SimpleNamespace(get=session.get, **{method: partial(declare, method) for method in methods})


def sway(endpoint: str, *options: str) -> int:
    """Sway until killed or refused; print what happens."""
    given = dict(option.split("=") for option in options)
    link = Link(endpoint=endpoint, credentials=Path(given["keys"]) if "keys" in given else None)
    if "again" not in given:
        return control(link)
    with open_session(link, Role.CONTROLLER, KeyMap.of("ant")) as session:
        vars(zenoh_client)["open_session"] = lambda *_: lent(session)
        while True:
            control(link)
            time.sleep(0.02)


def control(link: Link) -> int:
    """Take the lease and command a slow wave until something goes wrong; say when the joints move."""
    try:
        with Guard(ZenohServos(shipped(), link=link)) as guard, realtime_priority():
            step = 0
            while True:
                guard.clock.tick()
                guard.read()
                angle = SWAY_RAD * np.sin(2 * np.pi * SWAY_HZ * step * guard.clock.period_s)
                # Made now, not at the tick: without priority it may have been held up since.
                guard.write(JointTargets(guard.robot.stance_angles_rad + angle, guard.clock.now_s))
                step += 1
                if step == 25:
                    say("moving")
    except HexctlError as error:
        say(f"ended: {type(error).__name__}: {error}")
        return 3


def view(endpoint: str, count: str) -> None:
    """View until the process is ended."""
    keys = KeyMap.of("ant")
    settings = {"mode": "client", "connect/endpoints": [endpoint], "scouting/multicast/enabled": False}
    with ExitStack() as stack:
        for _ in range(int(count)):
            session = stack.enter_context(open_configured(settings))
            for kind in PUBLISHED:
                session.declare_subscriber(getattr(keys, kind), lambda _: None)
        say("viewing")
        threading.Event().wait()


def flood(port: str, data: str, per_second: str) -> None:
    """Send a datagram again and again."""
    say("flooding")
    datagram, per_s = bytes.fromhex(data), float(per_second)
    begun_s, sent = time.monotonic(), 0
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as stranger:
        while True:
            due = int((time.monotonic() - begun_s) * per_s) - sent if per_s else AT_ONCE
            for _ in range(due):
                stranger.sendto(datagram, ("127.0.0.1", int(port)))
            sent += due
            if per_s:
                time.sleep(PERIOD_S)


PROGRAMS: dict[str, Callable[..., int | None]] = {"sway": sway, "view": view, "flood": flood}

if __name__ == "__main__":
    sys.exit(PROGRAMS[sys.argv[1]](*sys.argv[2:]))
