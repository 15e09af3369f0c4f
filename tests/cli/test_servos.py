"""`hexctl servos` and `hexctl ports` as a user calls them."""

import json

import pytest

from hexctl.cli.main import exit_code
from tests.backends.bus.boards import a_map, bus_board

ONLY_ONE = [
    f"mute:{leg}:{joint}"
    for leg in range(1, 7)
    for joint in ("coxa", "femur", "tibia")
    if (leg, joint) != (1, "coxa")
]


def test_a_scan_is_an_array_or_a_table(capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map()) as board:
        words = ["servos", "scan", "--driver", "feetech", "--port", board.path]
        assert exit_code([*words, "--json"]) == 0
        found = json.loads(capsys.readouterr().out)
        assert [each["id"] for each in found] == list(range(1, 19))
        assert {"id", "model", "position", "voltage", "temperature"} <= found[0].keys()
        assert exit_code(words) == 0
        assert "sts3215" in capsys.readouterr().out


def test_a_driver_that_knows_no_model_is_doubted(capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map(), *ONLY_ONE) as board:
        words = ["servos", "scan", "--driver", "dynamixel", "--port", f"{board.path}:1000000", "--json"]
        assert exit_code(words) == 0
        printed = capsys.readouterr()
    assert [each["model"] for each in json.loads(printed.out)] == [None]
    assert "is dynamixel the right driver?" in printed.err


def test_an_id_is_set_and_shown(capsys: pytest.CaptureFixture[str]) -> None:
    with bus_board(a_map(), *ONLY_ONE) as board:
        words = ["servos", "set-id", "99", "--driver", "feetech", "--port", board.path, "--json"]
        assert exit_code(words) == 0
        assert json.loads(capsys.readouterr().out)["id"] == 99


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["scan", "--driver", "hitec", "--port", "x"], "got hitec; allowed: dynamixel, feetech"),
        (["scan", "--driver", "feetech", "--port", "/dev/nothing"], "cannot be opened"),
        (["set-id", "300", "--driver", "feetech", "--port", "x"], "got 300; allowed: 0..252"),
    ],
)
def test_bad_input_is_one_line(words: list[str], message: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["servos", *words]) in (2, 3)
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_ports_are_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["ports", "--json"]) == 0
    assert all({"port", "adapter", "vendor"} <= each.keys() for each in json.loads(capsys.readouterr().out))
