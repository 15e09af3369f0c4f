"""Encoding, decoding and signing of MAVLink 2 frames."""

import hashlib
import hmac
import re
import secrets
import struct
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pymavlink.dialects.v20 import common

from hexctl.errors import InputError
from hexctl.files import atomic_write, folder_trouble, read_file, read_key, state_folder, write_new

#: First byte of a MAVLink 2 frame, length of its header, its checksum, and its signature.
MAGIC, HEADER, CHECKSUM, SIGNATURE = 0xFD, 10, 2, 13

#: A heartbeat of MAVLink 1: magic, length, sequence, system, component, kind, and the version at its end.
HEARTBEAT_1 = re.compile(rb"\xfe\x09...\x00.{8}\x03", re.DOTALL)

#: The only flag a receiver may meet that changes how a frame is read.
SIGNED = 0x01

#: Time stamps of signatures count tens of microseconds since 2015-01-01.
EPOCH_2015_S = 1_420_070_400
STAMPS_PER_S = 100_000

#: How far behind the receiver's clock a new stream of signed frames may begin.
NEW_STREAM_SLACK_S = 60

KEY_BYTES = 32

#: What pymavlink may raise for arbitrary bytes.
DECODING_ERRORS = (common.MAVError, ValueError, TypeError, IndexError, KeyError, struct.error)

#: Name of the key in the folder that `--keys` names.
KEY_FILE = "mavlink.key"


@dataclass(frozen=True, slots=True)
class Frame:
    """A received message as pymavlink decodes it; its sequence number counts modulo 256."""

    message: Any
    kind: str
    sequence: int
    system: int
    component: int


class Codec:
    """Encoder and decoder of one end.

    MAVLink 1 is not understood: `of_mavlink_1` counts its heartbeats. A wrong checksum costs only the first
    byte, so garbage cannot hide a good frame. With a key, unsigned frames are refused; without one, signed
    frames are. `malformed` counts runs of undecodable bytes, and damaged or wrongly signed frames.

    Receivers refuse time stamps that do not grow. `stamp_file` keeps the last one from program to program,
    because the clock may be put back meanwhile.
    """

    def __init__(
        self, system: int, component: int, *, signing_key: bytes | None = None, stamp_file: Path | None = None
    ) -> None:
        if signing_key is not None and len(signing_key) != KEY_BYTES:
            raise InputError(f"signing key: got {len(signing_key)} bytes; allowed: {KEY_BYTES}")
        self.malformed = self.of_mavlink_1 = 0
        self._mavlink = _Mavlink(None, system, component)
        self._waiting = bytearray()
        self._in_garbage = False
        if signing_key is not None:
            self._mavlink.signing.secret_key = signing_key
            self._mavlink.signing.sign_outgoing = True
            self._mavlink.signing.timestamp = max(_stamp_now(), _stamp_in(stamp_file) + 1)
        self._stamp_file = stamp_file

    def keep_stamp(self) -> None:
        """Write the last time stamp to its file, if there is one; a full disk is no error."""
        if self._stamp_file is not None:
            with suppress(OSError):
                self._stamp_file.parent.mkdir(mode=0o700, parents=True, exist_ok=True)
                atomic_write(self._stamp_file, f"{self._mavlink.signing.timestamp}\n")

    def encode(self, message: Any, sequence: int) -> bytes:
        """The frame of a message; its sequence number counts modulo 256."""
        mavlink = self._mavlink
        if mavlink.signing.sign_outgoing:
            # pymavlink counts one up per frame; as time it stays true to what the receiver compares it with.
            mavlink.signing.timestamp = max(mavlink.signing.timestamp, _stamp_now())
        mavlink.seq = sequence % 256
        frame: bytes = message.pack(mavlink)
        return frame

    def decode(self, data: bytes, *, whole: bool) -> list[Frame]:
        """The messages in received bytes; `whole` for a datagram of complete frames, False for a stream."""
        if whole:
            self._in_garbage = False
        self._waiting += data
        frames, at = self._scan(self._waiting)
        if whole and at < len(self._waiting):
            self._garbage()
        self._waiting = bytearray() if whole else self._waiting[at:]
        return frames

    def _scan(self, data: bytearray) -> tuple[list[Frame], int]:
        """Frames, and where the last unfinished one begins."""
        frames: list[Frame] = []
        at = 0
        while True:
            start = data.find(MAGIC, at)
            if start != at and at < len(data):
                self._garbage()
                self.of_mavlink_1 += len(HEARTBEAT_1.findall(data, at, start if start > at else len(data)))
            if start < 0:
                return frames, len(data)
            at = start
            length = _frame_length(data, at)
            if length is None or at + length > len(data):
                return frames, at
            frame = self._frame(data[at : at + length]) if length else None
            if frame is None:
                self._garbage()
                at += 1
            else:
                self._in_garbage = False
                frames.append(frame)
                at += length

    def _garbage(self) -> None:
        self.malformed += 0 if self._in_garbage else 1
        self._in_garbage = True

    def _frame(self, data: bytearray) -> Frame | None:
        if int.from_bytes(data[7:10], "little") not in common.mavlink_map:
            return None
        if data[2] & SIGNED and self._mavlink.signing.secret_key is None:
            # A peer that signs expects signatures: accepting its frames would look like a working link.
            return None
        try:
            message = self._mavlink.decode(data)
        except DECODING_ERRORS:
            return None
        return Frame(message, message.get_type(), data[4], data[5], data[6])


