"""A client's session for a stop, opened in advance if possible; it queries until all robots are at rest."""

import threading
import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

from hexctl.client.clear_keys import StopOrder
from hexctl.client.datagram_stop import Sighting
from hexctl.errors import HexctlError, RobotFaultError
from hexctl.wire.links import Link, Role
from hexctl.wire.stop import LIFTED_BY_LEASE, TOO_MANY

if TYPE_CHECKING:
    from hexctl.client.remote import RemoteRobots

#: Pause between two queries after a stop, and before one; also between attempts to open a session.
WATCH_PERIOD_S, ASK_PERIOD_S = 0.1, 0.5


class SessionStop:
    """Queries the robots on a link over a session, and stops them when ordered, on its own thread.

    Attributes:
        error: why there is no session, or why a robot has not stopped; otherwise None.
        obeyed: name of the stop that they confirmed, unless one has cleared it since; otherwise None.
    """

    def __init__(
        self,
        link: Link,
        order: StopOrder,
        see: Callable[[Sighting], None],
        *,
        again: bool,
    ) -> None:
        self._link, self._order, self._see = link, order, see
        self._again = again
        self._due = threading.Event()
        self._ends = self._all_stay = False
        self._known: set[str] = set()  # robots to stop
        self._claimed: set[tuple[str, bytes]] = set()  # robots and claims that their status has had
        self.error: HexctlError | None = None
        self.answers: list[dict[str, Any]] = []
        self.obeyed: bytes | None = None
        self.opened = self.ended = False
        # No daemon: a process that ends while a session opens would not close it.
        self._thread = threading.Thread(target=self._run, name="stop by session")

    def begin(self) -> None:
        """Begin to open a session."""
        self._thread.start()

    def wake(self) -> None:
        """Check immediately whether the robots are to stop."""
        self._due.set()

    def end(self) -> None:
        """End the thread, after a session in the course of opening."""
        self._ends = True
        self._due.set()

    def _run(self) -> None:
        try:
            from zenoh import ZError

            while not self._ends:
                try:
                    self._ask()
                except HexctlError as error:
                    self.error = error
                except ZError as error:
                    self.error = RobotFaultError(f"the session failed: {error}")
                self.opened = False
                if not self._again:
                    return
                self._pause(2 * ASK_PERIOD_S)
        finally:
            self.ended = True

    def _ask(self) -> None:
        from hexctl.client.remote import remote_robots

        with remote_robots(self._link, Role.CONTROLLER) as robots:
            self.opened, self.error, self._all_stay = True, None, False
            while not self._ends:
                if self._order.wanted.is_set() and not self._all_stay:
                    self._stop(robots)
                self._look(robots)
                self._pause(WATCH_PERIOD_S if self._order.wanted.is_set() else ASK_PERIOD_S)

    def _stop(self, robots: "RemoteRobots") -> None:
        """Ask all robots to stop; a repeated request renews nothing."""
        request = self._order.request
        answers = robots.stop(request.hex())
        self.obeyed, names = request, _names(answers)
        self._known |= names
        self.answers = [one for one in self.answers if not _names([one]) & names] + answers

    def _look(self, robots: "RemoteRobots") -> None:
        asked_s, pressed = time.monotonic(), self._order.wanted.is_set()
        self._all_stay = False
        statuses = robots.statuses()
        if not statuses:
            self.error = RobotFaultError(f"no robot answers at {self._link.endpoint}; is hexctl serve there?")
            return
        moving = _names([one for one in statuses if not _stays(one)])
        cleared = moving | _names([one for one in statuses if self._lost_claim(one)])
        if self.obeyed is not None and cleared & _names(self.answers):
            self._order.cleared(self.obeyed)
            self.obeyed = None
        self._known = self._known | _names(statuses) if pressed else _names(statuses)
        stopped = [status.get("stopped") for status in statuses]
        left = self._known - _names(statuses) | moving
        stays = not left
        self._all_stay = stays and self.obeyed is not None and self._known <= _names(self.answers)
        self.error = None
        if self.answers and left:
            self.error = RobotFaultError(f"asked to stop, and not seen stopped: {', '.join(sorted(left))}")
        stops = [one for status in statuses if isinstance(one := status.get("stop"), dict)]
        self._see(
            Sighting(
                at_s=asked_s,
                stopped=str(stopped[0]) if stays else None,
                stop_id=str(stops[0].get("id")) if stays and stops else None,
                at_rest=all(status.get("at_rest") is True for status in statuses),
                kept=bool(stops) and all(one.get("kept") for one in stops),
                robot=str(statuses[0].get("robot", "?")),
                echoed=any(status.get("joints") == "echoed" for status in statuses),
                cleared=_cleared(statuses),
            )
        )

    def _lost_claim(self, status: dict[str, Any]) -> bool:
        """Whether the stop of a robot no longer has the claim that it had: it was cleared meanwhile."""
        stop = status.get("stop")
        claims = stop.get("claims") if isinstance(stop, dict) else None
        if not isinstance(claims, list) or self.obeyed is None:
            return False
        claimed = str(status.get("robot")), self.obeyed
        if self.obeyed.hex() in claims:
            self._claimed.add(claimed)
        return claimed in self._claimed and self.obeyed.hex() not in claims and TOO_MANY not in claims

    def _pause(self, duration_s: float) -> None:
        self._due.wait(duration_s)
        self._due.clear()


def _stays(status: dict[str, Any]) -> bool:
    return status.get("stopped") not in (None, LIFTED_BY_LEASE)


def _cleared(statuses: list[dict[str, Any]]) -> tuple[str, str] | None:
    cleared = (one for status in statuses if isinstance(one := status.get("cleared"), dict))
    return next(((str(one.get("id")), str(one.get("by"))) for one in cleared), None)


def _names(messages: list[dict[str, Any]]) -> set[str]:
    return {str(one.get("robot", "?")) for one in messages}
