"""`hexctl servos` as a user calls it."""

import io
import json
import os
import sys
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.robot.loader import load_robot_file
from hexctl.robot.servos.bus_map import bus_map_of
from hexctl.types import JOINT_NAMES
from tests.backends.bus.boards import a_map, bus_board
from tests.robots import edited_file, put

ONLY_ONE = [
    f"mute:{leg}:{joint}"
    for leg in range(1, 7)
    for joint in ("coxa", "femur", "tibia")
    if (leg, joint) != (1, "coxa")
]


@pytest.mark.long
@pytest.mark.realtime
@pytest.mark.parametrize(("driver", "model"), [("feetech", "sts3215"), ("lx16a", "lx16a")])
def test_a_scan_is_an_array_or_a_table(driver: str, model: str, capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map(driver, model)) as board:
        words = ["servos", "scan", "--driver", driver, "--connect", board.path]
        assert exit_code([*words, "--json"]) == 0
        printed = capsys.readouterr()
        found = json.loads(printed.out)
        assert [each["id"] for each in found] == list(range(1, 19))
        tells = driver != "lx16a"
        assert {each["model"] for each in found} == ({model} if tells else {None})
        assert {"id", "model", "position", "voltage", "temperature"} <= found[0].keys()
        untold = "" if tells else "these servos do not report their model\n"
        kind = "firmware 3.10, 12 V type, 4 to 14 V: all" if tells else "4.5 to 12 V: all"
        assert printed.err == f"asking ids: 253, some seconds\n{untold}{kind}\n"
        assert exit_code(words) == 0
        table = capsys.readouterr().out
        assert (model in table) is tells
        assert all(unit in table for unit in (" counts", " V", " °C"))
        assert max(map(len, table.splitlines())) <= 80


@pytest.mark.realtime
def test_a_driver_that_knows_no_model_is_doubted(capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map(), *ONLY_ONE) as board:
        words = ["servos", "scan", "--driver", "dynamixel", "--connect", f"{board.path}:1000000", "--json"]
        assert exit_code(words) == 0
        printed = capsys.readouterr()
    assert [each["model"] for each in json.loads(printed.out)] == [None]
    assert "is dynamixel the right driver?" in printed.err


@pytest.mark.long
@pytest.mark.realtime
def test_servos_at_another_baud_are_hinted_at_and_found_with_all(capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map(), *ONLY_ONE, baud=115_200) as board:
        words = ["servos", "scan", "--driver", "feetech", "--connect", board.path, "--json"]
        assert exit_code(words) == 3
        printed = capsys.readouterr()
        assert json.loads(printed.out) == []
        assert "no servo answers on" in printed.err
        assert "--baud all also asks at 500000, 115200, 38400" in printed.err
        assert exit_code([*words, "--baud", "all"]) == 0
        found = json.loads(capsys.readouterr().out)
    assert [(each["id"], each["baud"]) for each in found] == [(1, 115_200)]


@pytest.mark.realtime
def test_an_id_is_set_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    for driver, model in (("feetech", "sts3215"), ("lx16a", "lx16a")):
        with bus_board(a_map(driver, model), *ONLY_ONE) as board:
            words = ["servos", "set-id", "99", "--driver", driver, "--connect", board.path, "--json"]
            assert exit_code(words) == 0
            assert json.loads(capsys.readouterr().out)["id"] == 99


