"""What works on a computer, by what it has."""

import json
import os
import socket
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hexctl.doctor import checkup, connections, machine, packages, rendering_check
from hexctl.doctor.connections import Connections, Device, NetworkPort
from hexctl.doctor.machine import Machine
from hexctl.doctor.rendering_check import Drawing

pytestmark = pytest.mark.slow

FORBIDDEN = Device(path="/dev/ttyUSB0", name="USB", group="dialout", usable=False)


@pytest.fixture(scope="module")
def here() -> checkup.Checkup:
    return checkup.doctor()


def works(monkeypatch: Any, **parts: Any) -> dict[str, str | None]:
    for name, part in parts.items():
        monkeypatch.setattr(checkup, name, lambda *_, part=part: part)
    return checkup.doctor().works


def test_it_is_plain_json_that_names_no_person(here: checkup.Checkup) -> None:
    text = json.dumps(here.to_dict())
    assert set(json.loads(text)) == {
        "machine",
        "packages",
        "drawing",
        "connections",
        "variables",
        "settings",
        "works",
    }
    assert str(Path.home()) == "/" or f"({Path.home()}/" not in text


def test_the_computer_is_this_one(here: checkup.Checkup) -> None:
    assert here.machine.cores >= 1
    assert here.machine.late_ms >= 0
    assert here.packages.versions["numpy"]
    assert here.works["simulate walks"] is None  # the tests simulate


def test_a_missing_package_is_named_with_its_extra(monkeypatch: Any) -> None:
    monkeypatch.setattr(packages, "version", missing_but("mujoco"))
    told = checkup.doctor().works
    assert told["simulate walks"] == 'needs mujoco: pip install "hexctl[sim]"'
    assert told["drive from a phone"] != told["simulate walks"]


def missing_but(gone: str) -> Any:

    def version(name: str) -> str:
        if name == gone:
            raise metadata.PackageNotFoundError(name)
        return metadata.version(name)

    return version


def test_a_port_that_is_not_allowed_says_which_group(here: checkup.Checkup, monkeypatch: Any) -> None:
    found = replace(here.connections, serial=(FORBIDDEN,))
    told = works(monkeypatch, read_connections=found)["servos on a serial port"]
    assert told == "not allowed for you: sudo usermod -aG dialout $USER, then log in again"
    both = replace(found, serial=(FORBIDDEN, replace(FORBIDDEN, usable=True)))
    assert works(monkeypatch, read_connections=both)["servos on a serial port"] is None
    none = works(monkeypatch, read_connections=replace(found, serial=()))["servos on a serial port"]
    assert none is not None
    assert "plugged in" in none


def test_a_port_for_root_alone_proposes_no_group(here: checkup.Checkup, monkeypatch: Any) -> None:
    console = Device(path="/dev/ttyS0", name="", group="", usable=False)
    found = replace(here.connections, serial=(console,))
    told = works(monkeypatch, read_connections=found)["servos on a serial port"]
    assert told == "/dev/ttyS0 is for root alone (a console?)"
    both = replace(found, serial=(console, replace(FORBIDDEN)))
    assert "-aG dialout $USER" in str(works(monkeypatch, read_connections=both)["servos on a serial port"])


@pytest.mark.parametrize(
    ("mode", "gid", "group"),
    [(0o660, 4242, "dialout"), (0o600, 4242, ""), (0o640, 4242, ""), (0o660, 0, ""), (0o660, 4243, "")],
)
def test_the_group_of_a_device_is_one_that_may_use_it(
    mode: int, gid: int, group: str, monkeypatch: Any
) -> None:
    def named(asked: int) -> Any:
        return SimpleNamespace(gr_name={0: "root", 4242: "dialout"}[asked])

    found = os.stat_result((mode, 0, 0, 1, 0, gid, 0, 0, 0, 0))
    monkeypatch.setattr(connections, "grp", SimpleNamespace(getgrgid=named))
    monkeypatch.setattr(
        connections,
        "os",
        SimpleNamespace(stat=lambda _: found, access=lambda *_: False, R_OK=os.R_OK, W_OK=os.W_OK),
    )
    assert connections._device("/dev/ttyS0").group == group


def test_a_taken_port_no_renderer_and_a_full_disk(here: checkup.Checkup, monkeypatch: Any) -> None:
    taken = NetworkPort(protocol="tcp", number=7447, use="hexctl serve", free=False)
    network: Connections = replace(here.connections, network=(taken,))
    full: Machine = replace(here.machine, disk_free_mb=40, realtime=False)
    blind = Drawing(renderers={"egl": None, "osmesa": None}, display=False)
    told = works(
        monkeypatch,
        read_connections=network,
        read_machine=full,
        read_drawing=blind,
    )
    assert told["hexctl serve"] == "port 7447 is taken; --listen names another one"
    assert told["room for recordings"] == "40 MB are left, for 10 walks of 30 s"
    assert "rtprio" in str(told["keep time on a busy machine"])
    assert "nothing draws without a screen" in str(told["GIF of walks"])
    assert told["view walks in a window"] == "no screen here"


def test_the_home_folder_in_the_path_of_python_is_not_named(monkeypatch: Any, tmp_path: Path) -> None:
    monkeypatch.setenv("HOME", str(tmp_path / "alice"))
    told = []
    for folder in ("alice", "alices"):
        monkeypatch.setattr("sys.executable", str(tmp_path / folder / "bin" / "python"))
        told.append(machine.read_machine(tmp_path).python.partition("(")[2])
    assert told == ["~/bin/python)", f"{tmp_path}/alices/bin/python)"]


def test_a_folder_that_does_not_exist_yet_is_no_trouble(tmp_path: Path) -> None:
    assert machine.read_machine(tmp_path / "a" / "b").folder_writable


@pytest.mark.parametrize("protocol", ["tcp", "udp"])
def test_a_port_is_taken_while_something_listens(protocol: str) -> None:
    kind = socket.SOCK_STREAM if protocol == "tcp" else socket.SOCK_DGRAM
    with socket.socket(socket.AF_INET, kind) as server:
        server.bind(("127.0.0.1", 0))
        if protocol == "tcp":
            server.listen()
        number = server.getsockname()[1]
        assert not connections._is_free(number, protocol)
    assert connections._is_free(number, protocol)


def test_the_computer_of_a_screen_is_not_named(here: checkup.Checkup, monkeypatch: Any) -> None:
    parts = {name: getattr(here, name) for name in ("machine", "packages", "drawing", "connections")}
    for name, part in parts.items():
        monkeypatch.setattr(checkup, f"read_{name}", lambda *_, part=part: part)
    told = []
    for display in (":0", "alices-desk:10.0"):
        monkeypatch.setenv("DISPLAY", display)
        told.append(checkup.doctor().variables["DISPLAY"])
    assert told == [":0", "given:10.0"]


def test_a_folder_that_cannot_be_written_has_no_room(here: checkup.Checkup, monkeypatch: Any) -> None:
    told = works(monkeypatch, read_machine=replace(here.machine, folder_writable=False))
    assert "folder for runs cannot be written" in str(told["room for recordings"])


def test_a_graphics_library_that_ends_its_process_draws_nothing(monkeypatch: Any) -> None:
    monkeypatch.setattr(rendering_check, "PROGRAM", "import os; os.abort()")
    found = rendering_check.read_drawing()
    assert not found.draws
