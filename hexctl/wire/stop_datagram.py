"""Datagrams of a stop, independent of sessions, and the secret that signs them.

All have 160 bytes, so that answers do not amplify, and are signed with the shared secret (HMAC-SHA256). They
use no clock: a stop is valid for one epoch of the robot, which ends with a clear, and an answer repeats the
nonce of its query. The secret has its own file: a stop must not depend on certificates.
"""

import hashlib
import hmac
import os
import secrets
import struct
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from pathlib import Path

from hexctl.errors import InputError, MessageError
from hexctl.files import read_key, write_new
from hexctl.wire.links import Link, Role

#: Version of this format, part of the mark.
VERSION = 1

#: Mark, kind, flags, epoch, nonce, request, id of the stop, its reason, name of the robot.
_CONTENT = struct.Struct("<8sBB16s8s8s8s54s24s")

MAC_BYTES = hashlib.sha256().digest_size
DATAGRAM_BYTES = _CONTENT.size + MAC_BYTES

MARK_BYTES, EPOCH_BYTES, NONCE_BYTES, REQUEST_BYTES, ID_BYTES = 8, 16, 8, 8, 8

#: Offsets of the kind and the nonce.
KIND_AT, NONCE_AT = 8, 26

#: Longest reason and name of a robot in bytes of UTF-8; longer ones are cut, a reason with a mark.
REASON_BYTES, ROBOT_BYTES = 54, 24

NO_EPOCH, NO_REQUEST, NO_ID = bytes(EPOCH_BYTES), bytes(REQUEST_BYTES), bytes(ID_BYTES)

_STOPPED, _AT_REST, _KEPT, _ECHOED = 1, 2, 4, 8


class Kind(IntEnum):
    """Kind of a datagram: a query, a stop, or an answer."""

    ASK = 1
    STOP = 2
    STATE = 3


@dataclass(frozen=True, slots=True, kw_only=True)
class StopDatagram:
    """A datagram; fields from `stop_id` on are those of an answer.

    Attributes:
        nonce: random bytes of the client, new in each datagram; an answer repeats them.
        epoch: current one in an answer, the one of validity in a stop.
        request: name of a stop; an answer repeats it if the stop was obeyed, and is otherwise empty.
        stopped: whether a latched stop is in force.
        on_disk: whether the stop is on the disk.
        echoed: whether joint angles are targets instead of measured.
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
    on_disk: bool = False
    echoed: bool = False

    def packed(self, secret: bytes) -> bytes:
        """The datagram, signed."""
        flags = (
            _STOPPED * self.stopped | _AT_REST * self.at_rest | _KEPT * self.on_disk | _ECHOED * self.echoed
        )
        content = _CONTENT.pack(
            mark_of(secret),
            self.kind,
            flags,
            self.epoch,
            self.nonce,
            self.request,
            self.stop_id,
            _fitted(self.reason, REASON_BYTES, "…"),
            _fitted(self.robot, ROBOT_BYTES),
        )
        return content + _mac(secret, content)

    @classmethod
    def unpacked(cls, data: bytes, secret: bytes) -> "StopDatagram":
        """Decode a datagram; raises MessageError if it is malformed or signed with another secret."""
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
            on_disk=bool(flags & _KEPT),
            echoed=bool(flags & _ECHOED),
        )


@lru_cache(maxsize=8)
def mark_of(secret: bytes) -> bytes:
    """First bytes of every datagram, derived from the secret; others are dropped unread."""
    return _mac(secret, f"hexctl stop {VERSION}".encode())[:MARK_BYTES]


def _mac(secret: bytes, content: bytes) -> bytes:
    """Unlike `hmac.digest` it never releases the interpreter, which may come back 5 ms later."""
    keyed = _keyed(secret).copy()
    keyed.update(content)
    return keyed.digest()


@lru_cache(maxsize=8)
def _keyed(secret: bytes) -> hmac.HMAC:
    return hmac.new(secret, digestmod=hashlib.sha256)


def _fitted(text: str, most: int, mark: str = "") -> bytes:
    """UTF-8, with `?` for lone surrogates; a text that is cut ends with the mark."""
    data, end = text.encode(errors="replace"), mark.encode()
    if len(data) <= most:
        return data
    return data[: most - len(end)].decode(errors="ignore").encode() + end


def _text(data: bytes) -> str:
    return data.rstrip(b"\0").decode(errors="replace")


SECRET_FILE = "stop.key"  # noqa: S105  its name

SECRET_BYTES = 32

#: Signs datagrams without certificates: anyone who reaches the robot may stop it.
NO_SECRET = b""

STOP_ROLES = (Role.ROBOT, Role.CONTROLLER)


def write_stop_secret(folder: Path) -> list[Path]:
    """Create a secret in a folder of `hexctl keys new`; return its files.

    Raises InputError if there is one already, if an end is missing, or if the folder is not writable.
    """
    places = [folder / role.value for role in STOP_ROLES]
    for place in places:
        if not place.is_dir():
            raise InputError(f"{place}: is missing; allowed: a complete folder from hexctl keys new")
    content, written = f"{secrets.token_hex(SECRET_BYTES)}\n".encode(), list[Path]()
    try:
        for place in places:
            write_new(place / SECRET_FILE, content, "FOLDER", mode=0o600)
            written.append(place / SECRET_FILE)
    except InputError:
        for path in written:  # both ends need the same secret
            path.unlink(missing_ok=True)
        raise
    return written


def find_stop_secret(link: Link, role: Role) -> bytes | None:
    """Secret of one end of a link: `NO_SECRET` without certificates, None for a folder without a secret.

    Raises InputError for an invalid file, or one that others may read.
    """
    if link.credentials is None:
        return NO_SECRET
    for path in (link.credentials / role.value / SECRET_FILE, link.credentials / SECRET_FILE):
        if os.path.lexists(path):  # a dangling link is a key that cannot be read, not a missing one
            return read_key(path, SECRET_BYTES, "hexctl keys stop")
    return None
