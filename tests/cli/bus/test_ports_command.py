"""`hexctl ports` as a user calls it."""

import json

import pytest
from serial.tools.list_ports_common import ListPortInfo

from hexctl.cli.main import exit_code


def test_ports_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["ports", "--json"]) == 0
    assert all({"port", "adapter", "vendor"} <= each.keys() for each in json.loads(capsys.readouterr().out))


@pytest.mark.parametrize("vendor", [None, 0x0403])
def test_that_no_usb_adapter_is_there_is_noted(
    vendor: int | None, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    port = ListPortInfo("/dev/ttyAMA0")
    port.vid = port.pid = vendor
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    assert exit_code(["ports"]) == 0
    printed = capsys.readouterr()
    assert "/dev/ttyAMA0" in printed.out
    assert ("no USB serial adapter" in printed.err) is (vendor is None)
