"""Sessions, stores, settings, robots and archives of another person run no code on this computer."""

import os
import shlex
import signal
import socket
import sys
import zipfile
from collections.abc import Iterator
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import load_session
from hexctl.cli.main import exit_code
from hexctl.cli.render.adapt_output import resume_command
from hexctl.cli.settings import CODE_OPTIONS
from hexctl.doctor.rendering_check import read_drawing
from hexctl.recording.live import LiveView
from hexctl.server.keeper import Keeper, KeeperSpec
from hexctl.waiting import wait_for
from tests.adapt import walking
from tests.cli.test_options import commands

#: Leaves a mark when it is imported.
PLANTED = """
open("ran", "w").close()
def part(*arguments, **options): raise ValueError
"""

NAMED = "planted:part"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """The working folder, with a module that must not be imported."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", [*sys.path])
    (tmp_path / "planted.py").write_text(PLANTED)
    sys.modules.pop("planted", None)
    yield tmp_path
    sys.modules.pop("planted", None)
    assert not (tmp_path / "ran").exists()


def foreign_session(monkeypatch: pytest.MonkeyPatch, **named: Any) -> str:
    """Name of a session with a trial, whose spec names the module."""
    with monkeypatch.context() as patched:
        patched.setattr(walking, "SessionSpec", lambda **fields: replace(SessionSpec(**fields), **named))
        return walking.stored_session(Path("runs"), 0.2, tripod=0.3, auto=0.4)


COMMANDS = [
    "sessions list",
    "sessions list --json",
    "sessions show NAME",
    "sessions show NAME --json",
    "sessions show NAME --pareto final,speed",
    "sessions compare NAME OTHER",
    "sessions export NAME trials.csv",
    "export NAME --output session.csv",
    "view NAME",
    "run --gait best:NAME --failed-leg 2 --backend mock --duration 0.1 --no-record",
    "doctor",
    "sessions delete NAME --yes",
]


@pytest.mark.parametrize("command", COMMANDS)
def test_a_foreign_session_runs_no_code(command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.adapt.sessions.session_viewing.open_viewer", lambda _: 0)
    every = {"optimizer": NAMED, "objective": NAMED, "backend": NAMED, "policy": NAMED}
    name = foreign_session(monkeypatch, **every)
    other = foreign_session(monkeypatch, **every)
    words = {"NAME": name, "OTHER": other, "best:NAME": f"best:{name}"}
    assert exit_code([words.get(word, word) for word in command.split()]) == 0


@pytest.mark.parametrize("field", ["optimizer", "objective", "backend", "policy"])
def test_a_foreign_session_is_resumed_with_its_code_only_if_that_is_typed(
    field: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = foreign_session(monkeypatch, **{field: NAMED})
    assert exit_code(["adapt", "--resume", name]) == 2
    Path("hexctl.toml").write_text(f'[adapt]\nresume = "{name}"\ntrust = true\n')
    assert exit_code(["adapt"]) == 2


def test_commands_that_are_shown_for_a_foreign_session_are_safe_to_paste(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    session = load_session(foreign_session(monkeypatch), "runs")
    renamed = replace(session, name="x;touch ran")
    assert shlex.split(resume_command(renamed)) == ["hexctl", "adapt", "--resume", "x;touch ran"]


@pytest.mark.parametrize(
    ("settings", "command"),
    [
        (f'backend = "{NAMED}"', "run --no-record --duration 0.1"),
        (f'backend = "{NAMED}"', "serve --listen tcp/127.0.0.1:0"),
        (f'[run]\npolicy = "{NAMED}"', "run --no-record --duration 0.1"),
        (f'[drive]\npolicy = "{NAMED}"', "drive --page 127.0.0.1:0"),
        (f'[commands.adapt]\noptimizer = "{NAMED}"', "adapt --failed-leg 2 --budget 1"),
        (f'[adapt]\nobjective = "{NAMED}"', "adapt --failed-leg 2 --budget 1"),
        (f'[study]\noptimizers = ["random", "{NAMED}"]', "study --out report"),
        (f'[calibrate]\nbackend = "{NAMED}"', "calibrate robot.yaml"),
    ],
)
def test_settings_of_the_working_folder_name_no_code(settings: str, command: str) -> None:
    Path("hexctl.toml").write_text(settings)
    assert exit_code(command.split()) == 2


def test_the_users_own_settings_and_variables_may_name_code(monkeypatch: pytest.MonkeyPatch) -> None:
    Path("own.toml").write_text('backend = "tests.cli.kits:Kit"')
    monkeypatch.setenv("HEXCTL_SETTINGS", "own.toml")
    assert exit_code(["run", "--no-record", "--duration", "0.1", "--hold", "none"]) == 0
    monkeypatch.setenv("HEXCTL_SETTINGS", "none")
    monkeypatch.setenv("HEXCTL_BACKEND", "tests.cli.kits:Kit")
    assert exit_code(["run", "--no-record", "--duration", "0.1", "--hold", "none"]) == 0


def test_each_option_that_takes_code_is_known_as_one() -> None:
    takes_code = {
        param.name
        for _, command in commands()
        for param in command.params
        if "package.module" in (getattr(param, "help", None) or "")
    }
    assert takes_code <= set(CODE_OPTIONS)


class Payload:
    """Leaves a mark when it is unpickled."""

    def __reduce__(self) -> tuple[Any, tuple[str]]:
        return os.mkdir, ("ran",)


@pytest.mark.parametrize(
    "command", ["prior show ./foreign.npz", "adapt --failed-leg 5 --budget 1 --prior ./foreign.npz"]
)
def test_an_archive_with_pickled_objects_is_refused(command: str) -> None:
    array = BytesIO()
    np.save(array, np.array([Payload()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile("foreign.npz", "w") as archive:
        archive.writestr("head.npy", array.getvalue())
    assert exit_code(command.split()) == 2


@pytest.mark.parametrize("tag", ["!!python/object/apply:os.mkdir [ran]", "!!python/name:planted.part"])
@pytest.mark.parametrize("option", ["--robot", "--world"])
def test_a_yaml_file_makes_no_objects(option: str, tag: str) -> None:
    Path("foreign.yaml").write_text(f"name: {tag}\n")
    assert exit_code(["run", "--no-record", "--duration", "0.1", option, "foreign.yaml"]) == 2


def plant_common_modules() -> None:
    for name in ("json", "numpy", "pydantic", "rerun", "mujoco", "OpenGL"):
        Path(f"{name}.py").write_text('open("ran", "w").close()\nraise ImportError\n')


def test_the_keeper_takes_no_module_from_the_working_folder() -> None:
    plant_common_modules()
    keeper = Keeper(KeeperSpec(backend="mock", robot="ant", connect=None, sits=False))
    try:

        def runs() -> bool:
            status = Path(f"/proc/{keeper._process.pid}/status").read_text()
            ignored = next(line for line in status.splitlines() if line.startswith("SigIgn"))
            ready = int(ignored.split()[1], 16) & 1 << signal.SIGTERM - 1
            return keeper._process.poll() is not None or bool(ready)

        wait_for(runs, 60.0, "the keeper does not start")
        assert keeper._process.poll() is None
    finally:
        keeper.dismiss()


def test_the_live_view_takes_no_module_from_the_working_folder(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plant_common_modules()
    viewer = folder / "viewer"
    viewer.write_text("#!/bin/sh\nexec sleep 60\n")
    viewer.chmod(0o700)
    monkeypatch.setattr("hexctl.recording.live.viewer_binary", lambda: viewer)
    with socket.create_server(("127.0.0.1", 0)) as listening:
        monkeypatch.setattr("hexctl.recording.live.free_port", lambda: listening.getsockname()[1])
        live = LiveView()
        assert live._feeder.stdin is not None
        live._feeder.stdin.close()
        ended = live._feeder.wait(60.0)
        live._viewer.kill()
        live._viewer.wait()
    assert ended == 0


def test_a_look_at_what_draws_takes_no_module_from_the_working_folder() -> None:
    plant_common_modules()
    read_drawing()
