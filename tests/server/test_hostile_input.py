"""Hostile input at every key: nothing ends the robot, nothing moves it, everything is counted."""

import json
import random
import struct
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.zenoh.zenoh_client import ask
from hexctl.server.server import RobotServer
from hexctl.server.transport import Arrival, Transport
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import encode_pose
from hexctl.wire.zenoh_messages import CommandTag, encode_positions
from hexctl.wire.zenoh_session import open_session
from tests.control.posed import PosedMock
from tests.server.processes import TIMEOUT_S, served
from tests.wire.test_zenoh_messages import COMMAND_BYTES

#: Messages at each key in the ordinary tests.
TIMES = 3_000

GOOD = {
    "command": encode_positions(np.zeros(18)),
    "pose": encode_pose(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])),
    "lease": b'{"op": "renew", "lease": "00"}',
    "estop": b'{"op": "clear"}',
    "describe": b"",
}
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


@pytest.mark.parametrize("kind", list(GOOD))
@pytest.mark.parametrize("times", [TIMES, pytest.param(100_000, marks=pytest.mark.soak)])
def test_spoiled_messages_move_nothing_and_are_counted(kind: str, times: int) -> None:
    chance = random.Random(kind)
    servos = PosedMock()
    server = RobotServer(servos, Link(), backend="mock")
    servos.connect()
    servos.clock.tick()
    for _ in range(times):
        attachment = spoiled(COMMAND_BYTES, chance) if chance.random() < 0.9 else COMMAND_BYTES
        item: Any = Item(spoiled(GOOD[kind], chance), attachment)
        server._handle(Arrival(kind, item, 0.0))
        assert item.dropped == (kind in ("lease", "estop", "describe"))
    status = server.status()
    assert not servos.sent
    commands = status["commands"]
    assert commands["accepted"] == 0
    if kind == "command":
        assert commands["malformed"] + commands["stale_owner"] == times
    if kind == "pose":
        assert status["malformed"]["poses"] > times / 2
    if kind in ("lease", "estop"):
        assert status["malformed"]["requests"] > times / 2
        assert status["controller"] is None


def test_spoiled_commands_of_the_lease_holder_never_leave_the_limits(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(Transport, "publish", lambda *_: None)
    chance = random.Random(1)
    servos = PosedMock()
    server = RobotServer(servos, Link(), backend="mock")
    servos.connect()
    servos.clock.tick()
    item: Any = Item(b'{"op": "acquire", "owner": "mallory"}', None)
    server._handle(Arrival("lease", item, time.monotonic()))
    given = json.loads(item.answers[0])
    for sequence in range(1, 5_000):
        tag = CommandTag(
            sequence=sequence,
            stamp_ns=0,
            time_to_live_ms=200,
            lease_id=bytes.fromhex(given["lease"]),
            lease_sequence=given["sequence"],
        )
        command: Any = Item(spoiled(GOOD["command"], chance), tag.packed())
        server._handle(Arrival("command", command, time.monotonic()))
    robot = servos.robot
    sent = np.array([targets.joint_positions_rad for targets in servos.sent])
    assert len(sent) == server.status()["commands"]["accepted"] > 10
    assert np.isfinite(sent).all()
    within = robot.joint_max_speed_rad_s * servos.clock.period_s + 1e-9
    assert (np.abs(sent - robot.stance_angles_rad) <= within).all()


def test_a_message_of_a_million_joints_is_dropped() -> None:
    servos = PosedMock()
    server = RobotServer(servos, Link(), backend="mock")
    for kind in GOOD:
        item: Any = Item(bytes(8_000_000), COMMAND_BYTES)
        server._handle(Arrival(kind, item, 0.0))
    assert server.status()["commands"]["malformed"] == 1
    assert not servos.sent


#: Messages over a link.
LINK_TIMES = 100_000


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["command", "pose", "lease", "estop", "describe", "status"])
def test_a_hundred_thousand_spoiled_messages_over_the_link_move_nothing_and_delay_no_stop(
    tmp_path: Path, kind: str
) -> None:
    chance, keys = random.Random(kind), KeyMap.of("ant")
    good = GOOD.get(kind, b"{}")
    with (
        served(tmp_path) as robot,
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, keys) as session,
    ):
        key = getattr(keys, kind)
        for _ in range(LINK_TIMES):
            session.put(key, spoiled(good, chance), attachment=spoiled(COMMAND_BYTES, chance))
        assert robot.process.poll() is None
        began_s = time.monotonic()
        assert [one["stopped"] for one in ask(session, keys.estop, {"op": "stop"})] == ["estop"]
        assert time.monotonic() - began_s < TIMEOUT_S
        status = robot.status()
        assert status["stopped"] == "estop"
        assert robot.log().times_s.size == 0
        if kind == "command":
            counts = status["commands"]
            dropped = counts["malformed"] + counts["stale_owner"] + counts["overflowed"]
            assert dropped > LINK_TIMES / 100  # Zenoh drops what a robot cannot take; what came is counted