@pytest.mark.realtime
def test_a_servo_is_tested_with_consent_only(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    with bus_board(a_map()) as board:
        words = ["servos", "test", "8", "--driver", "feetech", "--connect", board.path, "--json"]
        monkeypatch.setattr(sys, "stdin", open(os.devnull))  # noqa: SIM115
        assert exit_code(words) == 2
        assert "--yes: got none" in capsys.readouterr().err
        _says(monkeypatch, "no\n")
        assert exit_code(words) == 2
        assert "nothing was moved" in capsys.readouterr().err
        _says(monkeypatch, "yes\n")
        assert exit_code(words) == 0
        printed = capsys.readouterr()
        assert "goes limp and moves by 10 degrees" in printed.err
        trial = json.loads(printed.out)
        assert trial["followed"]
        assert exit_code([*words, "--yes"]) == 0
        assert exit_code(["servos", "test", "99", *words[3:]]) == 3
        assert "no servo with id 99 answers" in capsys.readouterr().err


@pytest.mark.realtime
def test_a_servo_that_is_stuck_is_an_exit_code(capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map()) as board:
        board._robot.write = lambda targets: targets  # type: ignore[method-assign]  # nothing moves
        words = ["servos", "test", "8", "--driver", "feetech", "--connect", board.path, "--yes"]
        assert exit_code(words) == 3
        printed = capsys.readouterr()
        assert "followed" in printed.out
        assert "it did not follow: is its leg free" in printed.err


@pytest.mark.realtime
def test_joints_are_identified_and_no_robot_file_is_written(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with bus_board(a_map()) as board:
        section = {"driver": "feetech", "port": board.path, "model": "sts3215"}
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        before = file.read_text()
        _says(monkeypatch, "\n2f\n")
        assert exit_code(["servos", "identify", "5", "--robot", str(file)]) == 0
        printed = capsys.readouterr()
        assert printed.out.endswith("  leg2_femur: {id: 5}\n")
        assert "Hold the robot up" in printed.err
        assert file.read_text() == before
        words = ["servos", "identify", "5", "--robot", str(file), "--output", "x"]
        assert exit_code(words) == 2
        assert "--output: got it with --robot" in capsys.readouterr().err


@pytest.mark.realtime
@pytest.mark.parametrize(("words", "model"), [((), "lx16a"), (("--model", "lx224"), "lx224")])
def test_a_model_that_servos_do_not_tell_is_written(
    words: tuple[str, ...],
    model: str,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    with bus_board(a_map("lx16a", "lx16a")) as board:
        _says(monkeypatch, "\n2f\n")
        assert (
            exit_code(["servos", "identify", "5", "--driver", "lx16a", "--connect", board.path, *words]) == 0
        )
    printed = capsys.readouterr()
    assert f"  model: {model}\n" in printed.out
    assert f"id 5 ({model}), 1 of 1: Enter moves it" in printed.err
    assert (
        "these servos do not report their model: lx16a is written; --model sets another" in printed.err
    ) is not bool(words)


@pytest.mark.realtime
def test_a_file_that_there_is_not_is_not_named(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    with bus_board(a_map()) as board:
        _says(monkeypatch, "skip\n")
        words = ["servos", "identify", "5", "--driver", "feetech", "--connect", board.path]
        assert exit_code([*words, "--output", str(tmp_path / "new.yaml")]) == 0
    assert capsys.readouterr().err.endswith("0 of 18 joints are known; nothing is written\n")
    assert not list(tmp_path.iterdir())


@pytest.mark.realtime
def test_a_lost_id_is_given_back(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    joints = {name: {"id": 21 + place} for place, name in enumerate(JOINT_NAMES)}
    file = edited_file(tmp_path, put("servos", {"driver": "feetech", **joints}), base="phantomx")
    bus_map = bus_map_of(load_robot_file(file).content.servos, "feetech")
    with bus_board(bus_map, "lost-id:3:tibia") as board:
        words = ["servos", "adopt", "--robot", str(file), "--connect", board.path, "--yes", "--json"]
        assert exit_code(words) == 0
        adopted = json.loads(capsys.readouterr().out)
        assert (adopted["joint"], adopted["id"]) == ("leg3_tibia", 29)
        assert exit_code(words) == 3
        assert "exactly one must be missing" in capsys.readouterr().err


def _says(monkeypatch: pytest.MonkeyPatch, text: str) -> None:
    """Let a user type a text."""
    read, write = os.pipe()
    os.write(write, text.encode())
    os.close(write)
    monkeypatch.setattr(sys, "stdin", io.TextIOWrapper(os.fdopen(read, "rb")))


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["scan", "--driver", "hitec", "--connect", "x"], "got hitec; allowed: dynamixel, feetech, lx16a"),
        (
            ["scan", "--robot", "freenove-big"],
            "hobby servos (pca9685) do not answer; allowed: a robot file with dyn",
        ),
        (
            ["identify", "--model", "lx224", "--driver", "feetech", "--connect", "x"],
            "allowed: with lx16a; others",
        ),
        (["scan", "--connect", "x"], "--driver: got none; allowed: dynamixel, feetech, lx16a"),
        (["scan", "--driver", "feetech"], "--connect: got none; allowed: the port of the bus"),
        (["scan", "--driver", "feetech", "--connect", "x", "--baud", "9"], "1200 to 4500000 baud, or all"),
        (["scan", "--driver", "feetech", "--connect", "/dev/nothing"], "there is no port"),
        (["set-id", "300", "--driver", "feetech", "--connect", "x"], "got 300; allowed: 0..252"),
        (["adopt", "--robot", "phantomx", "--connect", "x"], "--driver: got none"),
        (["adopt", "--connect", "x"], "--robot: got none"),
    ],
)
def test_bad_input_is_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["servos", *words]) in (2, 3)
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


@pytest.mark.long
@pytest.mark.realtime
def test_a_scan_with_a_robot_file_says_which_joints_servos_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    with bus_board(a_map()) as board:
        ids = {name: {"id": place + 2} for place, name in enumerate(JOINT_NAMES)}
        section = {"driver": "feetech", "port": board.path, "model": "sts3215", **ids}
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        assert exit_code(["servos", "scan", "--robot", str(file), "--json"]) == 0
        printed = capsys.readouterr()
        assert exit_code(["servos", "scan", "--robot", str(file)]) == 0
        assert "leg1_femur" in capsys.readouterr().out
    joints = {each["id"]: each["joint"] for each in json.loads(printed.out)}
    assert joints[1] is None
    assert [joints[servo_id] for servo_id in range(2, 19)] == list(JOINT_NAMES[:-1])
    assert "no answer: leg 6 tibia (id 19)\nin no joint of the robot file: id 1\n" in printed.err


@pytest.mark.realtime
def test_a_bus_on_the_port_of_the_settings_keeps_the_baud_of_the_robot_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    with bus_board(a_map(), *ONLY_ONE, baud=115_200) as board:
        ids = {name: {"id": place + 1} for place, name in enumerate(JOINT_NAMES)}
        section = {"driver": "feetech", "port": "/dev/none", "baud": 115_200, "model": "sts3215", **ids}
        file = edited_file(tmp_path, put("servos", section), base="phantomx")
        monkeypatch.setenv("HEXCTL_CONNECT", board.path)
        assert exit_code(["servos", "scan", "--robot", str(file), "--json"]) == 0
        printed = capsys.readouterr()
    assert [each["id"] for each in json.loads(printed.out)] == [1]
    assert f"hexctl: HEXCTL_CONNECT sets --connect {board.path}" in printed.err
