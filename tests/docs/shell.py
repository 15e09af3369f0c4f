"""How the commands of the pages are run: shortened, in an empty folder, on loopback and free ports.

The rules are the tables at the top. A command that no rule covers fails: nothing on a page is left out. What
another page has already is only parsed; `page_of` says whose it is.
"""

import os
import re
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from functools import cache
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest
import typer

from hexctl.cli.main import app, exit_code
from hexctl.robot.plugins import plugins
from hexctl.robot.servos.drivers import BOARDS, FAMILIES
from tests.docs.pages import PAGES, ROOT, commands
from tests.server.processes import free_port, program

#: Appended, so that it takes less time: of two the last one holds.
SHORTER = {
    "run": "--duration 0.5",
    "adapt": "--budget 2",
    "demo": "--budget 1 --no-view",
    "study": "--legs 5 --duration 0.5 --runs 2 --budget 5",
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
    ("play",): "plays until a person ends it; tests/browser does",
    ("drive",): "drives until a person ends it; tests/cli/test_drive.py does",
    ("calibrate",): "asks a person what each servo did",
    ("walk-through",): "asks a person which leg moved",
    ("identify",): "moves the joints and fits for minutes; tests/identify has it",
    ("estop", "--ready"): "waits for a key of a terminal; tests/client/test_stop_client.py presses one",
    ("adapt", "--ask"): "asks a person where the robot is",
    ("adapt", "tls/robot.local:7447"): "needs a robot on another computer",
    ("study", "--legs"): "the same as plain study, once that is shortened",
    ("study", "--transfer"): "simulates for an hour; tests/study has a small one",
    ("study", "--hold"): "walks for an hour; tests/cli/test_study.py has a small one",
    ("study", "--recovery"): "walks for hours; tests/cli/test_study.py has a small one",
    ("study", "--matrix"): "simulates for hours; tests/study has a small one",
    ("prior", "build"): "walks 120 gaits a world, for minutes; tests/cli/test_study.py has it",
    ("run", "2:limp@8"): "fails later than a shortened walk ends; tests/cli/test_run.py has one",
    ("run", "5:limp@8"): "fails later than a shortened walk ends; tests/cli/test_run.py has one",
    ("run", "--then"): "changes its gait later than a shortened walk ends; tests/control/walks has one",
    ("--dask",): "needs a cluster; tests/study has one",
}

#: Commands of which each distinct one is run on one page only: what they leave behind, no other needs.
RUN_ONCE = ("run", "adapt", "demo", "study", "check", "prior show")


def parse(arguments: Sequence[str]) -> None:
    """Parse a command as hexctl does, without running it; unknown options and values raise."""
    command: Any = typer.main.get_command(app)
    words = list(arguments)
    while hasattr(command, "commands") and not words[0].startswith("-"):  # `hexctl see` takes options too
        command = command.commands[words.pop(0)]
    command.make_context("hexctl", words)


def name_of(arguments: Sequence[str]) -> str:
    """The name of a command, of two words in a group."""
    return " ".join(arguments[: 2 if arguments[0] in ("prior", "keys", "sessions", "sim") else 1])


def kept(arguments: Sequence[str]) -> tuple[str, ...]:
    """What a test runs of a command."""
    return tuple(word for word in arguments if word not in DROPPED)


@cache
def page_of() -> dict[tuple[str, ...], Path]:
    """The page on which each command of `RUN_ONCE` is run: the first that has it."""
    owners: dict[tuple[str, ...], Path] = {}
    for page in PAGES:
        for words in commands(page):
            for arguments in of_hexctl(words):
                owners.setdefault(kept(arguments), page)
    return owners


def of_hexctl(words: Sequence[str]) -> list[list[str]]:
    """The commands of hexctl in a line of a page: its own, and those of a target of make."""
    if words[0] == "make":
        return made_by(list(words[1:]))
    if list(words[:3]) == ["python", "-m", "hexctl"]:
        return [list(words[3:])]
    return [list(words[1:])] if words[0] == "hexctl" else []


