"""A command on the wire: sensor_msgs/JointState with its tag beside it."""

import time
from dataclasses import dataclass

import numpy as np

from hexctl.errors import MessageError
from hexctl.robot.joints import JOINT_NAMES, N_JOINTS
from hexctl.robot.messages import FloatArray
from hexctl.wire import ros
from hexctl.wire.tags import CommandTag

_NAMES = list(JOINT_NAMES)
_NONE = np.zeros(0)


@dataclass(frozen=True, slots=True)
class Command:
    """What a command says.

    Attributes:
        positions_rad: joint angles, (18,), leg-major order.
        tag: what travels beside them.
    """

    positions_rad: FloatArray
    tag: CommandTag


def encode_positions(positions_rad: FloatArray, stamp_ns: int | None = None) -> bytes:
    """Return joint angles, (18,), as sensor_msgs/JointState.

    Args:
        positions_rad: leg-major order.
        stamp_ns: of the header, nanoseconds since 1970; now unless given.
    """
    return ros.encode(
        ros.make(
            ros.JOINT_STATE,
            header=ros.header(time.time_ns() if stamp_ns is None else stamp_ns),
            name=_NAMES,
            position=positions_rad,
            velocity=_NONE,
            effort=_NONE,
        )
    )


def decode_positions(payload: bytes) -> FloatArray:
    """Return the joint angles of a sensor_msgs/JointState in leg-major order, (18,), all finite.

    The message may name the joints in any order; each of the 18 once. Raises MessageError for anything else.
    """
    message = ros.decode(ros.JOINT_STATE, payload)
    positions = np.asarray(message.position, dtype=float)
    if positions.shape != (N_JOINTS,) or len(message.name) != N_JOINTS:
        raise MessageError(
            f"joints: got {len(message.name)} names and {positions.size} positions; allowed: {N_JOINTS} each"
        )
    if message.name != _NAMES:
        positions = positions[_order(message.name)]
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


def _order(names: list[str]) -> list[int]:
    """Return where each joint is in a message."""
    places = {name: place for place, name in enumerate(names)}
    try:
        return [places[name] for name in JOINT_NAMES]
    except KeyError as error:
        raise MessageError(
            f"joints: got no {error.args[0]}; allowed: {JOINT_NAMES[0]} ... {JOINT_NAMES[-1]}"
        ) from error
