"""Stops of a driver, sent to the robot by a thread, so that no control period waits for the network."""

import math
import threading
import time
from contextlib import ExitStack, suppress
from types import TracebackType
from typing import Any, Self

from hexctl.client.clear_keys import NewClaim
from hexctl.client.remote import ANY_ROBOT, RemoteRobots
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session

#: How long the end waits for a stop that is being sent, and the pause before one that failed is sent again.
END_S, AGAIN_S = 2.0, 0.1


class StopSender:
    """Stops the robot at a link when pressed, again until it confirms that; only a clear ends the stop.

    All stops that no clear came between have one claim, which this user can clear quickly.

    Args:
        link: to the robot.

    Attributes:
        clear_command: command that clears the stop.
        trouble: why the last stop did not reach the robot, or None.
    """

    def __init__(self, link: Link) -> None:
        self._link = link
        self.clear_command = link.clear_command
        self.trouble: str | None = None
        self._claim: str | None = None
        self._stop_ids: set[str] = set()
        self._due = threading.Event()
        self._pressed, self._until_s = False, math.inf
        self._thread = threading.Thread(target=self._run, name="stop sender", daemon=True)

    def __enter__(self) -> Self:
        """Begin to connect; returns immediately."""
        self._thread.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._until_s = time.monotonic() + END_S
        self._due.set()
        self._thread.join(END_S)

    def press(self) -> None:
        """Stop the robot now; from any thread, and without waiting."""
        self._pressed = True
        self._due.set()

    def _run(self) -> None:
        with ExitStack() as stack:
            robots: RemoteRobots | None = None
            with suppress(Exception):  # the next stop tries again
                robots = self._connected(stack)
            while self._wait():
                self._pressed = False
                try:
                    robots = robots or self._connected(stack)
                    self._stop(robots)
                    self.trouble = None
                except Exception as error:  # noqa: BLE001  the stop must go on being sent
                    self.trouble = f"the stop is not confirmed by the robot: {error}"
                    self._pressed = time.monotonic() < self._until_s
                    time.sleep(AGAIN_S)

    def _wait(self) -> bool:
        """Wait for a stop to send; False at the end, which lets one that is due go out first."""
        while not self._pressed:
            if math.isfinite(self._until_s):
                return False
            self._due.wait()
            self._due.clear()
        return True

    def _connected(self, stack: ExitStack) -> RemoteRobots:
        keys = KeyMap.of(ANY_ROBOT).renamed(dict(self._link.names))
        return RemoteRobots(stack.enter_context(open_session(self._link, Role.CONTROLLER, keys)), self._link)

    def _stop(self, robots: RemoteRobots) -> None:
        """Stop the robot, under a new claim if the last stop was cleared or repeated meanwhile."""
        if self._claim is not None:
            again = robots.stop(self._claim)
            if _stop_ids(again) <= self._stop_ids:
                return
        claimed = NewClaim()
        claimed.keep()
        answers = robots.stop(claimed.claim)
        self._claim, self._stop_ids = claimed.claim, _stop_ids(answers)


def _stop_ids(answers: list[dict[str, Any]]) -> set[str]:
    return {str(answer.get("stop_id")) for answer in answers}
