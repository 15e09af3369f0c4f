"""A board has one owner: the second program names the first, and a killed one leaves nothing behind."""

import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest

from hexctl import RobotFaultError
from hexctl.backends.board_lock import BoardLock
from hexctl.backends.mavlink.mavlink_transport import lock_port, parse_port
from hexctl.backends.pwm.pca9685 import lock_boards
from tests.backends.pwm.boards import a_map

TAKE = "from {module} import {name}; kept = {call}; print('taken', flush=True); import time; time.sleep(60)"


@contextmanager
def another_program(module: str, name: str, call: str) -> Iterator[subprocess.Popen[str]]:
    """Process that holds a board."""
    code = TAKE.format(module=module, name=name, call=call)
    with subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout is not None
            assert process.stdout.readline() == "taken\n"
            yield process
        finally:
            process.kill()


def test_the_second_program_names_the_first_and_a_killed_one_leaves_nothing(tmp_path: Path) -> None:
    name = str(tmp_path)
    with another_program("hexctl.backends.board_lock", "BoardLock", f"BoardLock('it', [{name!r}])") as first:
        with pytest.raises(RobotFaultError, match=f"python.*process {first.pid}"):
            BoardLock("the board", [f"{name} other", name])
        BoardLock("the board", [f"{name} other"]).release()  # the first name was let go
        os.kill(first.pid, signal.SIGKILL)
        first.wait()
        BoardLock("the board", [name]).release()


def test_a_udp_port_has_one_controller() -> None:
    text = "udpout:127.0.0.1:14987"
    call = f"lock_port(parse_port({text!r}), text='')"
    with another_program("hexctl.backends.mavlink.mavlink_transport", "lock_port, parse_port", call) as first:
        for other in (text, "udpout:localhost:14987"):
            with pytest.raises(RobotFaultError, match=f"process {first.pid}"):
                lock_port(parse_port(other), text=other)
        lock_port(parse_port("udpout:127.0.0.1:14988"), text="").release()


def test_boards_on_one_i2c_bus_are_locked_by_their_addresses(tmp_path: Path) -> None:
    bus = tmp_path / "bus"
    bus.touch()
    (tmp_path / "link").symlink_to(bus)
    lock = lock_boards(str(bus), a_map("pca9685"))
    with pytest.raises(RobotFaultError, match=r"0x40 and 0x41.*in use by this program"):
        lock_boards(str(tmp_path / "link"), a_map("pca9685"))
    others = a_map("pca9685", addresses=(0x42, 0x43))
    lock_boards(str(bus), others).release()
    lock.release()
    lock_boards(str(bus), a_map("pca9685")).release()
