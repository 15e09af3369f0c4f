"""A command on the wire: sensor_msgs/JointState with its tag beside it."""

import time
from dataclasses import dataclass
from functools import cache

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray
from hexctl.wire import ros
from hexctl.wire.tags import CommandTag

_NAMES = list(JOINT_NAMES)
_NONE = np.zeros(0)

#: Where the stamp of the header lies in a message, behind the encapsulation header.
_STAMP = slice(4, 12)

#: Behind the positions: two empty sequences.
_TAIL_BYTES = 8


@dataclass(frozen=True, slots=True)
class Command:
    """What a command says.

    Attributes:
        positions_rad: joint angles, (18,), leg-major order.
        tag: what travels beside them.
    """

    positions_rad: FloatArray
    tag: CommandTag


@cache
def _template() -> tuple[bytes, bytes, bytes]:
    """Return what is the same in every message of ours: before the stamp, up to the positions, behind them.

    Only stamp and angles change, so a message is put together from three pieces: at 50 Hz the general
    encoder, whose code the processor has forgotten after each tick, would be a fifth of a round trip.
    """
    whole = _encode_any(np.zeros(N_JOINTS), 0)
    positions_at = len(whole) - _TAIL_BYTES - 8 * N_JOINTS
    return whole[: _STAMP.start], whole[_STAMP.stop : positions_at], whole[-_TAIL_BYTES:]


def encode_positions(positions_rad: FloatArray, stamp_ns: int | None = None) -> bytes:
    """Return joint angles, (18,), as sensor_msgs/JointState.

    Args:
        positions_rad: leg-major order.
        stamp_ns: of the header, nanoseconds since 1970; now unless given.
    """
    seconds, rest = divmod(time.time_ns() if stamp_ns is None else stamp_ns, ros.NANOSECONDS)
    before, middle, tail = _template()
    stamp = (seconds & 0x7FFFFFFF).to_bytes(4, "little") + rest.to_bytes(4, "little")
    return before + stamp + middle + positions_rad.astype("<f8").tobytes() + tail


def decode_positions(payload: bytes) -> FloatArray:
    """Return the joint angles of a sensor_msgs/JointState in leg-major order, (18,), all finite.

    The message may name the joints in any order; each of the 18 once. Raises MessageError for anything else.
    """
    before, middle, tail = _template()
    begin = _STAMP.stop + len(middle)
    ours = payload[_STAMP.stop : begin] == middle and payload[begin + 8 * N_JOINTS :] == tail
    if ours and payload.startswith(before):
        positions = np.frombuffer(payload, "<f8", N_JOINTS, begin).astype(float)
    else:
        positions = _decode_any(payload)
    if not np.isfinite(positions).all():
        raise MessageError("joints: got an angle that is not finite; allowed: finite angles in rad")
    return positions


def decode_command(payload: bytes, attachment: bytes | None) -> Command:
    """Return the command that a payload and its attachment hold.

    Raises MessageError for anything else.
    """
    if attachment is None:
        raise MessageError("command: got no attachment; allowed: one with sequence, time to live and lease")
    return Command(decode_positions(payload), CommandTag.unpacked(attachment))


def _encode_any(positions_rad: FloatArray, stamp_ns: int) -> bytes:
    return ros.encode(
        ros.make(
            ros.JOINT_STATE,
            header=ros.header(stamp_ns),
            name=_NAMES,
            position=positions_rad,
            velocity=_NONE,
            effort=_NONE,
        )
    )


def _decode_any(payload: bytes) -> FloatArray:
    """Return the angles of a message that others may have laid out, joints in our order."""
    message = ros.decode(ros.JOINT_STATE, payload)
    positions = np.asarray(message.position, dtype=float)
    if positions.shape != (N_JOINTS,) or len(message.name) != N_JOINTS:
        raise MessageError(
            f"joints: got {len(message.name)} names and {positions.size} positions; allowed: {N_JOINTS} each"
        )
    return positions if message.name == _NAMES else positions[_order(message.name)]


def _order(names: list[str]) -> list[int]:
    """Return where each joint is in a message."""
    places = {name: place for place, name in enumerate(names)}
    try:
        return [places[name] for name in JOINT_NAMES]
    except KeyError as error:
        raise MessageError(
            f"joints: got no {error.args[0]}; allowed: {JOINT_NAMES[0]} ... {JOINT_NAMES[-1]}"
        ) from error