def made_by(words: Sequence[str]) -> list[list[str]]:
    """The commands of hexctl that targets of make run; the targets must exist."""
    shown = subprocess.run(
        [shutil.which("make") or "make", "-n", *words],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    )
    start = ".venv/bin/hexctl "
    return [line.split()[1:] for line in shown.stdout.splitlines() if line.startswith(start)]


#: Backends of servos on a port.
ON_A_PORT = {*FAMILIES, *BOARDS, "hiwonder"}


class Shell:
    """Runs the commands of one page, one after another, in one folder."""

    def __init__(self, folder: Path, page: Path | None = None) -> None:
        self._folder, self._page = folder, page
        self._boards, self._programs, self._plugins = ExitStack(), ExitStack(), ExitStack()
        self._robot: list[str] = []  # where clients find the robot that is served
        self._board = ""  # where clients find the servo board
        self._camera = ""  # address of the rendered camera's pictures

    def __enter__(self) -> "Shell":
        return self

    def __exit__(self, *_: object) -> None:
        self._programs.close()
        self._boards.close()
        self._plugins.close()

    def do(self, words: Sequence[str]) -> None:
        """Run a command, or what stands for it."""
        handlers: dict[str, Callable[[list[str]], None]] = {
            "hexctl": self.hexctl,
            "python": self._python,
            "make": self._make,
            "cp": self._copy,
            "pip": self._pip,
            "uv": _uv,
            "sudo": _sudo,
            "sudoedit": _sudo,
            "dask": _dask,
            "ros2": _ros2,
            "rviz2": _ros2,
            "export": _export,
            "source": lambda words: _require(words == [".venv/bin/activate"]),
        }
        handlers[words[0]](list(words[1:]))

    def hexctl(self, arguments: list[str]) -> None:
        """Run `hexctl ARGUMENTS`, which must succeed."""
        parse(arguments)
        if any(set(words) <= set(arguments) for words in PARSED):
            return
        name, owner = name_of(arguments), page_of().get(kept(arguments))
        if name in RUN_ONCE and owner != (self._page or owner) and not self._board:
            return
        self._make_robot_file(arguments)
        arguments = list(kept(arguments))
        programs = {"serve": self._serve, "sim board": self._start_board, "sim camera": self._start_camera}
        if name in programs:
            programs[name](arguments)
            return
        if arguments[0] == "see" and "--camera" in arguments:
            arguments[arguments.index("--camera") + 1] = self._camera
            if arguments[1] == "--camera":
                self._look(arguments)
                return
        served = name in ("status", "estop") or "zenoh" in arguments or arguments[:2] == ["see", "latency"]
        if served:
            arguments = _replaced(arguments, [*SHORTER_SERVED.get(name, "").split(), *self._robot])
        else:
            arguments = _replaced(arguments, SHORTER.get(name, "").split())
        if "mavlink" in arguments:
            arguments = _replaced(arguments, ["--port", self._board])
        on_bus = "--port" in arguments and "mavlink" not in arguments
        if on_bus:
            arguments[arguments.index("--port") + 1] = self._board
        _stay_here(arguments)
        paced = served or on_bus or "mock" in arguments or "mavlink" in arguments
        for _ in range(3 if paced else 1):  # a machine that is too busy for 0.2 s stops a walk
            code = exit_code(arguments)
            if code != 3:
                break
            if served:  # the stop is latched
                exit_code(["estop", "--clear", *self._robot])
        assert code == 0, f"exit code {code} of hexctl {' '.join(arguments)}"

    def _make_robot_file(self, arguments: list[str]) -> None:
        """Make the robot file that a page speaks of without making it."""
        for word, after in pairwise(arguments):
            if word == "--robot" and after.startswith("./") and not (self._folder / after).exists():
                shutil.copy(ROOT / "configs" / "robots" / "phantomx.yaml", self._folder / after)

    def _serve(self, arguments: list[str]) -> None:
        """Serve a robot on loopback until the page serves another; a simulated one stands for a real one."""
        self._programs.close()
        real = ({"mavlink"} | ON_A_PORT) & set(arguments)
        if real & ON_A_PORT and self._board:
            arguments[arguments.index("--port") + 1] = self._board
        elif real:
            arguments[arguments.index(real.pop())] = "sim"
            at = arguments.index("--port")
            del arguments[at : at + 2]
        listen = arguments[arguments.index("--listen") + 1] if "--listen" in arguments else "tcp/"
        endpoint = f"{listen.partition('/')[0]}/127.0.0.1:{free_port()}"
        self._robot = ["--connect", endpoint]
        if "--keys" in arguments:
            self._robot += ["--keys", arguments[arguments.index("--keys") + 1]]
        self._start(_replaced(arguments, ["--listen", endpoint]), "serving ")

    def _start_board(self, arguments: list[str]) -> None:
        self._boards.close()
        said = self._start(arguments, "bus of " if "--bus" in arguments else "board of ", self._boards)
        found = re.search(r" at ([^\s,;]+)", said)
        assert found, said
        self._board = found[1]

    def _start_camera(self, arguments: list[str]) -> None:
        """Draw the robot that is served, at a free port."""
        if "--http-port" in arguments:
            at = arguments.index("--http-port")
            del arguments[at : at + 2]
        small = ["--size", "640x360", "--fps", "12"]  # drawn without a graphics card
        said = self._start(_replaced(arguments, [*small, *self._robot]), "camera over ")
        found = re.search(r" at (http://\S+)", said)
        assert found, said
        self._camera = found[1]

    def _look(self, arguments: list[str]) -> None:
        """Look with the rendered camera from now on, at a free port."""
        if "--page" in arguments:
            arguments[arguments.index("--page") + 1] = "0"
        self._start(_replaced(arguments, self._robot), "tag in ")

    def _start(self, arguments: list[str], ready: str, programs: ExitStack | None = None) -> str:
        """Start a program that is ended with the shell, by its id, and return what it said once ready."""
        started = program(self._folder, f"program-{free_port()}", "hexctl", *arguments, cwd=self._folder)
        running = (programs or self._programs).enter_context(started)
        running.wait_for(ready)
        return running.said()

    def _python(self, words: list[str]) -> None:
        """Run a program that the page has saved, or hexctl as a module."""
        if len(words) == 1 and (self._folder / words[0]).is_file():
            done = subprocess.run(
                [sys.executable, words[0]], cwd=self._folder, capture_output=True, text=True, check=False
            )
            assert done.returncode == 0, done.stderr
            return
        _require(words[:2] == ["-m", "hexctl"])
        self.hexctl(words[2:])

    def _make(self, words: list[str]) -> None:
        """Run what a target would run of hexctl."""
        ours = made_by(words)
        _require(bool(ours) == (words == ["demo"]))
        for arguments in ours:
            self.hexctl(arguments)

    def _pip(self, words: list[str]) -> None:
        """Install a plug-in of the repository until the end of the page, or check an extra."""
        if not words[-1].startswith("./"):
            _extras(words)
            return
        _require(words[:-1] == ["install"])
        source = shutil.copytree(ROOT / words[-1], self._folder / "plug-in")
        site = str(self._folder / "site")
        pip = ("-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", site)
        subprocess.run([sys.executable, *pip, str(source)], check=True, timeout=120)
        patch = self._plugins.enter_context(pytest.MonkeyPatch.context())
        patch.syspath_prepend(site)
        patch.setenv("PYTHONPATH", os.pathsep.join([site, os.environ.get("PYTHONPATH", "")]))
        plugins.cache_clear()
        self._plugins.callback(plugins.cache_clear)

    def _copy(self, words: list[str]) -> None:
        """Copy a file of the repository into the folder."""
        source, target = words
        shutil.copy(ROOT / source, self._folder / target)


