"""A serial line that somebody else has."""

import os
import pty
import subprocess
import sys
from collections.abc import Iterator

import pytest

from hexctl.backends.bus.serial_line import SerialLine
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
        (("hexctl.serve.keeper",), "the keeper of a `hexctl serve`"),
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
        said = str(raised.value)
        assert said.startswith(f"the port {device} is in use by {name}")
        assert f"(process {holder.pid})" in said
        assert "\n" not in said
    finally:
        holder.communicate(b"\n")
    SerialLine(device, 1_000_000).close()
