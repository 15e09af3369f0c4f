"""The datagram stop of a robot: a socket and a thread, independent of sessions."""

import random
import select
import socket
import threading
import time
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from itertools import islice, zip_longest
from typing import Any, Self

from hexctl.backends.clock import request_realtime_priority
from hexctl.errors import MessageError
from hexctl.server.stops.latch import StopLatch
from hexctl.wire.links import Endpoint, Link, Role
from hexctl.wire.stop import DATAGRAM_FROM
from hexctl.wire.stop_datagram import (
    DATAGRAM_BYTES,
    KIND_AT,
    NO_ID,
    NO_REQUEST,
    NONCE_AT,
    NONCE_BYTES,
    Kind,
    StopDatagram,
    find_stop_secret,
    mark_of,
)

#: Address of a sender.
Sender = tuple[Any, ...]

#: Minimum number of remembered nonces of answered datagrams; the maximum is twice as many.
MOST_NONCES = 1 << 14


class AnsweredNonces:
    """Nonces of answered datagrams. A client draws a new one for each request."""

    def __init__(self) -> None:
        self._newer: set[bytes] = set()
        self._older: set[bytes] = set()

    def __contains__(self, nonce: bytes) -> bool:
        return nonce in self._newer or nonce in self._older

    def add(self, nonce: bytes) -> None:
        """Note the nonce of a valid datagram, and forget the oldest if there are many."""
        self._newer.add(nonce)
        if len(self._newer) >= MOST_NONCES:
            self._older, self._newer = self._newer, set()


def unanswered(
    datagrams: Iterable[tuple[bytes, Sender]], mark: bytes, answered: AnsweredNonces
) -> dict[Kind, dict[bytes, Sender]]:
    """New stops, then new questions, of datagrams with the mark; of copies the sender is the first one."""
    found: dict[int, dict[bytes, Sender]] = {Kind.STOP: {}, Kind.ASK: {}}
    for data, sender in datagrams:
        if len(data) != DATAGRAM_BYTES or not data.startswith(mark):
            continue
        of_kind = found.get(data[KIND_AT])
        if of_kind is not None and data[NONCE_AT : NONCE_AT + NONCE_BYTES] not in answered:
            of_kind.setdefault(data, sender)
    return {Kind(kind): of_kind for kind, of_kind in found.items()}


def by_turns(datagrams: dict[bytes, Sender]) -> Iterator[tuple[bytes, Sender]]:
    """The newest of each sender, then the second of each: no sender can block another."""
    by_sender: defaultdict[Sender, list[bytes]] = defaultdict(list)
    for data, sender in reversed(datagrams.items()):
        by_sender[sender].append(data)
    senders = random.sample(list(by_sender), len(by_sender))
    for row in zip_longest(*(by_sender[sender] for sender in senders)):
        yield from ((data, sender) for data, sender in zip(row, senders, strict=True) if data is not None)


#: Interval at which the thread checks whether to end.
LOOK_S = 0.2

#: Real-time priority of the thread, if allowed: below that of the loop that moves the robot.
PRIORITY = 9

#: Receive buffer in bytes, about 800 per datagram, and most datagrams received at a time.
BUFFER_BYTES, MOST_RECEIVED = 8 << 20, 4096

#: Linux (asm-generic/socket.h): a buffer of any size, for root; otherwise net.core.rmem_max is the limit.
SO_RCVBUFFORCE = 33

#: Datagrams of each kind whose signatures are checked before the thread receives again.
MOST_CHECKED = 128

#: After more datagrams at a time than clients send, the thread rests for as long as they took, within these
#: bounds: the robot's loop keeps half of the time.
FLOOD, LEAST_REST_S, MOST_REST_S = 32, 0.001, 0.005


def _waiting_at(bound: socket.socket) -> Iterator[tuple[bytes, Sender]]:
    """Datagrams that wait, oldest first, with their senders; too long ones are cut to one byte too many."""
    with suppress(OSError):  # none waits, or an earlier answer did not arrive
        while True:
            yield bound.recvfrom(DATAGRAM_BYTES + 1)


def bound_socket(endpoint: Endpoint) -> socket.socket:
    """A UDP socket at an endpoint with a large receive buffer; raises OSError."""
    kind = socket.SOCK_DGRAM
    family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
    bound = socket.socket(family, kind)
    bound.setblocking(False)
    try:
        if family == socket.AF_INET6 and endpoint.is_everywhere:
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        for option in (socket.SO_RCVBUF, SO_RCVBUFFORCE):
            with suppress(OSError):  # only root may force it
                bound.setsockopt(socket.SOL_SOCKET, option, BUFFER_BYTES)
        bound.bind(address)
    except OSError:
        bound.close()
        raise
    return bound


