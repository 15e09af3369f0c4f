"""What goes wrong with a real process: killed, stopped, pulled out, flooded, held by another."""

import itertools
import json
import os
import random
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.mavlink import mavlink_messages
from hexctl.backends.mavlink.codec import Codec
from hexctl.backends.mavlink.mavlink_client import MavlinkServos
from hexctl.control.guard import Guard
from hexctl.errors import HexctlError, RobotFaultError
from hexctl.robot.loader import load_robot_file
from hexctl.types import JointTargets
from tests.backends.mavlink.boards import PATIENCE_S, BoardProcess, board, eventually, fitting_file
from tests.backends.mavlink.test_codec import override_frame, valid_frame
from tests.robots import shipped

pytestmark = pytest.mark.realtime


def guarded(running: BoardProcess, file: Path) -> Guard:
    """The board behind a guard that a busy machine does not stop."""
    servos = MavlinkServos(shipped(), servo_map=load_robot_file(file).servo_map, port=running.port)
    return Guard(servos, expiry_s=1.0)


def stand(guard: Guard, ticks: int) -> None:
    """Command the stance for some ticks."""
    for _ in range(ticks):
        guard.clock.tick()
        guard.read()
        guard.write(JointTargets(guard.robot.stance_angles_rad, guard.clock.now_s))


def stand_until_stopped(guard: Guard) -> str:
    """Command the stance until the guard does not let it through, and return why."""
    until_s = time.monotonic() + PATIENCE_S
    while time.monotonic() < until_s:
        try:
            stand(guard, 1)
        except HexctlError:
            if guard.stopped is not None:
                return guard.stopped
            raise
    raise AssertionError("the guard did not stop the robot")


@pytest.mark.parametrize("pty", [False, True], ids=["udp", "pty"])
def test_a_board_that_hangs_stops_the_robot(pty: bool, tmp_path: Path) -> None:
    file = fitting_file(tmp_path)
    with (
        board("--backend", "mock", "--robot", str(file), pty=pty) as running,
        guarded(running, file) as guard,
    ):
        stand(guard, 20)
        running.process.send_signal(signal.SIGSTOP)
        assert stand_until_stopped(guard) == "state"
        assert guard.read().age_s > 1.0
        running.process.send_signal(signal.SIGCONT)
        eventually(lambda: fresh(guard))
        guard.clear()
        stand(guard, 5)
        assert guard.stopped is None


def fresh(guard: Guard) -> bool:
    guard.clock.tick()
    return guard.read().age_s < 0.1


def test_a_board_that_is_killed_stops_the_robot(tmp_path: Path) -> None:
    file = fitting_file(tmp_path)
    with board("--backend", "mock", "--robot", str(file)) as running, guarded(running, file) as guard:
        stand(guard, 20)
        running.process.kill()
        assert stand_until_stopped(guard) == "state"


def test_a_cable_that_is_pulled_out_is_a_fault(tmp_path: Path) -> None:
    """A pseudo-terminal goes with the process that made it, as a USB device does with its plug."""
    file = fitting_file(tmp_path)
    with (
        board("--backend", "mock", "--robot", str(file), pty=True) as running,
        guarded(running, file) as guard,
    ):
        stand(guard, 20)
        running.process.kill()
        with pytest.raises(RobotFaultError, match="has gone"):
            stand(guard, 500)


def test_a_second_controller_is_refused_and_told(tmp_path: Path) -> None:
    file = fitting_file(tmp_path)
    with board("--backend", "mock", "--robot", str(file)) as running:
        with guarded(running, file) as first, guarded(running, file) as second:
            stand(first, 10)
            second.clock.tick()
            for _ in range(200):
                stand(first, 1)
                second.clock.tick()
                second.read()
                if second.stopped is not None:
                    break
                second.write(JointTargets(second.robot.stance_angles_rad + 0.3, second.clock.now_s))
            assert second.stopped == "fault: the board says: another controller holds the servos"
            stand(first, 10)
            reached = first.read().joint_positions_rad
            np.testing.assert_allclose(reached, shipped().stance_angles_rad, atol=0.03)
        with guarded(running, file) as third:
            stand(third, 10)
            assert third.stopped is None
        report = running.end()
        assert report["of_others"] > 0


