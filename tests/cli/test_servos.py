"""`hexctl servos` and `ports` as a user calls them."""

import json
import os
import sys
from pathlib import Path

import pytest
from serial.tools.list_ports_common import ListPortInfo

from hexctl.cli.main import exit_code
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.types import JOINT_NAMES
from tests.backends.bus.boards import MemoryBus, a_map, memory_bus
from tests.cli.terminals import type_in
from tests.robots import edited_file, put

ONLY_ONE = [
    f"mute:{leg}:{joint}"
    for leg in range(1, 7)
    for joint in ("coxa", "femur", "tibia")
    if (leg, joint) != (1, "coxa")
]


@pytest.mark.parametrize("driver", ["dynamixel", "lx16a"])
def test_another_driver_that_fits_is_named(driver: str, capsys: pytest.CaptureFixture[str]) -> None:
    with memory_bus(a_map(), *ONLY_ONE) as bus:
        words = ["servos", "scan", "--driver", driver, "--connect", f"{bus.path}:1000000", "--json"]
        assert exit_code(words) == (2 if driver == "dynamixel" else 3)
        printed = capsys.readouterr()
        assert printed.out.strip() in ("", "[]")
        assert "servos (sts3215) answer with --driver feetech --baud 1000000" in printed.err
        words = ["servos", "scan", "--driver", driver, "--connect", bus.path, "--baud", "all"]
        assert exit_code(words) == 2
        said = capsys.readouterr().err
    advice = "servos (sts3215) answer with --driver feetech --baud 1000000"
    assert said == f"hexctl: --driver: got {driver}, but {advice}\n"


