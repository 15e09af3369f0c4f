"""Serial ports: which there are, which is unplugged, which another program has, and adapters that echo."""

import os
import pty
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest

from hexctl.backends import serial_ports as module
from hexctl.backends.bus.serial_line import SerialLine, program_using
from hexctl.backends.serial_ports import serial_ports, unplugged_port
from hexctl.errors import RobotFaultError
from tests.backends.fake_time import FakeTime


class _Port(SimpleNamespace):
    def __lt__(self, other: Any) -> bool:
        return bool(self.device < other.device)


def _port(device: str, vid: int | None = 0x0403) -> _Port:
    return _Port(device=device, description="USB serial", vid=vid, pid=0x6014, serial_number="A1")


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[_Port]:
    """Ports that a test plugs and pulls."""
    monkeypatch.setattr(module, "TERMINALS", Path("/nowhere"))
    ports = [_port("/dev/ttyUSB1"), _port("/dev/ttyUSB0"), _port("/dev/ttyS0", None), _port("/dev/x", None)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: list(ports))
    return ports


@pytest.mark.usefixtures("plugged")
def test_ports_have_their_adapter_and_a_name_that_stays(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = tmp_path / "usb-FTDI_U2D2_A1-if00"
    link.symlink_to("/dev/ttyUSB0")
    monkeypatch.setattr(module, "BY_ID", tmp_path)
    first, second, third = serial_ports()[:3]
    assert (first.port, first.vendor, first.stays) == ("/dev/ttyS0", None, None)
    assert (second.port, second.vendor, second.stays) == ("/dev/ttyUSB0", "0403:6014", str(link))
    assert (third.port, third.stays) == ("/dev/ttyUSB1", None)
    assert len(serial_ports()) == 3, "what is no tty and has no adapter is left out"


@pytest.mark.parametrize(
    "error", [TypeError("no vendor"), OSError("no such device"), UnicodeDecodeError("utf-8", b"", 0, 1, "?")]
)
def test_an_adapter_that_goes_while_ports_are_listed_is_not_among_them(
    plugged: list[_Port], monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    monkeypatch.setattr(module, "AGAIN_S", 0.0)

    def goes() -> list[_Port]:
        if len(plugged) == 4:
            del plugged[1]
            raise error
        return list(plugged)

    monkeypatch.setattr("serial.tools.list_ports.comports", goes)
    assert [each.port for each in serial_ports()] == ["/dev/ttyS0", "/dev/ttyUSB1"]

    def never() -> NoReturn:
        raise error

    monkeypatch.setattr("serial.tools.list_ports.comports", never)
    assert serial_ports() == []


def test_the_port_whose_cable_is_pulled_is_found(plugged: list[_Port]) -> None:
    before, polls = serial_ports(), 0

    def pulls_after_three_polls() -> bool:
        nonlocal polls
        polls += 1
        if polls == 3:
            del plugged[1]
        return False

    found = unplugged_port(before, timeout_s=10.0, stop_requested=pulls_after_three_polls, time=FakeTime())
    assert found is not None
    assert found.port == "/dev/ttyUSB0"


def test_no_cable_two_cables_and_an_interruption(plugged: list[_Port]) -> None:
    before = serial_ports()
    with pytest.raises(RobotFaultError, match="no port"):
        unplugged_port(before, timeout_s=10.0, time=FakeTime())
    assert unplugged_port(before, timeout_s=10.0, stop_requested=lambda: True) is None
    del plugged[:2]
    with pytest.raises(RobotFaultError, match="/dev/ttyUSB0, /dev/ttyUSB1"):
        unplugged_port(before, timeout_s=10.0)


# A line on a port.

HOLDS = """
import serial, sys
port = serial.Serial(sys.argv[1], exclusive=True)
print('has it', flush=True)
input()
"""


@pytest.fixture
def ends() -> Iterator[tuple[int, str]]:
    """A pseudo-terminal: the descriptor of one end, and the path of the other."""
    master, slave = pty.openpty()
    yield master, os.ttyname(slave)
    os.close(master)
    os.close(slave)


@pytest.mark.parametrize(
    ("words", "name"),
    [
        (("hexctl", "serve"), "`hexctl serve`"),
        (("hexctl.server.keeper",), "the keeper of a `hexctl serve`"),
        ((), "`python"),
    ],
)
def test_who_has_a_port_is_named(ends: tuple[int, str], words: tuple[str, ...], name: str) -> None:
    _, device = ends
    holder = subprocess.Popen(
        [sys.executable, "-c", HOLDS, device, *words], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    try:
        assert holder.stdout is not None
        assert holder.stdout.readline() == b"has it\n"
        with pytest.raises(RobotFaultError) as raised:
            SerialLine(device, 1_000_000)
        assert f"in use by {name}" in str(raised.value)
        assert f"(process {holder.pid})" in str(raised.value)
    finally:
        holder.communicate(b"\n")
    SerialLine(device, 1_000_000).close()
    with pytest.raises(RobotFaultError, match="there is no port /dev/nothing"):
        SerialLine("/dev/nothing", 1_000_000)


def test_a_simulated_bus_does_not_use_its_own_port() -> None:
    makes = "import os, pty\nprint(os.ttyname(pty.openpty()[1]), flush=True)\ninput()"
    maker = subprocess.Popen([sys.executable, "-c", makes], stdin=subprocess.PIPE, stdout=subprocess.PIPE)
    assert maker.stdout is not None
    path = maker.stdout.readline().decode().strip()
    assert program_using(path) is None
    maker.communicate(b"\n")


@pytest.fixture
def echoing(ends: tuple[int, str]) -> Iterator[tuple[SerialLine, int]]:
    """A line whose adapter echoes, and its other end, which sends the echoes too."""
    master, device = ends
    line = SerialLine(device, 1_000_000)
    line.echoes = True
    yield line, master
    line.close()


def _sent(other: int, count: int) -> bytes:
    data = b""
    while len(data) < count:
        data += os.read(other, count - len(data))
    return data


GOALS, REQUEST, ANSWER = b"\xff\xffgoals of many", b"\xff\xff\x01\x04\x02\x38\x02\xbe", b"an answer"


def _heard(line: SerialLine) -> bytes:
    data, deadline_s = b"", time.monotonic() + 0.1
    while time.monotonic() < deadline_s:  # a read that brings an echo only is empty, and not the last one
        data += line.read(deadline_s)
    return data


@pytest.mark.parametrize("damaged", [b"\xff\xfegoals of many", b"\xff\xffgoals of ", b""])
def test_a_request_does_not_pass_for_an_answer_when_an_echo_before_it_was_damaged(
    damaged: bytes, echoing: tuple[SerialLine, int]
) -> None:
    line, other = echoing
    line.write(GOALS)
    line.write(REQUEST)
    assert _sent(other, len(GOALS + REQUEST)) == GOALS + REQUEST
    for part in (damaged, REQUEST[:3], REQUEST[3:] + ANSWER):
        os.write(other, part)
    assert _heard(line) == ANSWER
    line.write(REQUEST)
    os.write(other, _sent(other, len(REQUEST)) + ANSWER)
    assert _heard(line) == ANSWER, "and the next one is whole again"


def test_an_answer_behind_a_damaged_echo_of_its_request_is_missed_and_the_next_one_comes(
    echoing: tuple[SerialLine, int],
) -> None:
    line, other = echoing
    line.write(REQUEST)
    os.write(other, b"\xfe" + _sent(other, len(REQUEST))[1:] + ANSWER)
    assert _heard(line) == b""
    line.write(REQUEST)
    os.write(other, _sent(other, len(REQUEST)) + ANSWER)
    assert _heard(line) == ANSWER


def test_an_echo_that_was_damaged_when_it_was_learned_is_seen_at_the_second_try(
    echoing: tuple[SerialLine, int],
) -> None:
    line, other = echoing
    line.echoes = False

    def echo() -> None:
        for first in (b"\xfe", b"\xff"):
            os.write(other, first + os.read(other, 4096)[1:])

    thread = threading.Thread(target=echo)
    thread.start()
    line.learn_echo(REQUEST, 5.0)
    thread.join()
    assert line.echoes
