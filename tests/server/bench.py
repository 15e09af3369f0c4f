"""A server whose time and network a test holds, and messages to it that are spoiled."""

import json
import random
import struct
from typing import Any

import numpy as np
import pytest

from hexctl.server.server import RobotServer
from hexctl.server.transport import Arrival, Transport
from hexctl.wire.links import Link
from hexctl.wire.pose import encode_pose
from hexctl.wire.stop import Stop
from hexctl.wire.zenoh_messages import CommandTag, StateTag, decode_positions, encode_positions
from tests.control.posed import PosedMock

NUMBERS = [np.nan, np.inf, -np.inf, 1e308, -0.0, 5e-324]


class Item:
    """A sample or a query as Zenoh gives them."""

    key_expr = "hexctl/ant/key"

    def __init__(self, payload: bytes, attachment: bytes | None) -> None:
        self.payload, self.attachment = payload, attachment
        self.answers: list[bytes] = []
        self.dropped = False

    def reply(self, key: str, payload: bytes) -> None:
        self.answers.append(payload)

    def drop(self) -> None:
        self.dropped = True


def spoiled(good: bytes, chance: random.Random) -> bytes:
    """A payload that is cut off, flipped, too long, random, or good but with numbers that are not."""
    how = chance.randrange(6)
    if how == 0:
        return good[: chance.randrange(len(good) + 1)]
    if how == 1:
        return chance.randbytes(chance.randrange(700))
    if how == 2:
        return good + chance.randbytes(chance.randrange(1, 100))
    data = bytearray(good or b"{}")
    for _ in range(chance.randrange(1, 4)):
        place = chance.randrange(len(data))
        if how == 3:
            data[place] ^= 1 << chance.randrange(8)
        elif how == 4:
            data[place : place + 8] = struct.pack("<d", chance.choice(NUMBERS))
        else:
            data[place : place + 4] = struct.pack("<I", chance.choice([0, 2**31, 2**32 - 1, 10**6]))
    return bytes(data)


def stopped_for(reason: str | None) -> Stop | None:
    """A stop in force for a reason, or None."""
    return None if reason is None else Stop(stop_id="0" * 16, reason=reason, since_s=0.0)


class Bench:
    """A server on a robot whose time and network the test holds."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch, ros: Any = None) -> None:
        self.servos = PosedMock()
        self.said: list[tuple[str, bytes, bytes | None]] = []
        monkeypatch.setattr(Transport, "publish", lambda _, *message: self.said.append((*message, None)[:3]))
        self.server = RobotServer(self.servos, Link(), backend="mock", ros=ros)
        self.servos.connect()
        self.servos.clock.tick()
        self.lease: dict[str, Any] = {}
        self.sequence = 0
        self.stance_rad = self.servos.robot.stance_angles_rad

    def obey(self) -> None:
        """Take the lease and command the stance."""
        self.acquire()
        self.command(self.stance_rad)

    def ask(self, kind: str, content: dict[str, Any] | None = None) -> dict[str, Any]:
        item: Any = Item(b"" if content is None else json.dumps(content).encode(), None)
        if kind == "estop":
            self.server._transport._urgent(item.payload)
        self.server._handle(Arrival(kind, item, self.servos.time.now_s))
        answer: dict[str, Any] = json.loads(item.answers[0])
        return answer

    def clear(self) -> dict[str, Any]:
        """Clear the stop by its id, once it may be cleared."""
        self.ticks(51)
        return self.ask("estop", {"op": "clear", "id": self.server.status()["stop"]["id"]})

    def acquire(self) -> dict[str, Any]:
        self.lease, self.sequence = self.ask("lease", {"op": "acquire", "owner": "test"}), 0
        return self.lease

    def command(self, joint_positions_rad: Any, *, ttl_ms: int = 200, waited_s: float = 0.0) -> None:
        self.send_command(encode_positions(joint_positions_rad), ttl_ms=ttl_ms, waited_s=waited_s)

    def send_command(self, payload: bytes, *, ttl_ms: int = 200, waited_s: float = 0.0) -> None:
        """Send a command under the lease."""
        self.sequence += 1
        tag = CommandTag(
            sequence=self.sequence,
            stamp_ns=round((self.servos.time.now_s - waited_s) * 1e9),
            time_to_live_ms=ttl_ms,
            lease_id=bytes.fromhex(self.lease["lease"]),
            lease_sequence=self.lease["sequence"],
        )
        item: Any = Item(payload, tag.packed())
        self.server._handle(Arrival("command", item, self.servos.time.now_s - waited_s))

    def give_up(self, op: str, **more: Any) -> dict[str, Any]:
        return self.ask("lease", {"op": op, "lease": self.lease["lease"], **more})

    def pose_from_outside(self, position: Any, quaternion: Any, *, for_s: float = 0.02) -> None:
        """Let a motion capture send a pose before each tick."""
        for _ in range(round(for_s / 0.02)):
            self.send_pose(position, quaternion)
            self.ticks(1)

    def send_pose(self, position: Any, quaternion: Any, *, late_s: float = 0.0) -> None:
        """Let a motion capture send a pose, whose clock is another one."""
        stamp_ns = round((self.servos.time.now_s + 1e6 - late_s) * 1e9)
        item: Any = Item(encode_pose(position, quaternion, stamp_ns=stamp_ns), None)
        self.server._handle(Arrival("pose", item, self.servos.time.now_s))

    @property
    def stopped(self) -> str | None:
        reason: str | None = self.server.status()["stopped"]
        return reason

    def ticks(self, times: int) -> None:
        for _ in range(times):
            self.server._tick()

    def last_state(self) -> tuple[Any, StateTag]:
        payload, tag = next((p, t) for kind, p, t in reversed(self.said) if kind == "joint_states")
        assert tag is not None
        return decode_positions(payload), StateTag.unpacked(tag)
