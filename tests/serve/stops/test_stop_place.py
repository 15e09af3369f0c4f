"""Where a robot is served: by its adapter, as far as that can be told from others."""

from pathlib import Path
from types import SimpleNamespace
from typing import NoReturn

import pytest

from hexctl.backends import serial_ports
from hexctl.serve.service import RobotService
from hexctl.serve.stops.stop_place import StopPlace

ENDPOINT = "tcp/127.0.0.1:7447"


def _adapter(device: str, serial_number: str | None, location: str | None) -> SimpleNamespace:
    return SimpleNamespace(
        device=device, vid=0x0403, pid=0x6014, serial_number=serial_number, location=location
    )


@pytest.fixture
def plugged(monkeypatch: pytest.MonkeyPatch) -> list[SimpleNamespace]:
    """Adapters that a test plugs in."""
    adapters: list[SimpleNamespace] = [SimpleNamespace(device="/dev/ttyS0", vid=None)]
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: list(adapters))
    return adapters


def _at(port: str | None) -> StopPlace:
    return StopPlace.of("feetech", port, ENDPOINT)


def test_an_adapter_keeps_its_key_under_another_name(plugged: list[SimpleNamespace]) -> None:
    plugged.append(_adapter("/dev/ttyUSB0", "FT9A1B", "1-2"))
    before = _at("/dev/ttyUSB0:1000000")
    assert (before.where, before.serial_number) == ("/dev/ttyUSB0", "0403:6014 serial FT9A1B")
    plugged[-1] = _adapter("/dev/ttyUSB1", "FT9A1B", "1-3")
    after = _at("serial:/dev/ttyUSB1")
    assert after.key == before.key
    assert str(after) == "feetech at /dev/ttyUSB1 (0403:6014 serial FT9A1B)"


def test_a_link_to_a_port_is_the_port(plugged: list[SimpleNamespace], tmp_path: Path) -> None:
    plugged.append(_adapter("/dev/ttyUSB0", None, "1-2"))
    (tmp_path / "bus").symlink_to("/dev/ttyUSB0")
    place = _at(str(tmp_path / "bus"))
    assert place.location == "0403:6014 at 1-2"
    assert place.at_device


def test_a_number_that_two_adapters_have_tells_nothing(plugged: list[SimpleNamespace]) -> None:
    plugged += [_adapter("/dev/ttyUSB0", "FT9A1B", "1-2"), _adapter("/dev/ttyUSB1", "FT9A1B", "1-3")]
    one, other = _at("/dev/ttyUSB0"), _at("/dev/ttyUSB1")
    assert one.serial_number is None
    assert one.key != other.key
    assert one.may_be(other)


def test_a_number_that_a_maker_gives_all_adapters_tells_nothing(plugged: list[SimpleNamespace]) -> None:
    plugged.append(_adapter("/dev/ttyUSB0", "0001", "1-2"))
    one = _at("/dev/ttyUSB0")
    plugged[-1] = _adapter("/dev/ttyUSB0", "0001", "1-3")
    other = _at("/dev/ttyUSB0")
    assert one.serial_number is None
    assert one.key != other.key
    assert one.may_be(other)


def test_ports_of_one_adapter_are_told_apart(plugged: list[SimpleNamespace]) -> None:
    plugged += [_adapter("/dev/ttyUSB0", "FT9A1B", "1-2:1.0"), _adapter("/dev/ttyUSB1", "FT9A1B", "1-2:1.1")]
    one, other = _at("/dev/ttyUSB0"), _at("/dev/ttyUSB1")
    assert one.serial_number is not None
    assert one.key != other.key
    assert not one.may_be(other)


def test_what_is_no_adapter_is_known_by_its_name(plugged: list[SimpleNamespace]) -> None:
    del plugged[:]
    for port in ("/dev/ttyAMA0", "1", "udpout:127.0.0.1:14550", None):
        place = _at(port)
        assert place.key == f"feetech {port or ENDPOINT}"
        assert place.at_device is (port == "/dev/ttyAMA0")


@pytest.mark.parametrize("error", [OSError("no such device"), TypeError("no vendor"), ValueError("no text")])
def test_adapters_that_cannot_be_listed_are_not_known(
    monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    monkeypatch.setattr(serial_ports, "AGAIN_S", 0.0)

    def gone() -> NoReturn:
        raise error

    monkeypatch.setattr("serial.tools.list_ports.comports", gone)
    assert _at("/dev/ttyUSB0").key == "feetech /dev/ttyUSB0"


@pytest.mark.parametrize(
    ("backend", "device", "where"),
    [
        ("lx16a", None, "/dev/ttyUSB0"),
        ("lx16a", "/dev/ttyUSB3:115200", "/dev/ttyUSB3"),
        ("sim", None, ENDPOINT),
    ],
)
def test_a_served_robot_is_at_its_device_or_that_of_its_file(
    plugged: list[SimpleNamespace], backend: str, device: str | None, where: str
) -> None:
    plugged.append(_adapter("/dev/ttyUSB0", "FT9A1B", "1-2"))
    service = RobotService(backend=backend, robot="jethexa", connect=device)
    place = service._stop_place(service.servo_options, service.resolved_link())
    assert (place.backend, place.where) == (backend, where)
    assert (place.serial_number is not None) is (where == "/dev/ttyUSB0")