def _replaced(arguments: list[str], options: list[str]) -> list[str]:
    """The command with these options, instead of its own values of them: each counts once."""
    names = {
        word for word, after in pairwise(options) if word.startswith("--") and not after.startswith("--")
    }
    own = [word for before, word in pairwise(["", *arguments]) if not names & {before, word}]
    return [*own, *options]


def _stay_here(arguments: list[str]) -> None:
    """Refuse to reach for the computers that the pages name as examples."""
    ends = [after for word, after in pairwise(arguments) if word in ("--connect", "--port")]
    here = [end.startswith("/dev/pts/") or "/127.0.0.1:" in end or Path(end).is_socket() for end in ends]
    assert all(here[-1:]), ends
    assert not any("://" in word and "://127.0.0.1:" not in word for word in arguments), arguments


def _require(holds: bool) -> None:
    assert holds, "no rule for this command"


def _project() -> dict[str, Any]:
    """Section `project` of pyproject.toml."""
    project: dict[str, Any] = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    return project


def _extras(words: list[str]) -> None:
    """Check that the extras exist, and that the installation stays editable."""
    command, option, target = words
    _require((command, option, target[0]) == ("install", "-e", "."))
    assert set(target[1:].strip("[]").split(",")) <= set(_project()["optional-dependencies"]), target


