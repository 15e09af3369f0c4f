"""Recordings of one chunk, and what damage can make of it."""

import io

import pyarrow as pa

from hexctl.recording.rrd_reader import CHUNK, MESSAGE_HEAD, STORE, STORE_KIND, STORES, STREAM

#: How files of Rerun 0.41 begin.
HEAD = b"RRF2\0\x29\0\0\1\2\0\0"
SCHEMA = pa.schema([("Scalars:scalars", pa.float64())], {"rerun:entity_path": "/deviation"})


def recording_of(stream: bytes | int) -> bytes:
    """A recording whose only chunk has an Arrow stream, or a number in its place."""
    message = _field(STORE, _field(STORE_KIND, STORES[0])) + _field(STREAM, stream)
    return HEAD + MESSAGE_HEAD.pack(CHUNK, len(message)) + message


def arrow_stream(schema: pa.Schema = SCHEMA, batches: int = 1) -> bytes:
    """An Arrow stream of batches with one value each."""
    file = io.BytesIO()
    with pa.ipc.new_stream(file, schema) as stream:
        for _ in range(batches):
            stream.write_batch(pa.record_batch([[0.5]], schema=schema))
    return file.getvalue()


def damaged_recordings() -> tuple[bytes, ...]:
    """Recordings without a batch, with two, with a number as stream, and with a chunk of no entity."""
    streams: tuple[bytes | int, ...] = (
        arrow_stream(batches=0),
        arrow_stream(batches=2),
        7,
        arrow_stream(SCHEMA.remove_metadata()),
    )
    return tuple(map(recording_of, streams))


def _field(number: int, value: bytes | int) -> bytes:
    """A field of a protobuf message."""
    if isinstance(value, int):
        return _varint(number << 3) + _varint(value)
    return _varint(number << 3 | 2) + _varint(len(value)) + value


def _varint(value: int) -> bytes:
    more, rest = value >> 7, value & 127
    return bytes([rest | 128]) + _varint(more) if more else bytes([rest])
