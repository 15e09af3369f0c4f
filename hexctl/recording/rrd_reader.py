"""Reads files of Rerun (.rrd) with Arrow: Rerun's own reader loses all that follows a hole.

Messages of chunks are protobuf with an LZ4-compressed Arrow stream, in the version `RERUN`.
"""

import logging
import os
import re
import struct
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from itertools import islice
from pathlib import Path
from typing import Any, BinaryIO

from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.recording.rrd import RERUN, still_there

_LOG = logging.getLogger(__name__)

#: Start of a file, length of the rest of its head, and the head of a message.
MAGIC, HEAD_BYTES, MESSAGE_HEAD = b"RRF2", 12, struct.Struct("<QQ")

#: Bytes after the last message of a file with an index: its place, and `END`.
INDEX_END_BYTES, END = 32, b"RRF2FOOT"

#: Kinds of messages: the last one of a file, one with a chunk, and the highest.
LAST, CHUNK, MOST_KIND = 0, 2, 3

#: Beginning of a chunk, bytes searched together for it behind damage, and most bytes decoded in vain.
CHUNK_BEGIN, SEARCHED_BYTES, MOST_BYTES = re.compile(rb"\x02\0{7}.{8}\x0a", re.DOTALL), 1 << 16, 1 << 26

#: Fields of such a message: store, compression (2 is LZ4), size of the Arrow stream, stream; and the most.
STORE, COMPRESSION, LZ4, SIZE, STREAM, MOST_FIELDS = 1, 2, 2, 3, 5, 32

#: Field of a store with its kind, and the kinds: a recording or its layout.
STORE_KIND, STORES = 1, (1, 2)

#: LZ4 compresses no better than this: a greater ratio is damage.
MOST_RATIO = 256


def read_chunks(path: Path) -> Iterator[Any]:
    """Chunks of a file as Arrow record batches, including its layout; damaged ones are left out.

    Raises InputError for a missing file, or one without an intact chunk, and MissingExtraError without Rerun.
    """
    yield from (message.batch for message in _read(path) if message.batch is not None)


def check_recording(path: Path) -> None:
    """Raise InputError if a file is missing or does not begin like a recording."""
    if not path.is_file():
        what = "no file" if path.exists() else "not there"
        raise InputError(f"recording: {path} is {what}; allowed: a recording that hexctl run made")
    try:
        with path.open("rb") as file:
            head = file.read(len(MAGIC))
    except OSError as error:
        raise InputError(f"recording: {path} cannot be opened ({error.strerror})") from error
    if head != MAGIC:
        raise InputError(f"recording: {path} is not a Rerun recording; give an .rrd file that hexctl wrote")


def viewable(path: Path, folder: Path) -> Path:
    """A recording on which no viewer crashes: itself, or a copy of its intact parts in a folder.

    Raises what `read_chunks` raises, and OSError if the copy cannot be written.
    """
    parts = [(message.begin, message.end, message.kind) for message in _read(path)]
    if sum(end - begin for begin, end, _ in parts) >= path.stat().st_size - HEAD_BYTES - INDEX_END_BYTES:
        return path
    folder.mkdir(parents=True, exist_ok=True)
    copy = folder / path.name
    with path.open("rb") as file, copy.open("wb") as target:
        target.write(file.read(HEAD_BYTES))
        for begin, end, kind in parts:
            if kind != LAST:  # which has the places of all chunks
                file.seek(begin)
                target.write(file.read(end - begin))
    return copy


def check_end(path: Path, start: int = HEAD_BYTES, *, index: bool = True) -> None:
    """Raise RecordingError unless complete messages, and an index, follow the first bytes of a recording.

    Rerun may not report a full disk.
    """
    with still_there(path), path.open("rb") as file:
        size = os.fstat(file.fileno()).st_size
        end = size - INDEX_END_BYTES if index else size
        at = start
        while at < end:
            file.seek(at)
            head = file.read(MESSAGE_HEAD.size)
            if len(head) < MESSAGE_HEAD.size:
                break
            at += MESSAGE_HEAD.size + MESSAGE_HEAD.unpack(head)[1]
        whole = start < at == end and (not index or _is_index(file, end))
    if not whole:
        raise RecordingError(f"{path}: the recording is incomplete; is the disk full?")


def entity_of(batch: Any) -> str:
    """Path of the entity of a chunk, such as `/world/robot`; raises ValueError without one."""
    path = (batch.schema.metadata or {}).get(b"rerun:entity_path")
    if path is None:
        raise ValueError("a chunk without an entity")
    return str(path.decode())


@dataclass(frozen=True, slots=True)
class _Message:
    """Intact message of a file, from its head to its end; the batch is that of a chunk."""

    begin: int
    end: int
    kind: int
    batch: Any = None