def _frame_length(data: bytearray, at: int) -> int | None:
    """Length of the frame that begins here, None while unknown, 0 if none begins here."""
    if len(data) < at + 3:
        return None
    payload, flags = data[at + 1], data[at + 2]
    if flags & ~SIGNED:
        return 0
    return HEADER + payload + CHECKSUM + (SIGNATURE if flags & SIGNED else 0)


def _stamp_now() -> int:
    return int((time.time() - EPOCH_2015_S) * STAMPS_PER_S)


def _stamp_in(file: Path | None) -> int:
    """Time stamp in a file, below the upper half of its 48 bits; 0 without a valid one."""
    try:
        return 0 if file is None else int(read_file(file, 20)) % (1 << 47)
    except (OSError, ValueError):
        return 0


def stamp_file_of(key: bytes | None) -> Path | None:
    """File of the last time stamp that this user signed with a key."""
    return None if key is None else state_folder() / f"mavlink-{hashlib.sha256(key).hexdigest()[:16]}.stamp"


class _Mavlink(common.MAVLink):  # type: ignore[misc]  # pymavlink has no types
    """pymavlink's protocol with one vulnerability closed.

    pymavlink accepts the time stamp of a frame before it checks the signature: one forged frame from the far
    future locks out the owner of the key.
    """

    def check_signature(self, msgbuf: bytearray, srcSystem: int, srcComponent: int) -> bool:  # noqa: N803
        signing = self.signing
        signature = hashlib.sha256(signing.secret_key + msgbuf[:-6]).digest()[:6]
        if not hmac.compare_digest(signature, bytes(msgbuf[-6:])):
            return False
        stamp = int.from_bytes(msgbuf[-12:-6], "little")
        stream = (msgbuf[-13], srcSystem, srcComponent)
        oldest = max(signing.timestamp, _stamp_now()) - NEW_STREAM_SLACK_S * STAMPS_PER_S
        if stamp <= signing.stream_timestamps.get(stream, oldest):
            return False
        signing.stream_timestamps[stream] = stamp
        signing.timestamp = max(signing.timestamp, stamp)
        return True


def read_signing_key(folder: Path | None) -> bytes | None:
    """The signing key in a folder, or None without a folder; raises InputError for an invalid one."""
    return None if folder is None else read_key(folder / KEY_FILE, KEY_BYTES, f"hexctl keys mavlink {folder}")


def write_signing_key(folder: Path) -> Path:
    """Write a new key to a folder, readable only by its owner; the result is its file.

    Raises InputError if one exists already, or it cannot be written.
    """
    path = folder / KEY_FILE
    try:
        folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{folder_trouble(folder, error)}; allowed: a folder of yours") from error
    write_new(path, f"{secrets.token_hex(KEY_BYTES)}\n", "FOLDER", mode=0o600)
    return path
