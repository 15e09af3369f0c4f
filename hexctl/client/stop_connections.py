"""Two connections that stop a robot and watch it come to rest: UDP datagrams and a Zenoh session."""

import math
import secrets
import select
import socket
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from hexctl.client.clear_keys import StopOrder
from hexctl.errors import HexctlError, InputError, MessageError, RobotFaultError, printable
from hexctl.wire.links import Endpoint, Link, Role
from hexctl.wire.stop import LIFTED_BY_LEASE, TOO_MANY
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, NONCE_BYTES, Kind, StopDatagram, find_stop_secret

if TYPE_CHECKING:
    from hexctl.client.remote import RemoteRobots

#: Pause between two datagrams of a stop, and of queries without a stop.
STOP_PERIOD_S, ASK_PERIOD_S = 0.05, 0.25

#: Queries whose answers still count.
MOST_ASKED = 256

#: Addresses of a host to which datagrams are sent.
MOST_ADDRESSES = 4

#: After this silence the robot's address is looked up again.
LOOK_UP_AGAIN_S = 5.0

#: Result of `socket.getaddrinfo`.
Addresses = list[tuple[socket.AddressFamily, tuple[object, ...]]]


@dataclass(frozen=True, slots=True, kw_only=True)
class Sighting:
    """State that a robot reported, at a time on time.monotonic.

    Attributes:
        stopped: reason of a latched stop, or None.
        on_disk: whether the stop is on the disk.
        echoed: whether `at_rest` is known only from targets, because the servos do not report their angles.
        cleared: id of the last cleared stop, and who cleared it.
    """

    at_s: float
    stopped: str | None
    stop_id: str | None
    at_rest: bool
    on_disk: bool
    robot: str
    echoed: bool = False
    cleared: tuple[str, str] | None = None


class DatagramStop:
    """Queries a robot by datagram, and stops it when ordered, on its own thread, which calls `see`.

    Attributes:
        trouble: why no datagram can be sent, or None.
        obeyed: name of the stop that the robot has confirmed and not cleared since, or None.
    """

    def __init__(self, link: Link, order: StopOrder, see: Callable[[Sighting], None]) -> None:
        self._link, self._order, self._see = link, order, see
        self._epoch: bytes | None = None
        self._asked: dict[bytes, float] = {}  # nonces without an answer
        self._secret = b""
        self._ended = False
        self._wake_read, self._wake_write = socket.socketpair()
        self._sockets = _sockets_by_family()
        self._poll = select.poll()  # unlike select, also in a program with thousands of open files
        for one in (*self._sockets.values(), self._wake_read):
            self._poll.register(one, select.POLLIN)
        self._heard_s = self._looked_up_s = -math.inf
        self._looking_up: threading.Thread | None = None
        self._addresses: Addresses = []
        self._thread = threading.Thread(target=self._run, name="stop by datagram", daemon=True)
        self.trouble: str | None = None
        self.obeyed: bytes | None = None
        self._obeyed_s = -math.inf  # when the last answer of a robot that obeyed was asked for

    def begin(self) -> None:
        """Start the thread once; a bad secret or address is trouble, not an error."""
        if self._thread.ident is not None:
            return
        try:
            secret = find_stop_secret(self._link, Role.CONTROLLER)
            endpoint = Endpoint.parse(self._link.endpoint)
        except InputError as error:
            self.trouble = str(error)
            return
        if secret is None:
            self.trouble = f"{self._link.credentials} has no stop.key; hexctl keys stop makes one"
        elif endpoint.protocol == "quic":
            self.trouble = "a robot on quic takes no datagrams"
        else:
            self._secret = secret
            self._thread.start()

    def wake(self) -> None:
        """Check immediately whether the robot is to stop."""
        with suppress(OSError):
            self._wake_write.send(b".")

    def end(self) -> None:
        """End the thread and close everything."""
        self._ended = True
        self.wake()
        if self._thread.ident is not None:
            self._thread.join()
        for one in (*self._sockets.values(), self._wake_read, self._wake_write):
            one.close()

    def _run(self) -> None:
        while not self._ended:
            try:
                self._ask_once()
            except Exception as error:  # noqa: BLE001  the stop must go on asking
                self.trouble = f"datagrams fail here ({type(error).__name__}: {error})"
                time.sleep(STOP_PERIOD_S)

    def _ask_once(self) -> None:
        period_s = STOP_PERIOD_S if self._order.ordered.is_set() else ASK_PERIOD_S
        self._follow_host()
        self._send()
        until_s = time.monotonic() + period_s
        while not self._ended and (left_s := until_s - time.monotonic()) > 0:
            if self._wait(left_s):
                break

    def _follow_host(self) -> None:
        """A silent robot may have a new address."""
        now_s = time.monotonic()
        silent_s = now_s - max(self._heard_s, self._looked_up_s)
        looks_up = self._looking_up is not None and self._looking_up.is_alive()
        if not looks_up and silent_s > (LOOK_UP_AGAIN_S if self._addresses else ASK_PERIOD_S):
            self._looked_up_s = now_s
            # Resolving takes seconds on a broken network, and a stop must not wait.
            self._looking_up = threading.Thread(target=self._look_up, name="robot's address", daemon=True)
            self._looking_up.start()

    def _look_up(self) -> None:
        endpoint = Endpoint.parse(self._link.endpoint)
        try:
            found = socket.getaddrinfo(endpoint.host, endpoint.port, type=socket.SOCK_DGRAM)
        except (OSError, UnicodeError) as error:  # the second of a name that no host can have
            self.trouble = f"{endpoint.host} is not known here ({getattr(error, 'strerror', None) or error})"
            return
        self._addresses = [(family, address) for family, _, _, _, address in found[:MOST_ADDRESSES]]
        self.trouble = None
        self.wake()

    def _send(self) -> None:
        """Each datagram gets its own nonce: a robot answers a nonce only once."""
        for family, address in self._addresses:
            with suppress(OSError, KeyError):  # a computer without this family
                self._sockets[family].sendto(self._next_datagram(), address)

    def _next_datagram(self) -> bytes:
        nonce = secrets.token_bytes(NONCE_BYTES)
        while len(self._asked) >= MOST_ASKED:
            del self._asked[next(iter(self._asked))]
        self._asked[nonce] = time.monotonic()
        datagram = StopDatagram(kind=Kind.ASK, nonce=nonce)
        request = self._order.request
        obeys = self.obeyed == request and self._obeyed_s >= self._order.pressed_s
        if self._order.ordered.is_set() and not obeys and self._epoch is not None:
            datagram = StopDatagram(kind=Kind.STOP, nonce=nonce, epoch=self._epoch, request=request)
        return datagram.packed(self._secret)

    def _wait(self, timeout_s: float) -> bool:
        """Take what arrives within a time; return whether to send immediately."""
        sockets = {one.fileno(): one for one in (*self._sockets.values(), self._wake_read)}
        at_once = False
        for number, _ in self._poll.poll(1000 * timeout_s):
            one = sockets[number]
            with suppress(OSError):
                data = one.recv(DATAGRAM_BYTES + 1)
                at_once = (True if one is self._wake_read else self._take(data)) or at_once
        return at_once

    def _take(self, data: bytes) -> bool:
        """Take an answer; return whether the robot can now be stopped."""
        with suppress(HexctlError, KeyError):
            answer = StopDatagram.unpacked(data, self._secret)
            if answer.kind is not Kind.STATE:
                raise MessageError("datagram: got a question; allowed: an answer")
            asked_s = self._asked.pop(answer.nonce)  # each answer counts once
            self._heard_s = time.monotonic()
            new_epoch, self._epoch = answer.epoch != self._epoch, answer.epoch
            if self.obeyed is not None and (new_epoch or not answer.stopped):
                self._order.cleared(self.obeyed)
                self.obeyed = None
            if answer.stopped and answer.request == self._order.request:
                self.obeyed, self._obeyed_s = answer.request, asked_s
            self._see(_sighting(answer, asked_s))
            return new_epoch and self._order.ordered.is_set() and self.obeyed is None
        return False


