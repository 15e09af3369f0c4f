"""What takes long: hostile input over a real link, an adaptation over it, and servers that are killed."""

import json
import math
import random
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.mock import MockServos
from hexctl.backends.zenoh.zenoh_client import ZenohServos, ask
from hexctl.control.guard import Guard
from hexctl.errors import HexctlError
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.types import FloatArray, JointTargets
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session
from tests.backends.bus.boards import bus_board
from tests.robots import edited_file, put
from tests.server.processes import TIMEOUT_S, hexctl, served, wait_until
from tests.server.test_hostile_input import GOOD, spoiled
from tests.wire.test_zenoh_messages import COMMAND_BYTES

TIMES = 100_000
KEYS = KeyMap.of("ant")


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["command", "pose", "lease", "estop", "describe", "status"])
def test_a_hundred_thousand_spoiled_messages_over_the_link_move_nothing_and_delay_no_stop(
    tmp_path: Path, kind: str
) -> None:
    chance = random.Random(kind)
    good = GOOD.get(kind, b"{}")
    with (
        served(tmp_path) as robot,
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, KEYS) as session,
    ):
        key = getattr(KEYS, kind)
        for _ in range(TIMES):
            session.put(key, spoiled(good, chance), attachment=spoiled(COMMAND_BYTES, chance))
        assert robot.process.poll() is None
        began_s = time.monotonic()
        assert [one["stopped"] for one in ask(session, KEYS.estop, {"op": "stop"})] == ["estop"]
        assert time.monotonic() - began_s < TIMEOUT_S
        status = robot.status()
        assert status["stopped"] == "estop"
        assert robot.log().times_s.size == 0
        if kind == "command":
            counts = status["commands"]
            dropped = counts["malformed"] + counts["stale_owner"] + counts["overflowed"]
            assert dropped > TIMES / 100  # Zenoh drops what a robot cannot take; what came is counted


@pytest.mark.soak
def test_an_adaptation_over_the_link_finds_the_gait_that_one_in_process_finds(tmp_path: Path) -> None:
    """Gaits drawn at random, so that both walk the same five; the twin walks in real time and stays put."""
    options = ("--failed-leg", "5", "--budget", "5", "--optimizer", "random", "--no-record", "--json")
    with served(tmp_path, "--failed-leg", "5", backend="sim") as robot:
        link = ("--backend", "zenoh", "--connect", robot.endpoint, "--arena", "3")
        far = hexctl("adapt", *link, *options)
        assert far.returncode == 0, far.stderr
    near = hexctl("adapt", *options)
    there, here = json.loads(far.stdout), json.loads(near.stdout)
    assert [trial["code"] for trial in there["trials"]] == [trial["code"] for trial in here["trials"]]
    assert there["best"]["code"] == here["best"]["code"]
    for one, other in zip(there["trials"], here["trials"], strict=True):
        off_m = one["deviation_m"]["signed"] - other["deviation_m"]["signed"]
        assert abs(off_m) < 0.35, (one["code"], off_m)


KILLS = 50

#: How long the walk may take to begin; on a busy machine some do not.
MOVES_WITHIN_S = 20.0

#: How long a robot may go on moving, and how far its joints may be from where they stay, in rad.
LAST_MOTION_S, STILL_RAD = 0.25, 0.02


@pytest.mark.soak
@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGSTOP], ids=["killed", "frozen"])
@pytest.mark.parametrize(
    ("driver", "model"),
    [("dynamixel", "xl430-w250"), ("dynamixel", "ax12a"), ("feetech", "sts3215"), ("lx16a", "lx16a")],
)
def test_a_server_that_goes_in_mid_walk_leaves_the_robot_at_rest(
    driver: str, model: str, number: signal.Signals, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Fifty times; the keeper then holds the robot, as its file says."""
    content = {"model": model, "femur": {"offset_deg": -10}, "tibia": {"offset_deg": 40}}
    file = edited_file(tmp_path, put("servos", {**content, "if_computer_dies": "hold"}), base="phantomx")
    bus_map = bus_map_of(load_robot_file(file).content.servos, driver)
    last_motions_s: list[float] = []
    for kill in range(2 * KILLS):
        if len(last_motions_s) == KILLS:
            break
        robot = MockServos(load_robot_file(file).robot)
        monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / f"state{kill}"))  # a stop outlasts its server
        with (
            bus_board(bus_map, servos=robot) as bus,
            served(
                tmp_path, "--robot", str(file), "--connect", bus.path, backend=driver, name=f"robot{kill}"
            ) as server,
        ):
            moved = threading.Event()
            walking = threading.Thread(target=_walk_until_it_fails, args=(server.endpoint, str(file), moved))
            walking.start()
            if not moved.wait(MOVES_WITHIN_S) or not _all_move(robot):  # the machine is too busy for a walk
                server.signal(signal.SIGKILL)
                wait_until(lambda: "hexctl: serve " in server.said(), "the keeper")
                walking.join(TIMEOUT_S)
                continue
            server.signal(number)
            at_s, angles_rad = _watched(robot, 2.0)
            far = np.abs(angles_rad - angles_rad[-1]).max(axis=-1) > STILL_RAD
            last_motions_s.append(float(at_s[far].max(initial=0.0)))
            wait_until(lambda: "the robot holds" in server.said(), "the keeper")
            server.signal(signal.SIGKILL)
            walking.join(TIMEOUT_S)
    assert len(last_motions_s) == KILLS
    assert max(last_motions_s) <= LAST_MOTION_S, sorted(last_motions_s)[-5:]


def _all_move(robot: MockServos) -> bool:
    """Whether all joints move, as in a walk."""
    _, angles_rad = _watched(robot, 0.3)
    return float(np.ptp(angles_rad, axis=0).min()) > STILL_RAD


def _watched(robot: MockServos, duration_s: float) -> tuple[FloatArray, FloatArray]:
    """Times, (n,), and joint angles then, (n, 18), for a while."""
    begun_s = time.monotonic()
    at_s: list[float] = []
    angles_rad: list[FloatArray] = []
    while not at_s or at_s[-1] < duration_s:
        angles_rad.append(robot.read().joint_positions_rad.copy())
        at_s.append(time.monotonic() - begun_s)
        time.sleep(0.005)
    return np.array(at_s), np.stack(angles_rad)


def _walk_until_it_fails(endpoint: str, file: str, moved: threading.Event) -> None:
    """Swing all joints by 10 degrees about the stance, over the link, until the robot has gone."""
    with suppress(HexctlError), Guard(ZenohServos(file, link=Link(endpoint=endpoint))) as guard:
        for tick in range(500):
            now_s = guard.clock.tick().time_s
            guard.read()
            swing_rad = 0.17 * math.sin(8.0 * now_s) * min(1.0, tick / 25)
            guard.write(JointTargets(guard.robot.stance_angles_rad + swing_rad, now_s))
            if tick == 60:
                moved.set()
