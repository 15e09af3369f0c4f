"""`hexctl doctor`: what works on a computer, by what it has, and what is said of its settings."""

import json
import os
import socket
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from hexctl.doctor import checkup, connections, machine, packages
from hexctl.doctor.connections import Connections, Device, NetworkPort
from hexctl.doctor.machine import Drawing, Machine
from hexctl.doctor.settings_check import SettingFound, read_settings_found
from tests.cli.conftest import Call

FORBIDDEN = Device(path="/dev/ttyUSB0", name="USB", group="dialout", usable=False)


@pytest.fixture(scope="module")
def here() -> checkup.Checkup:
    return checkup.doctor()


def works(here: checkup.Checkup, monkeypatch: Any, **parts: Any) -> checkup.Checkup:
    """What it says of a computer that differs in some parts."""
    for name in ("machine", "packages", "drawing", "connections"):
        part = parts.get(name, getattr(here, name))
        monkeypatch.setattr(checkup, f"read_{name}", lambda *_, part=part: part)
    return checkup.doctor()


@pytest.mark.slow
def test_a_missing_package_is_named_with_its_extra(here: checkup.Checkup, monkeypatch: Any) -> None:
    def version(name: str) -> str:
        if name == "mujoco":
            raise metadata.PackageNotFoundError(name)
        return metadata.version(name)

    monkeypatch.setattr(packages, "version", version)
    told = works(here, monkeypatch, packages=packages.read_packages()).works
    assert "[sim]" in str(told["simulate walks"])
    assert told["drive from a phone"] != told["simulate walks"]


@pytest.mark.slow
def test_a_port_that_is_not_allowed_says_which_group(here: checkup.Checkup, monkeypatch: Any) -> None:
    console = Device(path="/dev/ttyS0", name="", group="", usable=False)
    usable = replace(FORBIDDEN, usable=True)
    for serial, word in (
        ((FORBIDDEN,), "usermod -aG dialout"),
        ((FORBIDDEN, usable), None),
        ((), "plugged in"),
        ((console,), "root"),
        ((console, FORBIDDEN), "usermod -aG dialout"),
    ):
        found = replace(here.connections, serial=serial)
        told = works(here, monkeypatch, connections=found).works["servos on a serial port"]
        assert told is None if word is None else word in str(told)


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_taken_port_no_renderer_and_a_full_disk(here: checkup.Checkup, monkeypatch: Any) -> None:
    taken = NetworkPort(protocol="tcp", number=7447, use="hexctl serve", free=False)
    network: Connections = replace(here.connections, network=(taken,))
    full: Machine = replace(here.machine, disk_free_mb=40, realtime=False)
    blind = Drawing(renderers={"egl": None, "osmesa": None}, display=False)
    monkeypatch.setenv("DISPLAY", "alices-desk:10.0")
    told = works(here, monkeypatch, connections=network, machine=full, drawing=blind)
    assert told.variables["DISPLAY"] == "given:10.0"
    assert "7447" in str(told.works["hexctl serve"])
    assert "40 MB" in str(told.works["room for recordings"])
    assert "rtprio" in str(told.works["keep time on a busy machine"])
    assert told.works["GIF of walks"] is not None
    assert told.works["view walks in a window"] is not None
    locked = works(here, monkeypatch, machine=replace(here.machine, folder_writable=False))
    assert locked.works["room for recordings"] is not None


@pytest.mark.slow
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


@pytest.mark.slow
def test_a_graphics_library_that_ends_its_process_draws_nothing(monkeypatch: Any) -> None:
    monkeypatch.setattr(machine, "PROGRAM", "import os; os.abort()")
    found = machine.read_drawing()
    assert not found.draws


def test_values_have_their_place_and_name_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("HEXCTL_ROBOT", f"{tmp_path}/my.yaml")
    monkeypatch.setenv("HEXCTL_RUN_SEED", "3")
    Path("hexctl.toml").write_text(
        "robot = 'ant'\nconnect = 'tls/secret.lab:7447'\n[run]\nduration = 2\n[see]\ncamera = 'http://a/b'\n"
    )
    found = {one.key: one for one in read_settings_found("HEXCTL_RUN_SEED".__eq__).values}
    assert found["robot"] == SettingFound(key="robot", value="~/my.yaml", origin="environment")
    assert found["run.duration"] == SettingFound(key="run.duration", value="2", origin="hexctl.toml")
    assert found["HEXCTL_RUN_SEED"].value == "3"
    assert found["connect"].value == found["see.camera"].value == "given"


@pytest.mark.slow
def test_doctor_says_what_works_and_which_settings_are_in_force_and_what_is_wrong(
    monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    Path("hexctl.toml").write_text("robot = 'pexod'\nconnect = 'tls/secret.lab:7447'\n[run]\nduraton = 3\n")
    for name in ("HEXCTL_OTHERS", "HEXCTL_PRIOR_BUILD_WORLDS", "HEXCTL_RUN_DURATON"):
        monkeypatch.setenv(name, "3")
    printed = call("doctor")
    facts, _, works = printed.out.partition("\nwhat works\n")
    rows = dict(line.split("  ", 1) for line in facts.splitlines())
    assert list(rows)[:4] == ["hexctl", "python", "system", "processor"]
    assert "robot = pexod, connect = given, run.duraton = 3" in rows["settings"]
    assert "HEXCTL_OTHERS" in rows["unknown variables"]
    assert "HEXCTL_PRIOR_BUILD_WORLDS" not in rows["unknown variables"]
    assert "secret.lab" not in printed.out + printed.err
    assert printed.err.startswith("hexctl: HEXCTL_RUN_DURATON: ")
    answers = {line.split("  ")[0]: line.split("  ", 1)[1].strip() for line in works.splitlines()}
    assert answers["simulate walks"] == "yes"
    assert all(answer == "yes" or answer.startswith("NO: ") for answer in answers.values())
    report = call("doctor --json").json
    assert str(Path.home()) == "/" or f"({Path.home()}/" not in json.dumps(report)
    assert report["machine"]["cores"] >= 1
    assert report["works"]["simulate walks"] is None
    assert "HEXCTL_PRIOR_BUILD_WORLDS" in {one["key"] for one in report["settings"]["values"]}
    assert {"HEXCTL_OTHERS", "HEXCTL_RUN_DURATON"} <= {*report["settings"]["unknown"]}
