"""`hexctl servos`, `ports` and `sim board` as a user calls them."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml
from serial.tools.list_ports_common import ListPortInfo

from hexctl.backends.bus.bus_map import bus_map_of
from hexctl.backends.bus.servos import BusServos
from hexctl.backends.registry import NOT_WALKED_THROUGH, BackendOptions, make_servos
from hexctl.cli.main import exit_code
from hexctl.robot.loader import load_robot_file
from hexctl.simulators.register_servos import BusServo
from hexctl.types import JOINT_NAMES
from tests.backends.bus.boards import MemoryBus, a_map, memory_bus
from tests.backends.mavlink.boards import PATIENCE_S, board
from tests.cli.conftest import Call
from tests.cli.terminals import type_in
from tests.robots import edited_file, put
from tests.server.processes import free_port

ONLY_ONE = [
    f"mute:{leg}:{joint}"
    for leg in range(1, 7)
    for joint in ("coxa", "femur", "tibia")
    if (leg, joint) != (1, "coxa")
]


@pytest.mark.parametrize("driver", ["dynamixel", "lx16a"])
def test_another_driver_that_fits_is_named(driver: str, call: Call) -> None:
    with memory_bus(a_map(), *ONLY_ONE) as bus:
        words = ["servos", "scan", "--driver", driver, "--port", f"{bus.path}:1000000", "--json"]
        printed = call(*words, code=2 if driver == "dynamixel" else 3)
        assert printed.out.strip() in ("", "[]")
        assert "servos (sts3215) answer with --driver feetech --baud 1000000" in printed.err
        words = ["servos", "scan", "--driver", driver, "--port", bus.path, "--baud", "all"]
        said = call(*words, code=2).err
    advice = "servos (sts3215) answer with --driver feetech --baud 1000000"
    assert said == f"hexctl: --driver: got {driver}, but {advice}\n"


@pytest.mark.parametrize("model", ["sts3215", "sts3032"])  # the second reports no known number
def test_servos_at_another_baud_are_hinted_at_and_found_with_all(model: str, call: Call) -> None:
    with memory_bus(a_map(model=model), *ONLY_ONE, baud=115_200) as bus:
        words = ["servos", "scan", "--driver", "feetech", "--port", bus.path, "--json"]
        printed = call(*words, code=3)
        assert printed.json == []
        assert "servos answer at 115200 baud: a wrong baud rate" in printed.err
        found = call(*words, "--baud", "all").json
    assert [(each["id"], each["baud"]) for each in found] == [(1, 115_200)]


def test_a_servo_is_tested_with_consent_only(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    with memory_bus(a_map()) as bus:
        words = ["servos", "test", "8", "--driver", "feetech", "--port", bus.path, "--json"]
        monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
        assert "--yes: got none" in call(*words, code=2).err
        type_in(monkeypatch, "no\n")
        assert "nothing was moved" in call(*words, code=2).err
        type_in(monkeypatch, "yes\n")
        printed = call(*words)
        assert printed.json["followed"]
        assert "error\n" not in call(*words[:-1], "--yes").out
        assert "99" in call("servos test 99", *words[3:], code=3).err
        bus.robot.write = lambda targets: targets  # type: ignore[method-assign]  # nothing moves
        call(*words, "--yes", code=3)  # it is stuck


def robot_file(folder: Path, first_id: int | None = None, **section: Any) -> Path:
    """A robot file whose joints have ids from a first one on, or none."""
    ids = {} if first_id is None else {name: {"id": first_id + k} for k, name in enumerate(JOINT_NAMES)}
    return edited_file(folder, put("servos", {"driver": "feetech", **section, **ids}), base="phantomx")


def test_joints_are_identified_and_no_robot_file_is_written(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with memory_bus(a_map()) as bus:
        file = robot_file(tmp_path, port=bus.path, model="sts3215")
        before = file.read_text()
        type_in(monkeypatch, "\n2f\n")
        printed = call("servos identify 5 --robot", str(file))
        assert printed.out.endswith("  leg2_femur: {id: 5}\n")
        assert file.read_text() == before
        words = ["servos", "identify", "5", "--robot", str(file), "--output", "x"]
        assert "--output" in call(*words, code=2).err


def test_a_robot_file_remembers_its_walk_through_until_its_ids_change(
    call: Call, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with memory_bus(a_map()) as bus:
        file = robot_file(tmp_path, 1, port=bus.path, model="sts3215")
        words = ["servos", "walk-through", "--robot", str(file), "--yes", "--json"]
        type_in(monkeypatch, "1\n3\n2\n4\n5\n6\n")
        assert call(*words, code=3).json["right"] is False
        assert _note(file) == NOT_WALKED_THROUGH
        type_in(monkeypatch, "1\n2\n3\n4\n5\n6\n")
        assert call(*words).json["right"] is True
        assert _note(file) == ""
    assert load_robot_file(file).content.servos.leg1_coxa.id == 1
    mapping = yaml.safe_load(file.read_text())
    mapping["servos"]["leg1_coxa"]["id"] = 99
    file.write_text(yaml.safe_dump(mapping))
    assert _note(file) == NOT_WALKED_THROUGH
    assert "robot copy" in call("servos walk-through --robot phantomx-ax --yes", code=2).err


def _note(file: Path) -> str:
    """Note about the walk-through that the servos of a robot file have."""
    found = load_robot_file(file)
    servos = make_servos("feetech", BackendOptions(robot=found.robot, robot_file=found))
    assert isinstance(servos, BusServos)
    return servos._note


@pytest.mark.parametrize("part", [("servos", {}), ("servos", {"leg1_coxa": {"id": 3}})])
def test_a_bus_robot_without_ids_is_refused_with_the_command_that_finds_them(
    part: tuple[str, dict[str, Any]], call: Call, tmp_path: Path
) -> None:
    file = str(edited_file(tmp_path, put(*part)))
    for words in (
        "run --backend feetech --port /dev/none --robot",
        "serve --backend feetech --port /dev/none --robot",
        "sim board --bus feetech --robot",
        "servos walk-through --driver feetech --port /dev/none --robot",
    ):
        assert "hexctl servos identify --driver feetech" in call(words, file, code=2).err, words


@pytest.mark.parametrize(("words", "model"), [((), "lx16a"), (("--model", "lx224"), "lx224")])
def test_a_model_that_servos_do_not_tell_is_written(
    words: tuple[str, ...], model: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    with memory_bus(a_map("lx16a", "lx16a")) as bus:
        type_in(monkeypatch, "\n2f\n")
        printed = call("servos identify 5 --driver lx16a --port", bus.path, *words)
    assert f"  model: {model}\n" in printed.out
    assert ("--model" in printed.err) is not bool(words)


def test_a_lost_id_is_given_back(call: Call, tmp_path: Path) -> None:
    file = robot_file(tmp_path, 21)
    bus_map = bus_map_of(load_robot_file(file).content.servos, "feetech")
    with memory_bus(bus_map, "lost-id:3:tibia") as bus:
        words = ["servos", "adopt", "--robot", str(file), "--port", bus.path, "--yes", "--json"]
        adopted = call(*words).json
        assert (adopted["joint"], adopted["id"]) == ("leg3_tibia", 29)
        call(*words, code=3)


def test_a_scan_is_an_array_or_a_table_and_a_robot_file_names_the_joints(tmp_path: Path, call: Call) -> None:
    with memory_bus(a_map()) as bus:
        file = robot_file(tmp_path, 2, port=bus.path, model="sts3215")
        printed = call("servos scan --robot", str(file), "--json")
        table = call("servos scan --robot", str(file)).out
    assert "firmware 3.10, 12 V type, 4 to 14 V: all" in printed.err
    assert all(text in table for text in ("leg1_femur", "sts3215", " counts", " V", " °C"))
    assert max(map(len, table.splitlines())) <= 80
    found = printed.json
    assert {"id", "model", "position", "voltage", "temperature"} <= found[0].keys()
    joints = {each["id"]: each["joint"] for each in found}
    assert joints[1] is None
    assert [joints[servo_id] for servo_id in range(2, 19)] == list(JOINT_NAMES[:-1])
    assert "leg 6 tibia (id 19)" in printed.err


def test_a_scan_says_what_a_model_number_does_not_tell(call: Call) -> None:
    with memory_bus(a_map()) as bus:
        clone, other = bus.board._servos[4], bus.board._servos[7]
        assert isinstance(clone, BusServo)
        assert isinstance(other, BusServo)
        clone.set(clone._table.model, 4242)
        for register in other._table.firmware:
            other.set(register, 0)
        printed = call("servos scan --driver feetech --port", bus.path, "--json")
    assert "id 5: of the unknown model number 4242, which hexctl does not move" in printed.err
    assert "sts3215: the number 777 is also that of its 7.4 V and 12 V types" in printed.err
    assert "firmware unknown: id 8" in printed.err
    with memory_bus(a_map("lx16a", "lx16a")) as bus:
        printed = call("servos scan --driver lx16a --port", bus.path, "--json")
    assert "lx16a, lx224, hts35h and clones answer alike" in printed.err
    assert "firmware unknown: all" in printed.err


def test_a_bus_on_the_port_of_the_settings_keeps_the_baud_of_the_robot_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    with memory_bus(a_map(), *ONLY_ONE, baud=115_200) as bus:
        file = robot_file(tmp_path, 1, port="/dev/none", baud=115_200, model="sts3215")
        monkeypatch.setenv("HEXCTL_PORT", bus.path)
        printed = call("servos scan --robot", str(file), "--json")
    assert [each["id"] for each in printed.json] == [1]
    assert f"hexctl: HEXCTL_PORT sets --port {bus.path}" in printed.err


@pytest.mark.parametrize("vendor", [None, 0x0403])
def test_that_no_usb_adapter_is_there_is_noted(
    vendor: int | None, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    port = ListPortInfo("/dev/ttyAMA0")
    port.vid = port.pid = vendor
    monkeypatch.setattr("serial.tools.list_ports.comports", lambda: [port])
    printed = call("ports")
    assert "/dev/ttyAMA0" in printed.out
    assert [{"port", "adapter", "vendor"} <= each.keys() for each in call("ports --json").json] == [True]
    assert ("no USB serial adapter" in printed.err) is (vendor is None)


def test_driver_and_port_of_a_calibration_come_from_the_robot_file(
    tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    file = robot_file(tmp_path, 1, port="/dev/nothing")
    before = file.read_text()
    monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
    assert "calibrate: no answer can come on stdin" in call("calibrate", str(file), code=2).err
    type_in(monkeypatch, "")
    for options, code, named in (
        ([], 3, "/dev/nothing"),
        (["--port", "/dev/nowhere"], 3, "/dev/nowhere"),
        (["--backend", "dynamixel"], 2, "--backend"),
    ):
        assert named in call("calibrate", str(file), *options, code=code).err
    assert file.read_text() == before


@pytest.mark.realtime
def test_it_says_where_it_is_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    words = ["sim", "board", "--backend", "mock", "--port", f"udpin:127.0.0.1:{free_port()}"]
    process = subprocess.Popen(
        [sys.executable, "-m", "hexctl", *words],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
    )
    try:
        assert process.stderr is not None
        greeting = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
    assert "udpin:127.0.0.1:" in greeting
    assert (process.returncode, out, err) == (0, "", "")


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("bus", "model", "robot"),
    [
        ("feetech", None, "phantomx"),
        ("lx16a", None, "phantomx"),
        ("servo2040", "fork", "ant"),
        ("pca9685", None, "ant"),
        ("maestro", "mini18", "ant"),
        ("ssc32", "ssc32", "ant"),
    ],
)
def test_a_walk_goes_through_a_simulated_bus(bus: str, model: str | None, robot: str, call: Call) -> None:
    """A pseudo-terminal, and a socket for i2c."""
    models = ("--model", model) if model else ()
    with board("--bus", bus, *models, "--backend", "mock", "--robot", robot) as running:
        words = ["--robot", robot, "--duration", "1", "--no-record", "--json"]
        assert call("run --backend", bus, "--port", running.port, *words).json["status"] == "ok"
        report = running.end()
    assert report["goals"] > 50
    assert not report.get("torn")
    assert not report.get("refused")
    if bus == "pca9685":
        assert not Path(running.port).parent.exists(), "its folder is gone"


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("fault", "message"), [("reset@4", "loss of power"), ("unplug@4", "Remote I/O error")]
)
def test_what_happens_to_boards_on_an_i2c_bus_is_said(fault: str, message: str, call: Call) -> None:
    with board("--bus", "pca9685", "--backend", "mock", "--robot", "ant", "--fault", fault) as running:
        words = ["--robot", "ant", "--duration", "60", "--no-record", "--json"]
        outcome = call("run --backend pca9685 --port", running.port, *words, code=3).json
        assert message in outcome["stopped"]
        running.end()


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
        lambda path, baud, **_: (slow if baud == 57_600 else fast).open(path, baud),
    )
    words = ["servos", "scan", "--driver", driver, "--port", fast.path, "--baud", "all", "--json"]
    assert exit_code(words) == 0
    (found,) = [each for each in json.loads(capsys.readouterr().out) if each["model"]]
    assert found["baud"] == {"dynamixel": 57_600, "feetech": 1_000_000}[driver]


@pytest.mark.realtime
def test_servos_of_another_driver_do_not_answer(call: Call) -> None:
    with board("--bus", "dynamixel", "--model", "ax12a", "--backend", "mock", "--robot", "phantomx") as made:
        words = ["--robot", "phantomx", "--duration", "1", "--no-record", "--json"]
        assert "/dev/pts/" in call("run --backend dynamixel", "--port", made.port, *words, code=3).err
        assert made.end()["packets"] == 0
