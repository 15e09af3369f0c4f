"""Every byte of an attachment, and what zenoh.ext makes of it."""

from typing import Any

import pytest
import zenoh.ext

from hexctl.errors import MessageError
from hexctl.wire.ros.endpoints import SIZE, Attachment

GID = bytes(range(16))
ONE = Attachment(1, 1_700_000_000_000_000_002, GID)


def test_the_bytes_of_an_attachment() -> None:
    packed = ONE.packed()
    assert len(packed) == SIZE == 33
    assert packed[:8] == bytes([1, 0, 0, 0, 0, 0, 0, 0])
    assert packed[8:16] == (1_700_000_000_000_000_002).to_bytes(8, "little")
    assert packed[16] == 16
    assert packed[17:] == GID


def test_it_is_what_rmw_zenoh_serializes() -> None:
    given = (zenoh.ext.Int64(ONE.sequence), zenoh.ext.Int64(ONE.stamp_ns), GID)
    kind: Any = tuple[zenoh.ext.Int64, zenoh.ext.Int64, bytes]
    assert bytes(zenoh.ext.z_serialize(given)) == ONE.packed()
    assert zenoh.ext.z_deserialize(kind, zenoh.ZBytes(ONE.packed())) == given


def test_it_comes_back() -> None:
    assert Attachment.unpacked(ONE.packed()) == ONE


@pytest.mark.parametrize(
    "data", [b"", ONE.packed()[:-1], ONE.packed() + b"\0", ONE.packed()[:16] + bytes(17)]
)
def test_anything_else_is_refused(data: bytes) -> None:
    with pytest.raises(MessageError, match="33"):
        Attachment.unpacked(data)
