"""Reads files of Rerun (.rrd) with Arrow: Rerun's own reader kills the process at some damage.

Messages of chunks are protobuf with an LZ4-compressed Arrow stream, in the version `RERUN`.
"""

import logging
import os
import struct
from collections.abc import Iterator
from functools import lru_cache
from pathlib import Path
from typing import Any, BinaryIO

from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.recording.rrd import RERUN, still_there

_LOG = logging.getLogger(__name__)

#: Start of a file, length of the rest of its head, and the head of a message.
MAGIC, HEAD_BYTES, MESSAGE_HEAD = b"RRF2", 12, struct.Struct("<QQ")

#: Bytes after the last message of a file with an index: its place, and `END`.
INDEX_END_BYTES, END = 32, b"RRF2FOOT"

#: Kind of a message with a chunk.
CHUNK = 2

#: Fields of such a message: store, compression (2 is LZ4), size of the Arrow stream, stream.
STORE, COMPRESSION, LZ4, SIZE, STREAM = 1, 2, 2, 3, 5

#: Field of a store with its kind, and the kinds.
STORE_KIND, RECORDING, LAYOUT = 1, 1, 2

#: LZ4 compresses no better than this: a greater ratio is damage.
MOST_RATIO = 256


def read_chunks(path: Path) -> Iterator[Any]:
    """Chunks of a file as Arrow record batches, including its layout; a truncated last message is skipped.

    Raises InputError for a missing or damaged file, or of another version of Rerun, and
    MissingExtraError without Rerun.
    """
    for _, batch in _read(path):
        yield batch


def rerun_chunks(path: Path) -> Iterator[Any]:
    """Chunks of a recording as Rerun's objects, without its layout; raises what `read_chunks` raises."""
    from rerun.chunk import Chunk

    for store, batch in _read(path):
        try:
            chunks = Chunk.from_record_batch(batch) if store == RECORDING else ()
        except (RuntimeError, ValueError) as error:
            raise _damaged(path, error) from error
        yield from chunks


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


def check_viewable(path: Path) -> None:
    """Raise what `read_chunks` raises for a recording on which a viewer would crash."""
    for _ in read_chunks(path):
        pass


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
        file.seek(end if end > 0 else 0)
        whole = start < at == end and (not index or _is_index_end(file.read()))
    if not whole:
        raise RecordingError(f"{path}: the recording is incomplete; is the disk full?")


def entity_of(batch: Any) -> str:
    """Path of the entity of a chunk, such as `/world/robot`; raises ValueError without one."""
    path = (batch.schema.metadata or {}).get(b"rerun:entity_path")
    if path is None:
        raise ValueError("a chunk without an entity")
    return str(path.decode())


def _read(path: Path) -> Iterator[tuple[int, Any]]:
    try:
        import pyarrow
    except ModuleNotFoundError as error:
        raise MissingExtraError("reading a recording", "view") from error
    check_recording(path)
    try:
        with path.open("rb") as file:
            for message in _chunk_messages(file, path):
                fields = dict(_fields(message))
                yield _store(fields), _batch(fields)
    except (pyarrow.ArrowException, OSError, ValueError, LookupError, ArithmeticError, MemoryError) as error:
        raise _damaged(path, error) from error


def _damaged(path: Path, error: Exception) -> InputError:
    reason = " ".join(str(error).split())[:200]
    return InputError(
        f"recording: {path} is damaged, or not of Rerun {RERUN} ({reason}); "
        "allowed: a recording that hexctl run made"
    )


def _chunk_messages(file: BinaryIO, path: Path) -> Iterator[bytes]:
    """Messages with chunks up to the end of a file or a truncated message."""
    size = os.fstat(file.fileno()).st_size
    at = file.seek(HEAD_BYTES)
    while len(head := file.read(MESSAGE_HEAD.size)) == MESSAGE_HEAD.size:
        kind, length = MESSAGE_HEAD.unpack(head)
        if length > size - file.tell():
            break
        message, at = file.read(length), file.tell()
        if kind == CHUNK:
            yield message
    file.seek(at)
    if at < size and not _is_index_end(file.read(INDEX_END_BYTES + 1)):
        _warn_of_rest(path, size - at)


def _is_index_end(rest: bytes) -> bool:
    return len(rest) == INDEX_END_BYTES and END in rest


@lru_cache
def _warn_of_rest(path: Path, left_out_bytes: int) -> None:
    """Cached, because a file may be read several times."""
    _LOG.warning("%s is cut off or damaged: its last %d bytes are left out", path, left_out_bytes)


def _store(fields: dict[int, Any]) -> int:
    store: int = dict(_fields(_bytes(fields, STORE)))[STORE_KIND]
    if store not in (RECORDING, LAYOUT):
        raise ValueError(f"a chunk of store {store!r}")
    return store


def _bytes(fields: dict[int, Any], number: int) -> bytes:
    value = fields[number]
    if not isinstance(value, bytes):
        raise ValueError(f"field {number} is a number")
    return value


def _batch(fields: dict[int, Any]) -> Any:
    import pyarrow

    stream, size = _bytes(fields, STREAM), int(fields.get(SIZE, 0))
    if fields.get(COMPRESSION) == LZ4:
        if not 0 < size <= MOST_RATIO * len(stream):
            raise ValueError(f"a chunk of {size} bytes")
        stream = pyarrow.decompress(stream, size, codec="lz4_raw")
    batches = list(pyarrow.ipc.open_stream(stream))
    if len(batches) != 1:
        raise ValueError(f"a chunk of {len(batches)} batches")
    (batch,) = batches
    batch.validate(full=True)
    if not all(batch.schema.names) or "\0" in batch.schema.to_string() or not entity_of(batch):
        raise ValueError("a column without a name")
    return batch


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
