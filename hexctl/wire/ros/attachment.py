"""What rmw_zenoh attaches to every message: its number, its time and its sender, 33 bytes."""

import struct
from dataclasses import dataclass

from hexctl.errors import MessageError
from hexctl.wire.ros.ros_names import GID_BYTES

_LAYOUT = struct.Struct(f"<qqB{GID_BYTES}s")

#: Bytes of an attachment.
SIZE = _LAYOUT.size


@dataclass(frozen=True, slots=True)
class Attachment:
    """Attachment of a message, a request or an answer.

    Attributes:
        sequence: 1 for the first message of a publisher, then growing by one; an answer has that of its
            request.
        stamp_ns: time of sending, nanoseconds since 1970.
        gid: identifier of the sender, 16 bytes; an answer has that of its request.
    """

    sequence: int
    stamp_ns: int
    gid: bytes

    def packed(self) -> bytes:
        """The 33 bytes: two signed integers of 8, the length of the identifier, the identifier."""
        return _LAYOUT.pack(self.sequence, self.stamp_ns, GID_BYTES, self.gid)

    @classmethod
    def unpacked(cls, data: bytes) -> "Attachment":
        """Attachment of 33 bytes.

        Raises MessageError for anything else.
        """
        if len(data) != SIZE or data[16] != GID_BYTES:
            raise MessageError(f"ROS attachment: got {len(data)} bytes; allowed: {SIZE} with a gid of 16")
        sequence, stamp_ns, _, gid = _LAYOUT.unpack(data)
        return cls(sequence, stamp_ns, gid)
