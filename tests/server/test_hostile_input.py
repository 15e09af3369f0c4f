"""Hostile input at every key: nothing ends the robot, nothing moves it, everything is counted."""

import random
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.zenoh.zenoh_client import ask
from hexctl.server.transport import Arrival
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import encode_pose
from hexctl.wire.zenoh_messages import encode_positions
from hexctl.wire.zenoh_session import open_session
from tests.server.bench import Bench, Item, spoiled
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


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


@pytest.mark.parametrize("kind", list(GOOD))
@pytest.mark.parametrize("times", [TIMES, pytest.param(100_000, marks=pytest.mark.soak)])
def test_spoiled_messages_move_nothing_and_are_counted(bench: Bench, kind: str, times: int) -> None:
    chance = random.Random(kind)
    for _ in range(times):
        attachment = spoiled(COMMAND_BYTES, chance) if chance.random() < 0.9 else COMMAND_BYTES
        item: Any = Item(spoiled(GOOD[kind], chance), attachment)
        bench.server._handle(Arrival(kind, item, 0.0))
        assert item.dropped == (kind in ("lease", "estop", "describe"))
    status = bench.server.status()
    assert not bench.servos.sent
    commands = status["commands"]
    assert commands["accepted"] == 0
    if kind == "command":
        assert commands["malformed"] + commands["stale_owner"] == times
    if kind == "pose":
        assert status["malformed"]["poses"] > times / 2
    if kind in ("lease", "estop"):
        assert status["malformed"]["requests"] > times / 2
        assert status["controller"] is None


def test_spoiled_commands_of_the_lease_holder_never_leave_the_limits(bench: Bench) -> None:
    chance = random.Random(1)
    bench.acquire()
    for _ in range(5_000):
        bench.send_command(spoiled(GOOD["command"], chance))
    robot = bench.servos.robot
    sent = np.array([targets.joint_positions_rad for targets in bench.servos.sent])
    assert len(sent) == bench.server.status()["commands"]["accepted"] > 10
    assert np.isfinite(sent).all()
    within = robot.joint_max_speed_rad_s * bench.servos.clock.period_s + 1e-9
    assert (np.abs(sent - robot.stance_angles_rad) <= within).all()


def test_a_message_of_a_million_joints_is_dropped(bench: Bench) -> None:
    for kind in GOOD:
        item: Any = Item(bytes(8_000_000), COMMAND_BYTES)
        bench.server._handle(Arrival(kind, item, 0.0))
    assert bench.server.status()["commands"]["malformed"] == 1
    assert not bench.servos.sent


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
