"""The datagram stop of a robot: a socket and a thread that share nothing with what carries sessions."""

import ctypes
import socket
import struct
import threading
import time
from collections.abc import Callable
from contextlib import suppress
from types import TracebackType
from typing import Self

from hexctl.errors import MessageError
from hexctl.serve.stops.latch import StopLatch
from hexctl.serve.stops.stop import DATAGRAM_FROM
from hexctl.wire.links import Endpoint, Link, Role
from hexctl.wire.stop_datagram import DATAGRAM_BYTES, NO_ID, NO_REQUEST, Kind, StopDatagram, mark_of
from hexctl.wire.stop_secret import find_stop_secret

#: How often the thread looks whether it is to end.
LOOK_S = 0.2

#: After so many datagrams in a row the thread rests for a while: a flood that has found out the mark, or
#: repeats a question that it has heard, leaves most of the time to what moves the robot.
MOST_IN_A_ROW, REST_S = 64, 0.005

#: Space for datagrams that wait, in bytes; the kernel counts each as about 800.
BUFFER_BYTES = 1 << 20

#: Linux: a program that the kernel runs for each datagram (asm-generic/socket.h).
SO_ATTACH_FILTER = 26

#: The header in front of a datagram as such a program sees it.
UDP_HEADER_BYTES = 8


class StopSocket:
    """Answers datagrams on the port of a robot's link, and stops the robot; open while the block runs.

    A port that cannot be had, a link over QUIC, which needs it itself, and a folder of certificates without
    the secret leave the robot without: `trouble` says why.

    Args:
        link: of the robot.
        robot: name of the robot.
        latch: stops it.
        at_rest: whether no joint moves.
        echoes: whether the joint angles by which that is known are only targets.

    Attributes:
        trouble: why there is no datagram stop, or why the last datagram had no answer, or None.
        answered: datagrams answered so far.
        dropped: datagrams so far that were not ours; what the kernel drops is not counted.
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
        self._secret = b""
        self._thread: threading.Thread | None = None
        self._ended = False
        self._told = ""
        self._event: str | None = None
        self.trouble: str | None = None
        self.answered = self.dropped = 0

    @property
    def port(self) -> int | None:
        """Its UDP port while it is open, or None."""
        return None if self._socket is None else int(self._socket.getsockname()[1])

    def take_event(self) -> str | None:
        """A line on trouble that has come since the last call, or None."""
        event, self._event = self._event, None
        return event

    def __enter__(self) -> Self:
        """Open it.

        Raises InputError for a secret that may not be used.
        """
        endpoint = Endpoint.parse(self._link.endpoint)
        secret = find_stop_secret(self._link, Role.ROBOT)
        if endpoint.protocol == "quic":
            self.trouble = "a link over quic needs the port itself; tls has both"
        elif secret is None:
            self.trouble = f"{self._link.credentials} has no secret for it; hexctl keys stop makes one"
        else:
            self._open(endpoint, secret)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._ended = True
        if self._thread is not None:
            self._thread.join()
        if self._socket is not None:
            self._socket.close()

    def _open(self, endpoint: Endpoint, secret: bytes) -> None:
        self._secret = secret
        try:
            self._socket = _bound(endpoint)
        except (OSError, UnicodeError) as error:  # the second of a name that no host can have
            reason = getattr(error, "strerror", None) or error
            self.trouble = f"UDP port {endpoint.port} cannot be had ({reason})"
            return
        _filter(self._socket, mark_of(secret))
        self._socket.settimeout(LOOK_S)
        self._thread = threading.Thread(target=self._serve, name="stop", daemon=True)
        self._thread.start()

    def _serve(self) -> None:
        assert self._socket is not None  # noqa: S101  for the type
        in_a_row = 0
        while not self._ended:
            try:
                data, sender = self._socket.recvfrom(DATAGRAM_BYTES + 1)
            except OSError:  # nothing came, or an earlier answer did not arrive
                in_a_row = 0
                continue
            answer = self._answer_or_tell(data, str(sender[0]).removeprefix("::ffff:"))
            if answer is not None:
                with suppress(OSError):
                    self._socket.sendto(answer, sender)
            in_a_row += 1
            if in_a_row >= MOST_IN_A_ROW:
                in_a_row = 0
                time.sleep(REST_S)

    def _answer_or_tell(self, data: bytes, host: str) -> bytes | None:
        """Answer a datagram; what fails is trouble, and the next one is answered."""
        try:
            answer = self.answer(data, host)
        except Exception as error:  # noqa: BLE001  the stop must go on answering
            self.trouble = f"a datagram to the stop could not be answered ({type(error).__name__}: {error})"
            if self.trouble != self._told:
                self._told = self._event = self.trouble
            return None
        if answer is not None:
            self.trouble = None
        return answer

    def answer(self, data: bytes, host: str = "an unknown host") -> bytes | None:
        """Do what a datagram from a host asks for; the answer, or None for one that is not ours."""
        try:
            asked = StopDatagram.unpacked(data, self._secret)
        except MessageError:
            asked = None
        if asked is None or asked.kind is Kind.STATE:
            self.dropped += 1
            return None
        obeyed = asked.kind is Kind.STOP and self._latch.stop_in(
            asked.epoch, asked.request.hex(), by=f"{DATAGRAM_FROM}{host}"
        )
        self.answered += 1
        return self._state(asked, obeyed=obeyed).packed(self._secret)

    def _state(self, asked: StopDatagram, *, obeyed: bool) -> StopDatagram:
        stop, kept = self._latch.now()
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
            kept=kept,
            echoed=self._echoes(),
        )


def _bound(endpoint: Endpoint) -> socket.socket:
    """UDP socket at an endpoint; raises OSError."""
    kind = socket.SOCK_DGRAM
    family, _, _, _, address = socket.getaddrinfo(endpoint.host, endpoint.port, type=kind)[0]
    bound = socket.socket(family, kind)
    try:
        if family == socket.AF_INET6 and endpoint.is_everywhere:
            bound.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 0)
        bound.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, BUFFER_BYTES)
        bound.bind(address)
    except OSError:
        bound.close()
        raise
    return bound


def _filter(bound: socket.socket, mark: bytes) -> None:
    """Let the kernel drop what lacks the length and the mark, without waking the thread; Linux only.

    A classic BPF program: load a word, compare, skip so many lines if equal, so many if not.
    """
    first, second = struct.unpack(">II", mark)
    program = (
        (0x80, 0, 0, 0),  # length
        (0x15, 0, 5, UDP_HEADER_BYTES + DATAGRAM_BYTES),
        (0x20, 0, 0, UDP_HEADER_BYTES),  # first word
        (0x15, 0, 3, first),
        (0x20, 0, 0, UDP_HEADER_BYTES + 4),  # second word
        (0x15, 0, 1, second),
        (0x06, 0, 0, 0xFFFFFFFF),  # take it
        (0x06, 0, 0, 0),  # drop it
    )
    lines = ctypes.create_string_buffer(b"".join(struct.pack("HBBI", *line) for line in program))
    with suppress(OSError):
        where = struct.pack("HL", len(program), ctypes.addressof(lines))
        bound.setsockopt(socket.SOL_SOCKET, SO_ATTACH_FILTER, where)