def _sockets_by_family() -> dict[socket.AddressFamily, socket.socket]:
    found: dict[socket.AddressFamily, socket.socket] = {}
    for family in (socket.AF_INET, socket.AF_INET6):
        with suppress(OSError):
            found[family] = socket.socket(family, socket.SOCK_DGRAM)
            found[family].setblocking(False)
    return found


def _sighting(answer: StopDatagram, asked_s: float) -> Sighting:
    return Sighting(
        at_s=asked_s,
        stopped=printable(answer.reason) if answer.stopped else None,
        stop_id=answer.stop_id.hex() if answer.stopped else None,
        at_rest=answer.at_rest,
        on_disk=answer.on_disk,
        robot=printable(answer.robot),
        echoed=answer.echoed,
    )


#: Pause between two queries of a session after a stop, and before one; also between attempts to open one.
SESSION_WATCH_S, SESSION_ASK_S = 0.1, 0.5


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
                self._pause(2 * SESSION_ASK_S)
        finally:
            self.ended = True

    def _ask(self) -> None:
        from hexctl.client.remote import remote_robots

        with remote_robots(self._link, Role.CONTROLLER) as robots:
            self.opened, self.error, self._all_stay = True, None, False
            while not self._ends:
                if self._order.ordered.is_set() and not self._all_stay:
                    self._stop(robots)
                self._look(robots)
                self._pause(SESSION_WATCH_S if self._order.ordered.is_set() else SESSION_ASK_S)

    def _stop(self, robots: "RemoteRobots") -> None:
        """Ask all robots to stop; a repeated request renews nothing."""
        request = self._order.request
        answers = robots.stop(request.hex())
        self.obeyed, names = request, _names(answers)
        self._known |= names
        self.answers = [one for one in self.answers if not _names([one]) & names] + answers

    def _look(self, robots: "RemoteRobots") -> None:
        asked_s, pressed = time.monotonic(), self._order.ordered.is_set()
        self._all_stay = False
        statuses = robots.statuses()
        if not statuses:
            where = self._link.endpoint
            self.error = RobotFaultError(f"no robot answers at {where}; is hexctl serve running there?")
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
                on_disk=bool(stops) and all(one.get("kept") for one in stops),
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