def test_a_walk_on_a_board_that_dies_ends_with_exit_code_3(tmp_path: Path) -> None:
    file = fitting_file(tmp_path)
    words = ["run", "--backend", "mavlink", "--duration", "60", "--no-record", "--json"]
    with board("--robot", str(file)) as running:
        walk = subprocess.Popen(
            [sys.executable, "-m", "hexctl", *words, "--robot", str(file), "--connect", running.port],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "MUJOCO_GL": "disable"},
        )
        try:
            await_commands(running.port)
            running.process.kill()
            out, err = walk.communicate(timeout=PATIENCE_S)
        finally:
            if walk.poll() is None:
                walk.kill()
                walk.communicate()
    assert walk.returncode == 3, err.decode()
    outcome = json.loads(out)
    assert outcome["status"] == "aborted"
    assert outcome["stopped"] in ("state", "pose lost", "expired")
    assert outcome["servo_link"]["received"] > 0


def await_commands(port: str) -> None:
    """Wait until a board reports that it executes commands."""
    _, host, number = port.split(":")
    codec = Codec(254, 1)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as watcher:
        watcher.connect((host, int(number)))
        watcher.settimeout(0.5)
        until_s = time.monotonic() + PATIENCE_S
        for count in itertools.count():
            assert time.monotonic() < until_s
            watcher.send(codec.encode(mavlink_messages.controller_heartbeat(), count))
            for frame in codec.decode(watcher.recv(2048), whole=True):
                if frame.kind == "HEARTBEAT" and frame.message.system_status == mavlink_messages.ACTIVE:
                    return


def test_a_flooded_board_moves_nothing_and_goes_on(tmp_path: Path) -> None:
    file = fitting_file(tmp_path)
    draw = random.Random(11)
    good = override_frame()
    elsewhere = Codec(255, 191).encode(mavlink_messages.override(np.full(18, 900.0), 77, 1), 0)
    with board("--backend", "mock", "--robot", str(file)) as running, guarded(running, file) as guard:
        stand(guard, 20)
        before = guard.read().joint_positions_rad
        _, host, number = running.port.split(":")
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hostile:
            for count in range(20_000):
                kind = count % 5
                changed = bytearray(good)
                changed[draw.randrange(50)] ^= 1 << draw.randrange(8)
                data = (
                    draw.randbytes(draw.randrange(1, 200)),
                    bytes(changed),
                    good[: draw.randrange(1, 50)],
                    valid_frame(draw, draw.choice([1, 4, 76, 77, 253, 375])),
                    elsewhere,
                )[kind]
                hostile.sendto(data, (host, int(number)))
                if count % 100 == 0:
                    stand(guard, 1)
                    guard.pause_watchdog()  # how long the flood takes is this test's affair
        stand(guard, 20)
        assert guard.stopped is None
        np.testing.assert_allclose(guard.read().joint_positions_rad, before, atol=1e-3)
        guard.close()
        report = running.end()
        assert report["malformed"] > 100
        assert report["refused"] == 0
        assert report["overrides"] > 200


def test_a_flooded_controller_is_not_moved_by_it(tmp_path: Path) -> None:
    """What is sent to the controller's own socket from elsewhere never reaches it."""
    file = fitting_file(tmp_path)
    with board("--backend", "mock", "--robot", str(file)) as running:
        servos = MavlinkServos(shipped(), servo_map=load_robot_file(file).servo_map, port=running.port)
        with Guard(servos) as guard, socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as hostile:
            stand(guard, 5)
            where = servos._link._port._socket.getsockname()  # type: ignore[attr-defined]
            for count in range(5000):
                hostile.sendto(override_frame(count), where)
                if count % 200 == 0:
                    stand(guard, 1)
                    guard.pause_watchdog()
            stand(guard, 10)
            assert guard.stopped is None
            assert servos.counters.malformed == servos.counters.foreign == 0
