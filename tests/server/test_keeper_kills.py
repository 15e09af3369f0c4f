"""Servers on a bus that are killed or frozen in mid walk, many times: the keeper leaves the robot at rest."""

import math
import signal
import threading
import time
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.mock import MockServos
from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.control.guard import Guard
from hexctl.errors import HexctlError
from hexctl.robot.loader import load_robot_file
from hexctl.types import FloatArray, JointTargets
from hexctl.wire.links import Link
from tests.backends.bus.boards import bus_board
from tests.robots import edited_file, put, with_ids
from tests.server.processes import TIMEOUT_S, served, wait_until
from tests.server.test_keeper import FITTING

#: Servers that are killed in the soak test.
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
    driver: str, model: str, number: signal.Signals, tmp_path: Path
) -> None:
    """Fifty times; the keeper then holds the robot, as its file says."""
    content = {**with_ids(FITTING), "model": model, "if_computer_dies": "hold"}
    file = edited_file(tmp_path, put("servos", content), base="phantomx")
    bus_map = bus_map_of(load_robot_file(file).content.servos, driver)
    last_motions_s: list[float] = []
    for kill in range(2 * KILLS):
        if len(last_motions_s) == KILLS:
            break
        robot = MockServos(load_robot_file(file).robot)
        folder = tmp_path / f"kill{kill}"  # a stop outlasts its server
        folder.mkdir()
        with (
            bus_board(bus_map, servos=robot) as bus,
            served(folder, "--robot", str(file), "--port", bus.path, backend=driver) as server,
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
