"""Datagrams of a stop: how one is asked for and confirmed past everything that carries sessions.

All are of one length, 160 bytes, so that no answer is longer than what was asked, and all are signed with
the secret that both ends have (HMAC-SHA256). No clock takes part: a stop is good for one epoch of the robot,
which ends when a stop is cleared, and a question for one answer, which repeats its nonce.
"""

import hashlib
import hmac
import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache

from hexctl.errors import MessageError

#: Version of this format, part of the mark.
VERSION = 1

#: Mark, kind, flags, epoch, nonce, request, id of the stop, its reason, name of the robot.
_CONTENT = struct.Struct("<8sBB16s8s8s8s54s24s")

MAC_BYTES = hashlib.sha256().digest_size
DATAGRAM_BYTES = _CONTENT.size + MAC_BYTES

MARK_BYTES, EPOCH_BYTES, NONCE_BYTES, REQUEST_BYTES, ID_BYTES = 8, 16, 8, 8, 8

#: Where the kind and the nonce begin.
KIND_AT, NONCE_AT = 8, 26

#: Longest reason and name of a robot in bytes of UTF-8; the rest is cut off, in a reason with a mark.
REASON_BYTES, ROBOT_BYTES = 54, 24

NO_EPOCH, NO_REQUEST, NO_ID = bytes(EPOCH_BYTES), bytes(REQUEST_BYTES), bytes(ID_BYTES)

_STOPPED, _AT_REST, _KEPT, _ECHOED = 1, 2, 4, 8


class Kind(IntEnum):
    """What a datagram is: a question, a stop, or the answer to either."""

    ASK = 1
    STOP = 2
    STATE = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class StopDatagram:
    """A datagram.

    Attributes:
        kind: what it is.
        nonce: random bytes of the client, others in each datagram; an answer repeats them.
        epoch: of the robot: in an answer the one of now, in a stop the one in which it is good.
        request: name of a stop; an answer repeats it if the stop was obeyed, and has none otherwise.
        stop_id: of an answer: id of the stop in force; none where there is none.
        reason: of an answer: why the robot is stopped; empty where it is not.
        robot: of an answer: name of the robot.
        stopped: of an answer: whether a stop that stays is in force.
        at_rest: of an answer: whether no joint moves.
        kept: of an answer: whether the stop is on the disk.
        echoed: of an answer: whether its joint angles are the last targets, and not measured.
    """

    kind: Kind
    nonce: bytes
    epoch: bytes = NO_EPOCH
    request: bytes = NO_REQUEST
    stop_id: bytes = NO_ID
    reason: str = ""
    robot: str = ""
    stopped: bool = False
    at_rest: bool = False
    kept: bool = False
    echoed: bool = False

    def packed(self, secret: bytes) -> bytes:
        """The datagram, signed."""
        flags = _STOPPED * self.stopped | _AT_REST * self.at_rest | _KEPT * self.kept | _ECHOED * self.echoed
        content = _CONTENT.pack(
            mark_of(secret),
            self.kind,
            flags,
            self.epoch,
            self.nonce,
            self.request,
            self.stop_id,
            _shortened(self.reason, REASON_BYTES),
            _cut(self.robot, ROBOT_BYTES),
        )
        return content + _mac(secret, content)

    @classmethod
    def unpacked(cls, data: bytes, secret: bytes) -> "StopDatagram":
        """The datagram in some bytes.

        Raises MessageError for one that is none, or was signed with another secret.
        """
        if len(data) != DATAGRAM_BYTES or not hmac.compare_digest(data[:MARK_BYTES], mark_of(secret)):
            raise MessageError(f"datagram: got {len(data)} bytes; allowed: {DATAGRAM_BYTES} with our mark")
        content, mac = data[: _CONTENT.size], data[_CONTENT.size :]
        if not hmac.compare_digest(_mac(secret, content), mac):
            raise MessageError("datagram: got a wrong signature; allowed: one made with our secret")
        _, kind, flags, epoch, nonce, request, stop_id, reason, robot = _CONTENT.unpack(content)
        if kind not in tuple(Kind):
            raise MessageError(f"datagram: got kind {kind}; allowed: {', '.join(map(str, map(int, Kind)))}")
        return cls(
            kind=Kind(kind),
            nonce=nonce,
            epoch=epoch,
            request=request,
            stop_id=stop_id,
            reason=_text(reason),
            robot=_text(robot),
            stopped=bool(flags & _STOPPED),
            at_rest=bool(flags & _AT_REST),
            kept=bool(flags & _KEPT),
            echoed=bool(flags & _ECHOED),
        )


@lru_cache(maxsize=8)
def mark_of(secret: bytes) -> bytes:
    """First bytes of every datagram: what lacks them is dropped unread, by the kernel where it can.

    They are made of the secret, which they do not give away, so that strangers do not know them.
    """
    return _mac(secret, f"hexctl stop {VERSION}".encode())[:MARK_BYTES]


def _mac(secret: bytes, content: bytes) -> bytes:
    """HMAC-SHA256.

    Unlike `hmac.digest` it never gives up the interpreter, which a thread may get back 5 ms later.
    """
    keyed = _keyed(secret).copy()
    keyed.update(content)
    return keyed.digest()


@lru_cache(maxsize=8)
def _keyed(secret: bytes) -> hmac.HMAC:
    return hmac.new(secret, digestmod=hashlib.sha256)


def _shortened(text: str, most: int) -> bytes:
    """A text for people in so many bytes; one that is cut off ends with an ellipsis."""
    data = _encoded(text)
    if len(data) <= most:
        return data
    mark = "…".encode()
    return _cut(text, most - len(mark)) + mark


def _cut(text: str, most: int) -> bytes:
    return _encoded(text)[:most].decode(errors="ignore").encode()


def _encoded(text: str) -> bytes:
    """UTF-8, with `?` for what has none, such as half a character in what a driver said."""
    return text.encode(errors="replace")


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")
