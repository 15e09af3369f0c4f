"""`hexctl sim board` and `sim camera` as a user calls them."""

import signal
import subprocess
import sys
from pathlib import Path

import pytest

from tests.backends.mavlink.boards import PATIENCE_S, board
from tests.cli.conftest import Call
from tests.server.processes import free_port


@pytest.mark.realtime
def test_it_says_where_it_is_and_ends_with_ctrl_c(tmp_path: Path) -> None:
    words = ["sim", "board", "--backend", "mock", "--connect", f"udpin:127.0.0.1:{free_port()}"]
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
    ],
)
def test_a_walk_goes_through_a_simulated_bus(bus: str, model: str | None, robot: str, call: Call) -> None:
    """A pseudo-terminal, and a socket for i2c."""
    models = ("--model", model) if model else ()
    with board("--bus", bus, *models, "--backend", "mock", "--robot", robot) as running:
        words = ["--robot", robot, "--duration", "1", "--no-record", "--json"]
        assert call("run --backend", bus, "--connect", running.port, *words).json["status"] == "ok"
        report = running.end()
    assert report["goals"] > 50
    assert not report.get("torn")
    assert not report.get("refused")
    if bus == "pca9685":
        assert not Path(running.port).parent.exists(), "its folder is gone"


@pytest.mark.realtime
def test_servos_of_another_driver_do_not_answer(call: Call) -> None:
    with board("--bus", "dynamixel", "--model", "ax12a", "--backend", "mock", "--robot", "phantomx") as made:
        words = ["--robot", "phantomx", "--duration", "1", "--no-record", "--json"]
        assert "/dev/pts/" in call("run --backend dynamixel --connect", made.port, *words, code=3).err
        assert made.end()["packets"] == 0


@pytest.mark.realtime
@pytest.mark.parametrize(
    ("fault", "message"),
    [
        ("reset@4", "loss of power"),  # whichever is asked first
        ("unplug@4", "Remote I/O error"),
    ],
)
def test_what_happens_to_boards_on_an_i2c_bus_is_said(fault: str, message: str, call: Call) -> None:
    with board("--bus", "pca9685", "--backend", "mock", "--robot", "ant", "--fault", fault) as running:
        words = ["--robot", "ant", "--duration", "60", "--no-record", "--json"]
        assert (
            message in call("run --backend pca9685 --connect", running.port, *words, code=3).json["stopped"]
        )
        running.end()
