"""Serial ports: which there are, and which one goes when a cable is pulled."""

from pathlib import Path
from types import SimpleNamespace
from typing import Any, NoReturn

import pytest

from hexctl.backends import serial_ports as module
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