class StopSocket:
    """Answers datagrams on the port of a robot's link, and stops the robot; a context manager.

    It stays closed if the port is in use, the link is QUIC, or the certificates lack the secret.

    Attributes:
        trouble: why there is no datagram stop, or why the last datagram had no answer, or None.
    """

    def __init__(
        self,
        link: Link,
        robot: str,
        latch: StopLatch,
        at_rest: Callable[[], bool],
        echoes: Callable[[], bool] = lambda: False,
    ) -> None:
        self._link, self._robot, self._latch = link, robot, latch
        self._at_rest, self._echoes = at_rest, echoes
        self._socket: socket.socket | None = None
        self._secret, self._nonces = b"", AnsweredNonces()
        self._thread: threading.Thread | None = None
        self._ended = False
        self._told = ""
        self._event: str | None = None
        self.trouble: str | None = None

    @property
    def port(self) -> int | None:
        """Its UDP port while it is open, or None."""
        return None if self._socket is None else int(self._socket.getsockname()[1])

    def take_event(self) -> str | None:
        """A line on new trouble since the last call, or None."""
        event, self._event = self._event, None
        return event

    def __enter__(self) -> Self:
        """Open it; raises InputError for a secret that may not be used."""
        endpoint = Endpoint.parse(self._link.endpoint)
        secret = find_stop_secret(self._link, Role.ROBOT)
        if endpoint.protocol == "quic":
            self.trouble = "a link over quic needs the port itself; tls has both"
        elif secret is None:
            self.trouble = f"{self._link.credentials} has no secret for it; hexctl keys stop makes one"
        else:
            self._open(endpoint, secret)
        return self

    def __exit__(self, *error: object) -> None:
        self._ended = True
        if self._thread is not None:
            self._thread.join()
        if self._socket is not None:
            self._socket.close()

    def _open(self, endpoint: Endpoint, secret: bytes) -> None:
        self._secret = secret
        try:
            self._socket = bound_socket(endpoint)
        except (OSError, UnicodeError) as error:  # the second of a name that no host can have
            reason = getattr(error, "strerror", None) or error
            self.trouble = f"UDP port {endpoint.port} cannot be opened ({reason})"
            return
        self._thread = threading.Thread(target=self._serve, args=(self._socket,), name="stop", daemon=True)
        self._thread.start()

    def _serve(self, bound: socket.socket) -> None:
        request_realtime_priority(PRIORITY)
        poll = select.poll()
        poll.register(bound, select.POLLIN)
        while not self._ended:
            if poll.poll(1000 * LOOK_S):
                began_s, datagrams = time.monotonic(), list(islice(_waiting_at(bound), MOST_RECEIVED))
                try:
                    self._answer_round(bound, datagrams)
                except Exception as error:  # noqa: BLE001  the stop must go on answering
                    self._tell(error)
                if len(datagrams) > FLOOD:
                    time.sleep(min(max(LEAST_REST_S, time.monotonic() - began_s), MOST_REST_S))

    def _answer_round(self, bound: socket.socket, datagrams: list[tuple[bytes, Sender]]) -> None:
        """Stops are answered first; one datagram of a kind from each sender."""
        for waiting in unanswered(datagrams, mark_of(self._secret), self._nonces).values():
            served: set[Sender] = set()
            unserved = ((data, sender) for data, sender in by_turns(waiting) if sender not in served)
            for data, sender in islice(unserved, MOST_CHECKED):
                try:
                    answer = self.answer(data, str(sender[0]).removeprefix("::ffff:"))
                except Exception as error:  # noqa: BLE001  the next one must be answered
                    self._tell(error)
                    continue
                if answer is not None:
                    self.trouble = None
                    served.add(sender)
                    self._nonces.add(data[NONCE_AT : NONCE_AT + NONCE_BYTES])
                    with suppress(OSError):
                        bound.sendto(answer, sender)

    def _tell(self, error: Exception) -> None:
        self.trouble = f"a datagram to the stop could not be answered ({type(error).__name__}: {error})"
        if self.trouble != self._told:
            self._told = self._event = self.trouble

    def answer(self, data: bytes, host: str = "an unknown host") -> bytes | None:
        """Execute a datagram from a host and return the answer; None for a foreign one."""
        try:
            asked = StopDatagram.unpacked(data, self._secret)
        except MessageError:
            return None
        if asked.kind is Kind.STATE:
            return None
        obeyed = asked.kind is Kind.STOP and self._latch.stop_in(
            asked.epoch, asked.request.hex(), by=f"{DATAGRAM_FROM}{host}"
        )
        return self._state(asked, obeyed=obeyed).packed(self._secret)

    def _state(self, asked: StopDatagram, *, obeyed: bool) -> StopDatagram:
        stop, on_disk = self._latch.now()
        return StopDatagram(
            kind=Kind.STATE,
            nonce=asked.nonce,
            epoch=self._latch.epoch,
            request=asked.request if obeyed else NO_REQUEST,
            stop_id=NO_ID if stop is None else bytes.fromhex(stop.stop_id),
            reason="" if stop is None else stop.reason,
            robot=self._robot,
            stopped=stop is not None and stop.stays,
            at_rest=self._at_rest(),
            on_disk=on_disk,
            echoed=self._echoes(),
        )
