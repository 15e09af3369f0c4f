"""Ctrl-C while the program starts: at most one line and exit code 130, whichever module is being imported."""

import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

import pytest

from hexctl.cli.interrupts import NOT_CONFIRMED

pytestmark = pytest.mark.slow

#: Runs a command, and interrupts it where a module begins to be imported, or has been looked for so often.
PROGRAM = """
import os, signal, sys
name, times = sys.argv[1], int(sys.argv[2])
del sys.argv[1:3]
# What starts the tests may have made their processes ignore it.
signal.signal(signal.SIGINT, signal.default_int_handler)
class Interrupting:
    left = times
    def find_spec(self, module, path=None, target=None):
        if module == name and Interrupting.left:
            for _ in range(Interrupting.left):
                os.kill(os.getpid(), signal.SIGINT)
            Interrupting.left = 0
        return None
sys.meta_path.insert(0, Interrupting())
sys.argv[0] = "hexctl"
from hexctl.cli.entry import main
main()
"""

#: Of Python, of extensions that others import half way, and of hexctl.
MODULES = (
    "hexctl.cli.main",
    "typer",
    "hexctl.backends.registry",
    "numpy",
    "numpy._core._multiarray_umath",
    "numpy.linalg._umath_linalg",
    "pydantic_core._pydantic_core",
    "yaml",
    "mujoco",
    "mujoco._structs",
    "mujoco._functions",
    "dm_control.mujoco",
    "hexctl.backends.sim.servos",
    "rerun_bindings",
)

#: Those that are loaded before a command can answer.
BEFORE = MODULES[: MODULES.index("mujoco")]


WALK = ("run", "--duration", "0.2", "--record", "walk.rrd")


def interrupted(
    module: str, times: int, folder: Path, words: Sequence[str] = WALK
) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, module, str(times), *words],
        cwd=folder, capture_output=True, text=True, timeout=120, check=False,
    )  # fmt: skip


@pytest.mark.parametrize("module", MODULES)
def test_ctrl_c_in_an_import_is_one_line_and_130(module: str, tmp_path: Path) -> None:
    done = interrupted(module, 1, tmp_path)
    assert done.returncode == 130, done.stderr
    # Once the walk is asked for, its own soft stop answers, which prints a result.
    assert all(line.startswith("hexctl: ") for line in done.stderr.splitlines())
    assert len(done.stderr.splitlines()) <= 1
    assert done.stderr or module not in BEFORE
    assert "Traceback" not in done.stdout


@pytest.mark.parametrize("module", ["typer", "hexctl.client.stop_client"])
def test_a_stop_that_is_interrupted_says_that_it_has_stopped_nothing(module: str, tmp_path: Path) -> None:
    done = interrupted(module, 1, tmp_path, ("estop", "--connect", "tcp/127.0.0.1:9"))
    assert (done.returncode, len(done.stderr.splitlines())) == (130, 1)
    assert done.stderr.endswith(f"{NOT_CONFIRMED}\n")


def test_a_second_one_does_not_wait(tmp_path: Path) -> None:
    done = interrupted("pydantic_core._pydantic_core", 2, tmp_path)
    assert (done.returncode, done.stderr) == (130, "hexctl: interrupted\n")
