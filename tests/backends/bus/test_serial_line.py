"""A serial line that another program has, and one whose adapter echoes."""

import os
import pty
import subprocess
import sys
import threading
import time
from collections.abc import Iterator

import pytest

from hexctl.backends.bus.serial_line import SerialLine, holder_of
from hexctl.errors import RobotFaultError

HOLDS = """
import serial, sys
port = serial.Serial(sys.argv[1], exclusive=True)
print('has it', flush=True)
input()
"""


@pytest.fixture
def device() -> Iterator[str]:
    master, slave = pty.openpty()
    yield os.ttyname(slave)
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
def test_who_has_a_port_is_named(device: str, words: tuple[str, ...], name: str) -> None:
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
    assert holder_of(path) is None
    maker.communicate(b"\n")


class _EchoingLine:
    """The other end of a line whose adapter echoes; damages what it is told to."""

    def __init__(self, master: int) -> None:
        self._master = master

    def take(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            data += os.read(self._master, count - len(data))
        return data

    def send(self, data: bytes) -> None:
        os.write(self._master, data)


@pytest.fixture
def echoing() -> Iterator[tuple[SerialLine, _EchoingLine]]:
    master, slave = pty.openpty()
    line = SerialLine(os.ttyname(slave), 1_000_000)
    line.echoes = True
    yield line, _EchoingLine(master)
    line.close()
    os.close(master)
    os.close(slave)


GOALS, REQUEST, ANSWER = b"\xff\xffgoals of many", b"\xff\xff\x01\x04\x02\x38\x02\xbe", b"an answer"


def _heard(line: SerialLine) -> bytes:
    data, deadline_s = b"", time.monotonic() + 0.1
    while time.monotonic() < deadline_s:  # a read that brings an echo only is empty, and not the last one
        data += line.read(deadline_s)
    return data


@pytest.mark.parametrize("damaged", [b"\xff\xfegoals of many", b"\xff\xffgoals of ", b""])
def test_a_request_does_not_pass_for_an_answer_when_an_echo_before_it_was_damaged(
    damaged: bytes, echoing: tuple[SerialLine, _EchoingLine]
) -> None:
    line, other = echoing
    line.write(GOALS)
    line.write(REQUEST)
    assert other.take(len(GOALS + REQUEST)) == GOALS + REQUEST
    for part in (damaged, REQUEST[:3], REQUEST[3:] + ANSWER):
        other.send(part)
    assert _heard(line) == ANSWER
    line.write(REQUEST)
    other.send(other.take(len(REQUEST)) + ANSWER)
    assert _heard(line) == ANSWER, "and the next one is whole again"


def test_an_answer_behind_a_damaged_echo_of_its_request_is_missed_and_the_next_one_comes(
    echoing: tuple[SerialLine, _EchoingLine],
) -> None:
    line, other = echoing
    line.write(REQUEST)
    other.send(b"\xfe" + other.take(len(REQUEST))[1:] + ANSWER)
    assert _heard(line) == b""
    line.write(REQUEST)
    other.send(other.take(len(REQUEST)) + ANSWER)
    assert _heard(line) == ANSWER


def test_an_echo_that_was_damaged_when_it_was_learned_is_seen_at_the_second_try() -> None:
    master, slave = pty.openpty()
    line = SerialLine(os.ttyname(slave), 1_000_000)

    def echo() -> None:
        for first in (b"\xfe", b"\xff"):
            os.write(master, first + os.read(master, 4096)[1:])

    thread = threading.Thread(target=echo)
    thread.start()
    line.learn_echo(REQUEST, 5.0)
    thread.join()
    assert line.echoes
    line.close()
    os.close(master)
    os.close(slave)
