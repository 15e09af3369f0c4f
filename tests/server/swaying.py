"""A controller that sways all joints until it is stopped: `-m tests.server.swaying ENDPOINT [OPTION ...]`.

Options: `again=1` to take a new lease whenever one is lost, over one session; `keys=FOLDER` of certificates.
"""

import sys
import time
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from hexctl.backends.clock import request_realtime_priority
from hexctl.backends.zenoh import zenoh_client
from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.control.guard import Guard
from hexctl.errors import HexctlError
from hexctl.types import JointTargets
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session
from tests.robots import shipped

SWAY_RAD = 0.25
SWAY_HZ = 0.8


class LentSession:
    """A session that is lent to one connection after another; what each of them declares ends with it.

    Otherwise the subscribers of all connections so far, each with a thread, would take the computer's time.
    """

    def __init__(self, session: Any) -> None:
        self._session = session
        self._declared: list[Any] = []

    def __getattr__(self, name: str) -> Any:
        return getattr(self._session, name)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        while self._declared:
            self._declared.pop().undeclare()

    def declare_subscriber(self, *arguments: Any, **options: Any) -> Any:
        """Declare a subscriber that ends with the connection."""
        self._declared.append(self._session.declare_subscriber(*arguments, **options))
        return self._declared[-1]

    def declare_publisher(self, *arguments: Any, **options: Any) -> Any:
        """Declare a publisher that ends with the connection."""
        self._declared.append(self._session.declare_publisher(*arguments, **options))
        return self._declared[-1]


def say(text: str) -> None:
    """Print a line and flush it."""
    sys.stdout.write(f"{text}\n")
    sys.stdout.flush()


def main(endpoint: str, *options: str) -> int:
    """Sway until killed or refused; print what happens."""
    request_realtime_priority()
    given = dict(option.split("=") for option in options)
    if "again" not in given:
        return control(endpoint, given)
    with open_session(link_of(endpoint, given), Role.CONTROLLER, KeyMap.of("ant")) as session:
        vars(zenoh_client)["open_session"] = lambda *_: LentSession(session)
        while True:
            control(endpoint, given)
            time.sleep(0.02)


def link_of(endpoint: str, given: dict[str, str]) -> Link:
    """Link with the certificates that were given."""
    return Link(endpoint=endpoint, credentials=Path(given["keys"]) if "keys" in given else None)


def control(endpoint: str, given: dict[str, str]) -> int:
    """Take the lease and sway until something goes wrong."""
    servos = ZenohServos(shipped(), link=link_of(endpoint, given))
    try:
        with Guard(servos) as guard:
            sway(guard)
    except HexctlError as error:
        say(f"ended: {type(error).__name__}: {error}")
        return 3
    return 0


def sway(guard: Guard) -> None:
    """Command a slow wave, and say when the joints move."""
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


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
