"""`hexctl sim board` as a user calls it."""

import json
import os
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from tests.backends.mavlink.boards import PATIENCE_S, board, free_port

pytestmark = pytest.mark.realtime


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--backend", "zenoh"], "--backend: got zenoh; allowed: sim, mock"),
        (["--connect", "COM3"], "--connect: got 'COM3'; allowed: udpin:HOST:PORT"),
        (["--connect", "udpin:127.0.0.1:1", "--pty"], "--pty: got --connect udpin:127.0.0.1:1 too"),
        (["--connect", "udpin:192.168.1.2:14550"], "anybody on the network could move the servos"),
        (["--expiry", "0"], "--expiry: got 0; allowed: 0.05 to 1 s"),
        (["--expiry", "nan"], "--expiry: got nan; allowed"),
        (["--release-after", "0.5"], "--release-after: got 0.5; allowed: 1 to 3600 s"),
        (["--seed", "-1"], "--seed: got -1; allowed: 0 or more"),
        (
            ["--backend", "mock", "--world", "flat"],
            "--world: got flat with --backend mock; allowed: with sim",
        ),
        (["--failure", "limp"], "--failure: got 'limp'; allowed: LEG:KIND"),
        (["--keys", "no-such-folder"], "no-such-folder/mavlink.key: cannot be read"),
        (["--robot", "elephant"], "unknown robot 'elephant'"),
        (["--bus", "hitec"], "got hitec; allowed: dynamixel, feetech, lx16a, servo2040, pca9685"),
        (
            ["--bus", "feetech", "--connect", "udpin:127.0.0.1:1"],
            "--connect: got udpin:127.0.0.1:1; allowed: without --bus",
        ),
        (["--fault", "echo"], "--fault: got echo; allowed: with --bus"),
        (["--bus", "feetech", "--fault", "noise"], "--fault: got 'noise'; allowed: mute:LEG:JOINT"),
        (["--bus", "feetech", "--model", "ax12a"], "got ax12a with feetech; allowed: models of feetech"),
        (["--bus", "servo2040", "--model", "ax12a"], "got ax12a; allowed: stock, fork with servo2040"),
        (["--bus", "servo2040", "--fault", "echo"], "--fault: got 'echo'; allowed: mute, unplug, replug, "),
        (
            ["--bus", "pca9685", "--fault", "mute"],
            "got 'mute'; allowed: nack[:SHARE], unplug, ",
        ),
        (["--bus", "pca9685", "--model", "stock"], "--model: got stock with pca9685; allowed: without"),
    ],
)
def test_bad_input_is_one_line(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(["sim", "board", *arguments]) == 2
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_a_port_in_use_is_a_fault(capsys: pytest.CaptureFixture[str]) -> None:
    with board("--backend", "mock") as running:
        port = running.port.replace("udpout", "udpin")
        assert exit_code(["sim", "board", "--backend", "mock", "--connect", port]) == 3
        assert "cannot be opened" in capsys.readouterr().err
        report = running.end()
    assert report["ticks"] > 0
    assert report["overrides"] == 0


def test_it_says_where_it_is_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    process = subprocess.Popen(
        [
            sys.executable,
            "-m",
            "hexctl",
            "sim",
            "board",
            "--backend",
            "mock",
            "--connect",
            f"udpin:127.0.0.1:{free_port()}",
        ],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        cwd=tmp_path,
        env={**os.environ, "MUJOCO_GL": "disable"},
    )
    try:
        assert process.stderr is not None
        greeting = process.stderr.readline()
        process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=PATIENCE_S)
    finally:
        if process.poll() is None:
            process.kill()
            process.communicate()
    assert greeting.startswith("board of ant (mock) at udpin:127.0.0.1:")
    assert (process.returncode, out, err) == (0, "", "")


def test_help_is_there_without_mavlink() -> None:
    """The command line loads neither pymavlink nor a serial port to say what it can do."""
    code = (
        "import sys; from hexctl.cli.main import exit_code; exit_code(['--help']); "
        "print([name for name in sys.modules if name.split('.')[0] in ('pymavlink', 'serial', 'numpy')])"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, timeout=PATIENCE_S, check=True
    )
    assert done.stdout.splitlines()[-1] == "[]"
    assert "calibrate" in done.stdout


def test_a_bus_is_walked_over_a_pseudo_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with board(
        "--bus", "dynamixel", "--model", "ax12a", "--backend", "mock", "--robot", "phantomx"
    ) as running:
        words = ["--robot", "phantomx", "--duration", "1", "--no-record", "--json"]
        file = ["run", "--backend", "dynamixel", "--connect", running.port, *words]
        assert exit_code(file) == 3
        assert "no servo answers on /dev/pts/" in capsys.readouterr().err
        assert running.end()["packets"] == 0
    for driver in ("feetech", "lx16a"):
        with board("--bus", driver, "--backend", "mock", "--robot", "phantomx") as running:
            assert exit_code(["run", "--backend", driver, "--connect", running.port, *words]) == 0
            assert json.loads(capsys.readouterr().out)["status"] == "ok"
            assert running.end()["goals"] > 50


def test_hobby_servos_are_walked_over_a_pseudo_terminal(capsys: pytest.CaptureFixture[str]) -> None:
    with board("--bus", "servo2040", "--model", "fork", "--backend", "mock", "--robot", "ant") as running:
        words = ["--robot", "ant", "--duration", "1", "--no-record", "--json"]
        assert exit_code(["run", "--backend", "servo2040", "--connect", running.port, *words]) == 0
        assert json.loads(capsys.readouterr().out)["status"] == "ok"
        report = running.end()
        assert report["goals"] > 50
        assert report["torn"] == 0


@pytest.mark.parametrize("backend", ["mock", "sim"])
def test_boards_on_an_i2c_bus_are_walked_over_a_socket(
    backend: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with board("--bus", "pca9685", "--backend", backend, "--robot", "ant") as running:
        words = ["--robot", "ant", "--duration", "1", "--no-record", "--json"]
        assert exit_code(["run", "--backend", "pca9685", "--connect", running.port, *words]) == 0
        assert json.loads(capsys.readouterr().out)["status"] == "ok"
        report = running.end()
    assert report["goals"] > 100
    assert report["refused"] == 0
    assert not Path(running.port).parent.exists(), "its folder is gone"


@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("reset@4", "has lost its settings, as after a loss of power"),  # whichever is asked first
        ("unplug@4", "do not answer (Remote I/O error, board at 0x4"),
    ],
)
def test_what_happens_to_boards_on_an_i2c_bus_is_said(
    fault: str, message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    with board("--bus", "pca9685", "--backend", "mock", "--robot", "ant", "--fault", fault) as running:
        words = ["--robot", "ant", "--duration", "60", "--no-record", "--json"]
        assert exit_code(["run", "--backend", "pca9685", "--connect", running.port, *words]) == 3
        assert message in json.loads(capsys.readouterr().out)["stopped"]
        running.end()