def _uv(words: list[str]) -> None:
    """Check the extra, and parse the command of hexctl."""
    command, option, extra, program, *arguments = words
    _require((command, option, program) == ("run", "--extra", "hexctl"))
    _extras(["install", "-e", f".[{extra}]"])
    parse(arguments)  # what it does is run by the first command of the page


def _sudo(words: list[str]) -> None:
    """Need root, so only look that the files are there and would be where the next command looks."""
    if words[0] == "cp" and "udev" in words[1]:
        assert (ROOT / words[1]).is_file()
        return
    service = "hexctl-serve"
    assert (ROOT / "configs" / "systemd" / f"{service}.service").is_file()
    assert service in words[-1] or words[:2] == ["cp", f"configs/systemd/{service}.service"]


def _ros2(words: list[str]) -> None:
    """Check that the node, topics, services and types of a command of ROS are those of a served robot."""
    from hexctl.server.ros.bridge import JOINTS_TOPIC, STOP_MESSAGE, STOP_TOPIC, TRIGGER, VELOCITIES
    from hexctl.server.ros.topics import TOPICS
    from hexctl.wire.ros.motion_commands import Service
    from hexctl.wire.ros.ros_names import RosNode

    names = (*TOPICS, "cmd_vel", JOINTS_TOPIC, STOP_TOPIC, *(f"~/{service.value}" for service in Service))
    nodes = (RosNode(), RosNode(namespace="lab/ant"))
    known = {node.resolved(name) for node in nodes for name in names} | {"/tf", "/tf_static"}
    known |= {f"/{node.full_name}" for node in nodes}
    types = {STOP_MESSAGE, TRIGGER, *VELOCITIES, *(kind for kind, _ in TOPICS.values())}
    for word in words:
        for part in word.split(":="):
            _require(not part.startswith("/") or part in known)
        _require(("/msg/" not in word and "/srv/" not in word) or word in types)


def _export(words: list[str]) -> None:
    """Variables of the ROS side."""
    _require(words[0].partition("=")[0] in ("RMW_IMPLEMENTATION", "ZENOH_CONFIG_OVERRIDE"))


def _dask(words: list[str]) -> None:
    """Parse a command of Dask as Dask does."""
    from distributed.cli import dask_scheduler, dask_worker

    command: Any = {"scheduler": dask_scheduler.main, "worker": dask_worker.main}[words[0]]
    command.make_context(f"dask {words[0]}", words[1:])