def _read(path: Path) -> Iterator[_Message]:
    """Intact messages; logs how much of a file is left out, raises InputError if every chunk is damaged."""
    try:
        import lz4.block  # noqa: F401  before a file is opened
        import pyarrow
    except ModuleNotFoundError as error:
        raise MissingExtraError("reading a recording", "view") from error
    check_recording(path)
    damage = (pyarrow.ArrowException, ValueError, LookupError, ArithmeticError, MemoryError)
    at, left_out, intact, left_bytes = HEAD_BYTES, 0, False, MOST_BYTES
    why: Exception | None = None
    try:
        with path.open("rb") as file:
            size = os.fstat(file.fileno()).st_size
            while at < size and not (size - at == INDEX_END_BYTES and _is_index(file, at)):
                try:
                    found = _message(file, at, size)
                except damage as error:
                    found, why = None, error
                if found is None:
                    left_bytes -= max(file.tell() - at, SEARCHED_BYTES)
                    begin, at = at, _next_chunk(file, at + 1, size) if left_bytes > 0 else size
                    left_out += at - begin
                else:
                    intact, at = intact or found.batch is not None, found.end
                    yield found
    except OSError as error:
        raise _damaged(path, error) from error
    if why is not None and not intact:
        raise _damaged(path, why)
    if left_out:
        _warn(path, left_out, size)


def _message(file: BinaryIO, begin: int, size: int) -> _Message | None:
    """Message at a place of a file, None if none begins there; raises an error of its decoding for damage."""
    file.seek(begin)
    head = file.read(MESSAGE_HEAD.size)
    if len(head) < MESSAGE_HEAD.size:
        return None
    kind, length = MESSAGE_HEAD.unpack(head)
    end = begin + MESSAGE_HEAD.size + length
    if kind > MOST_KIND or end > size or (kind == LAST and end < size - INDEX_END_BYTES):
        return None
    if kind != CHUNK:
        return _Message(begin, end, kind)
    content = file.read(length)
    return _Message(begin, end, kind, _batch(dict(islice(_fields(content), MOST_FIELDS))))


def _next_chunk(file: BinaryIO, at: int, size: int) -> int:
    """Next place that may be the head of a chunk; the end of the file, or its index, without one."""
    while at < size:
        file.seek(at)
        block = file.read(SEARCHED_BYTES)
        if found := CHUNK_BEGIN.search(block):
            return at + found.start()
        at += max(len(block) - MESSAGE_HEAD.size, 1)
    return size


def _is_index(file: BinaryIO, at: int) -> bool:
    file.seek(at)
    return END in file.read(INDEX_END_BYTES)


def _damaged(path: Path, error: Exception) -> InputError:
    reason = " ".join(str(error).split())[:200]
    return InputError(
        f"recording: {path} is damaged, or not of Rerun {RERUN} ({reason}); "
        "allowed: a recording that hexctl run made"
    )


@lru_cache
def _warn(path: Path, left_out_bytes: int, size: int) -> None:
    """Cached, because a file may be read several times."""
    _LOG.warning("%s is cut off or damaged: %d of its %d bytes are left out", path, left_out_bytes, size)


def _bytes(fields: dict[int, Any], number: int) -> bytes:
    value = fields[number]
    if not isinstance(value, bytes):
        raise ValueError(f"field {number} is a number")
    return value


def _batch(fields: dict[int, Any]) -> Any:
    import pyarrow

    store = dict(islice(_fields(_bytes(fields, STORE)), MOST_FIELDS))[STORE_KIND]
    if store not in STORES:
        raise ValueError(f"a chunk of store {store!r}")
    stream, size = _bytes(fields, STREAM), int(fields.get(SIZE, 0))
    if fields.get(COMPRESSION) == LZ4:
        if not 0 < size <= MOST_RATIO * len(stream):
            raise ValueError(f"a chunk of {size} bytes")
        stream = _decompressed(stream, size)
    batches = list(pyarrow.ipc.open_stream(stream))
    if len(batches) != 1:
        raise ValueError(f"a chunk of {len(batches)} batches")
    (batch,) = batches
    batch.validate(full=True)
    if not all(batch.schema.names) or "\0" in batch.schema.to_string() or not entity_of(batch):
        raise ValueError("a column without a name")
    return batch


def _decompressed(stream: bytes, size: int) -> bytes:
    """An LZ4 block of a size; Arrow's decoder takes most damage for content of another size."""
    from lz4 import block

    try:
        content: bytes = block.decompress(stream, uncompressed_size=size)
    except block.LZ4BlockError as error:
        raise ValueError(str(error)) from error
    if len(content) != size:
        raise ValueError(f"a chunk of {len(content)} bytes in place of {size}")
    return content


def _fields(message: bytes) -> Iterator[tuple[int, Any]]:
    """Numbers and values of the fields of a protobuf message: integers and bytes."""
    at = 0
    while at < len(message):
        key, at = _varint(message, at)
        number, kind = key >> 3, key & 7
        value, at = _varint(message, at)
        if kind == 0:
            yield number, value
        elif kind == 2:
            yield number, message[at : at + value]
            at += value
        else:
            raise ValueError(f"a field of kind {kind}")


def _varint(message: bytes, at: int) -> tuple[int, int]:
    value = shift = 0
    while True:
        byte = message[at]
        value, shift, at = value | (byte & 127) << shift, shift + 7, at + 1
        if byte < 128:
            return value, at
        if shift > 63:
            raise ValueError("a number of more than 64 bits")
