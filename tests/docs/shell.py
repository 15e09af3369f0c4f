"""How the commands of the pages are run: shortened, in an empty folder, on loopback and free ports.

The rules are the tables at the top. A command that no rule covers fails: nothing on a page is left out.
"""

import re
import shutil
import subprocess
import sys
import time
import tomllib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from itertools import pairwise
from pathlib import Path
from typing import Any

import typer

from hexctl.cli.main import app, exit_code
from tests.docs.pages import ROOT
from tests.serve.processes import free_port

#: Appended, so that it takes less time: of two the last one holds.
SHORTER = {
    "run": "--duration 0.5",
    "adapt": "--budget 2",
    "study": "--legs 5 --duration 0.5 --runs 2 --budget 10",
}
#: Appended to walks on a robot that is served, which take as long as they say.
SHORTER_SERVED = {
    "run": "--duration 0.5 --self-rotation none",
    "adapt": "--budget 1 --duration 1 --self-rotation none",
}
#: Left out: a window, and the speed of a real robot.
DROPPED = ("--view", "--realtime")

#: Only parsed, as the program itself would: commands with all of these words, and why.
PARSED = {
    ("view",): "opens a window, until it is closed",
    ("calibrate",): "asks a person what each servo did",
    ("adapt", "--ask"): "asks a person where the robot is",
    ("adapt", "tls/robot.local:7447"): "needs a robot on another computer",
    ("study", "--transfer"): "simulates for an hour; tests/study has a small one",
    ("prior", "build"): "walks 120 gaits a world, half a minute at least; tests/cli/test_prior.py has it",
    ("--dask",): "needs a cluster; tests/study has one",
}

#: The robot file that a reader has made, where a page speaks of one without making it.
READERS_ROBOT = ROOT / "configs" / "robots" / "phantomx.yaml"

#: How long a robot or a board may take to come up on a busy machine.
PATIENCE_S = 60.0


def parse(arguments: Sequence[str]) -> None:
    """Parse a command as hexctl does, without running it; unknown options and values raise."""
    command: Any = typer.main.get_command(app)
    words = list(arguments)
    while hasattr(command, "commands"):
        command = command.commands[words.pop(0)]
    command.make_context("hexctl", words)