@pytest.mark.parametrize("model", ["sts3215", "sts3032"])  # the second reports no known number
def test_servos_at_another_baud_are_hinted_at_and_found_with_all(
    model: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with memory_bus(a_map(model=model), *ONLY_ONE, baud=115_200) as bus:
        words = ["servos", "scan", "--driver", "feetech", "--connect", bus.path, "--json"]
        assert exit_code(words) == 3
        printed = capsys.readouterr()
        assert json.loads(printed.out) == []
        assert "servos answer at 115200 baud: a wrong baud rate" in printed.err
        assert exit_code([*words, "--baud", "all"]) == 0
        found = json.loads(capsys.readouterr().out)
    assert [(each["id"], each["baud"]) for each in found] == [(1, 115_200)]


@pytest.mark.parametrize("driver", ["dynamixel", "feetech"])
def test_servos_of_two_families_on_one_line_are_both_found(
    driver: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    slow, fast = (
        MemoryBus(a_map("dynamixel", "xl430-w250"), *ONLY_ONE, baud=57_600),
        MemoryBus(a_map(), *ONLY_ONE),
    )
    monkeypatch.setattr(
        "hexctl.backends.bus.tools.SerialLine",
        lambda path, baud: (slow if baud == 57_600 else fast).open(path, baud),
    )
    words = ["servos", "scan", "--driver", driver, "--connect", fast.path, "--baud", "all", "--json"]
    assert exit_code(words) == 0
    (found,) = [each for each in json.loads(capsys.readouterr().out) if each["model"]]
    assert found["baud"] == {"dynamixel": 57_600, "feetech": 1_000_000}[driver]


def test_a_servo_is_tested_with_consent_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with memory_bus(a_map()) as bus:
        words = ["servos", "test", "8", "--driver", "feetech", "--connect", bus.path, "--json"]
        monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
        assert exit_code(words) == 2
        assert "--yes: got none" in capsys.readouterr().err
        type_in(monkeypatch, "no\n")
        assert exit_code(words) == 2
        assert "nothing was moved" in capsys.readouterr().err
        type_in(monkeypatch, "yes\n")
        assert exit_code(words) == 0
        printed = capsys.readouterr()
        assert json.loads(printed.out)["followed"]
        assert exit_code([*words[:-1], "--yes"]) == 0
        assert "error\n" not in capsys.readouterr().out
        assert exit_code(["servos", "test", "99", *words[3:]]) == 3
        assert "99" in capsys.readouterr().err
        bus.robot.write = lambda targets: targets  # type: ignore[method-assign]  # nothing moves
        assert exit_code([*words, "--yes"]) == 3, "it is stuck"


def test_joints_are_identified_and_no_robot_file_is_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with memory_bus(a_map()) as bus:
        section = {"driver": "feetech", "port": bus.path, "model": "sts3215"}
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        before = file.read_text()
        type_in(monkeypatch, "\n2f\n")
        assert exit_code(["servos", "identify", "5", "--robot", str(file)]) == 0
        printed = capsys.readouterr()
        assert printed.out.endswith("  leg2_femur: {id: 5}\n")
        assert file.read_text() == before
        words = ["servos", "identify", "5", "--robot", str(file), "--output", "x"]
        assert exit_code(words) == 2
        assert "--output" in capsys.readouterr().err


@pytest.mark.parametrize(("words", "model"), [((), "lx16a"), (("--model", "lx224"), "lx224")])
def test_a_model_that_servos_do_not_tell_is_written(
    words: tuple[str, ...],
    model: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with memory_bus(a_map("lx16a", "lx16a")) as bus:
        type_in(monkeypatch, "\n2f\n")
        assert exit_code(["servos", "identify", "5", "--driver", "lx16a", "--connect", bus.path, *words]) == 0
    printed = capsys.readouterr()
    assert f"  model: {model}\n" in printed.out
    assert ("--model" in printed.err) is not bool(words)


def test_a_lost_id_is_given_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    joints = {name: {"id": 21 + place} for place, name in enumerate(JOINT_NAMES)}
    file = edited_file(tmp_path, put("servos", {"driver": "feetech", **joints}), base="phantomx")
    bus_map = bus_map_of(load_robot_file(file).content.servos, "feetech")
    with memory_bus(bus_map, "lost-id:3:tibia") as bus:
        words = ["servos", "adopt", "--robot", str(file), "--connect", bus.path, "--yes", "--json"]
        assert exit_code(words) == 0
        adopted = json.loads(capsys.readouterr().out)
        assert (adopted["joint"], adopted["id"]) == ("leg3_tibia", 29)
        assert exit_code(words) == 3


def test_a_scan_is_an_array_or_a_table_and_a_robot_file_names_the_joints(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with memory_bus(a_map()) as bus:
        ids = {name: {"id": place + 2} for place, name in enumerate(JOINT_NAMES)}
        section = {"driver": "feetech", "port": bus.path, "model": "sts3215", **ids}
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        assert exit_code(["servos", "scan", "--robot", str(file), "--json"]) == 0
        printed = capsys.readouterr()
        assert exit_code(["servos", "scan", "--robot", str(file)]) == 0
        table = capsys.readouterr().out
    assert "firmware 3.10, 12 V type, 4 to 14 V: all" in printed.err
    assert all(text in table for text in ("leg1_femur", "sts3215", " counts", " V", " °C"))
    assert max(map(len, table.splitlines())) <= 80
    found = json.loads(printed.out)
    assert {"id", "model", "position", "voltage", "temperature"} <= found[0].keys()
    joints = {each["id"]: each["joint"] for each in found}
    assert joints[1] is None
    assert [joints[servo_id] for servo_id in range(2, 19)] == list(JOINT_NAMES[:-1])
    assert "leg 6 tibia (id 19)" in printed.err


def test_a_bus_on_the_port_of_the_settings_keeps_the_baud_of_the_robot_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with memory_bus(a_map(), *ONLY_ONE, baud=115_200) as bus:
        ids = {name: {"id": place + 1} for place, name in enumerate(JOINT_NAMES)}
        section = {"driver": "feetech", "port": "/dev/none", "baud": 115_200, "model": "sts3215", **ids}
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        monkeypatch.setenv("HEXCTL_CONNECT", bus.path)
        assert exit_code(["servos", "scan", "--robot", str(file), "--json"]) == 0
        printed = capsys.readouterr()
    assert [each["id"] for each in json.loads(printed.out)] == [1]
    assert f"hexctl: HEXCTL_CONNECT sets --connect {bus.path}" in printed.err


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


def test_driver_and_port_of_a_calibration_come_from_the_robot_file(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    section = {"driver": "feetech", "port": "/dev/nothing"}
    file = edited_file(tmp_path, put("servos", section), base="phantomx")
    before = file.read_text()
    monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
    assert exit_code(["calibrate", str(file)]) == 2, "nobody can answer"
    assert "calibrate: no answer can come on stdin" in capsys.readouterr().err
    type_in(monkeypatch, "")
    for options, code, named in (
        ([], 3, "/dev/nothing"),
        (["--connect", "/dev/nowhere"], 3, "/dev/nowhere"),
        (["--backend", "dynamixel"], 2, "--backend"),
    ):
        assert exit_code(["calibrate", str(file), *options]) == code
        assert named in capsys.readouterr().err
    assert file.read_text() == before