class Shell:
    """Runs the commands of one page, one after another, in one folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._programs = ExitStack()
        self._robot: list[str] = []  # where clients find the robot that is served
        self._board = ""  # where clients find the servo board

    def __enter__(self) -> "Shell":
        return self

    def __exit__(self, *_: object) -> None:
        self._programs.close()

    def do(self, words: Sequence[str]) -> None:
        """Run a command, or what stands for it."""
        handlers: dict[str, Callable[[list[str]], None]] = {
            "hexctl": self.hexctl,
            "python": self._python,
            "make": self._make,
            "cp": self._copy,
            "pip": _pip,
            "git": _git,
            "sudo": _sudo,
            "sudoedit": _sudo,
            "dask": _dask,
            "cd": lambda _: None,  # into what git cloned: the page's folder stands for it
            "source": lambda words: _require(words == [".venv/bin/activate"]),
        }
        handlers[words[0]](list(words[1:]))

    def hexctl(self, arguments: list[str]) -> None:
        """Run `hexctl ARGUMENTS`, which must succeed."""
        parse(arguments)
        if any(set(words) <= set(arguments) for words in PARSED):
            return
        self._make_robot_file(arguments)
        name = arguments[0] if arguments[0] not in ("prior", "keys", "sessions") else " ".join(arguments[:2])
        arguments = [word for word in arguments if word not in DROPPED]
        if name in ("serve", "board"):
            {"serve": self._serve, "board": self._start_board}[name](arguments)
            return
        served = name in ("status", "estop") or "zenoh" in arguments
        if served:
            arguments += [*SHORTER_SERVED.get(name, "").split(), *self._robot]
        else:
            arguments += SHORTER.get(name, "").split()
        if "mavlink" in arguments:
            arguments += ["--connect", self._board]
        _stay_here(arguments)
        code = exit_code(arguments)
        assert code == 0, f"exit code {code} of hexctl {' '.join(arguments)}"

    def _make_robot_file(self, arguments: list[str]) -> None:
        for word, after in pairwise(arguments):
            if word == "--robot" and after.startswith("./") and not (self._folder / after).exists():
                (self._folder / after).write_bytes(READERS_ROBOT.read_bytes())

    def _serve(self, arguments: list[str]) -> None:
        """Serve a robot on loopback until the page serves another; a simulated one stands for a real one."""
        self._programs.close()
        if "mavlink" in arguments:
            arguments[arguments.index("mavlink")] = "sim"
            at = arguments.index("--device")
            del arguments[at : at + 2]
        listen = arguments[arguments.index("--listen") + 1] if "--listen" in arguments else "tcp/"
        endpoint = f"{listen.partition('/')[0]}/127.0.0.1:{free_port()}"
        self._robot = ["--connect", endpoint]
        if "--keys" in arguments:
            self._robot += ["--keys", arguments[arguments.index("--keys") + 1]]
        self._start([*arguments, "--listen", endpoint], "serving ")

    def _start_board(self, arguments: list[str]) -> None:
        said = self._start(arguments, "board of ")
        found = re.search(r" at (\S+),", said)
        assert found, said
        self._board = found[1]

    def _start(self, arguments: list[str], ready: str) -> str:
        """Start a program that is ended with the shell, by its id, and return what it said once ready."""
        output = self._folder / f"program-{free_port()}.out"
        with output.open("w", encoding="utf-8") as file:
            process = subprocess.Popen(
                [sys.executable, "-u", "-m", "hexctl", *arguments],
                cwd=self._folder,
                stdin=subprocess.DEVNULL,
                stdout=file,
                stderr=subprocess.STDOUT,
            )
        self._programs.callback(process.wait, 30)
        self._programs.callback(process.terminate)
        until_s = time.monotonic() + PATIENCE_S
        while ready not in (said := output.read_text(encoding="utf-8")):
            assert process.poll() is None, said
            assert time.monotonic() < until_s, said
            time.sleep(0.02)
        return said

    def _python(self, words: list[str]) -> None:
        _require(words[:2] == ["-m", "hexctl"])
        self.hexctl(words[2:])

    def _make(self, words: list[str]) -> None:
        """Run what a target would run of hexctl; the target must exist."""
        shown = subprocess.run(
            [shutil.which("make") or "make", "-n", *words],
            cwd=ROOT,
            capture_output=True,
            text=True,
            check=True,
            timeout=60,
        )
        ours = [line.split() for line in shown.stdout.splitlines() if line.startswith(".venv/bin/hexctl ")]
        _require(bool(ours) == (words == ["demo"]))
        for _, *arguments in ours:
            self.hexctl(arguments)

    def _copy(self, words: list[str]) -> None:
        """Copy a file of the repository into the folder."""
        source, target = words
        (self._folder / target).write_bytes((ROOT / source).read_bytes())


def _stay_here(arguments: list[str]) -> None:
    """Refuse to reach for the computers that the pages name as examples."""
    ends = [after for word, after in pairwise(arguments) if word == "--connect"]
    assert all(end.startswith("/dev/pts/") or "/127.0.0.1:" in end for end in ends[-1:]), ends
    assert not any("://" in word for word in arguments), arguments


def _require(holds: bool) -> None:
    assert holds, "no rule for this command"


def _pip(words: list[str]) -> None:
    """Check that the extras exist."""
    _require(words[0] == "install" and words[1].startswith("."))
    extras = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"]
    wanted = [extra for extra in words[1][1:].strip("[]").split(",") if extra]
    assert set(wanted) <= set(extras), wanted


def _git(words: list[str]) -> None:
    _require(words == ["clone", "<this", "repository>", "hexctl"])


def _sudo(words: list[str]) -> None:
    """Need root, so only look that the service file is there and would be where the next command looks."""
    service = "hexctl-serve"
    assert (ROOT / "configs" / "systemd" / f"{service}.service").is_file()
    assert service in words[-1] or words[:2] == ["cp", f"configs/systemd/{service}.service"]


def _dask(words: list[str]) -> None:
    """Parse a command of Dask as Dask does."""
    from distributed.cli import dask_scheduler, dask_worker

    command: Any = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}[words[0]]
    command.make_context(f"dask {words[0]}", words[1:])
