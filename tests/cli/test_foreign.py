"""Sessions, robots, settings and files of another person run no code here, and print nothing but text."""

import json
import os
import shlex
import signal
import socket
import sys
import zipfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import load_session
from hexctl.cli.main import exit_code
from hexctl.cli.render.session_summary import resume_command
from hexctl.cli.settings import CODE_OPTIONS
from hexctl.doctor.machine import read_drawing
from hexctl.errors import RobotFaultError
from hexctl.recording.live import LiveView
from hexctl.server.keeper import Keeper, KeeperSpec
from hexctl.waiting import wait_for
from hexctl.wire.description import describe, robot_name
from hexctl.wire.links import KeyMap
from tests.adapt import walking
from tests.cli.conftest import Call
from tests.cli.test_options import commands
from tests.robots import shipped
from tests.server.processes import free_port
from tests.wire.knocking import posing_as_robot

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
    # As on a terminal: click would take the colours out, and other codes with them.
    monkeypatch.setattr("click.utils.should_strip_ansi", lambda *_, **__: False)
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


WALK_BEST = "run --gait best:NAME --failed-leg 2 --backend mock --duration 0.1 --no-record"

COMMANDS = [
    "sessions list",
    "sessions list --json",
    "sessions show NAME",
    "sessions show NAME --json",
    "sessions show NAME --pareto final,speed",
    "sessions compare NAME OTHER",
    "export NAME --output session.csv",
    "view NAME",
    "sessions delete NAME --yes",
]


@pytest.mark.parametrize(
    "command", [*COMMANDS, *(pytest.param(words, marks=pytest.mark.slow) for words in (WALK_BEST, "doctor"))]
)
def test_a_foreign_session_runs_no_code(call: Call, command: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.adapt.sessions.session_viewing.open_viewer", lambda _: 0)
    every = {"optimizer": NAMED, "objective": NAMED, "backend": NAMED, "recovery": NAMED}
    name = foreign_session(monkeypatch, **every)
    other = foreign_session(monkeypatch, **every)
    words = {"NAME": name, "OTHER": other, "best:NAME": f"best:{name}"}
    call(*[words.get(word, word) for word in command.split()])


@pytest.mark.parametrize("field", ["optimizer", "objective", "backend", "recovery"])
def test_a_foreign_session_is_resumed_with_its_code_only_if_that_is_typed(
    call: Call, field: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = foreign_session(monkeypatch, **{field: NAMED})
    call("adapt --resume", name, code=2)
    Path("hexctl.toml").write_text(f'[adapt]\nresume = "{name}"\ntrust = true\n')
    call("adapt", code=2)


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
        (f'[run]\nrecovery = "{NAMED}"', "run --no-record --duration 0.1"),
        (f'[drive]\nrecovery = "{NAMED}"', "drive --page 127.0.0.1:0"),
        (f'[commands.adapt]\noptimizer = "{NAMED}"', "adapt --failed-leg 2 --budget 1"),
        (f'[adapt]\nobjective = "{NAMED}"', "adapt --failed-leg 2 --budget 1"),
        (f'[study]\noptimizers = ["random", "{NAMED}"]', "study --out report"),
        (f'[calibrate]\nbackend = "{NAMED}"', "calibrate robot.yaml"),
    ],
)
def test_settings_of_the_working_folder_name_no_code(call: Call, settings: str, command: str) -> None:
    Path("hexctl.toml").write_text(settings)
    call(command, code=2)


def test_the_users_own_settings_and_variables_may_name_code(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    Path("own.toml").write_text('backend = "tests.cli.kits:Kit"')
    monkeypatch.setenv("HEXCTL_SETTINGS", "own.toml")
    call("run --no-record --duration 0.1 --hold none")
    monkeypatch.setenv("HEXCTL_SETTINGS", "none")
    monkeypatch.setenv("HEXCTL_BACKEND", "tests.cli.kits:Kit")
    call("run --no-record --duration 0.1 --hold none")


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
def test_an_archive_with_pickled_objects_is_refused(call: Call, command: str) -> None:
    array = BytesIO()
    np.save(array, np.array([Payload()], dtype=object), allow_pickle=True)
    with zipfile.ZipFile("foreign.npz", "w") as archive:
        archive.writestr("head.npy", array.getvalue())
    call(command, code=2)


@pytest.mark.parametrize("tag", ["!!python/object/apply:os.mkdir [ran]", "!!python/name:planted.part"])
@pytest.mark.parametrize("option", ["--robot", "--world"])
def test_a_yaml_file_makes_no_objects(call: Call, option: str, tag: str) -> None:
    Path("foreign.yaml").write_text(f"name: {tag}\n")
    call("run --no-record --duration 0.1", option, "foreign.yaml", code=2)


def plant_common_modules() -> None:
    for name in ("json", "numpy", "pydantic", "rerun", "mujoco", "OpenGL"):
        Path(f"{name}.py").write_text('open("ran", "w").close()\nraise ImportError\n')


def test_the_keeper_takes_no_module_from_the_working_folder() -> None:
    plant_common_modules()
    with Keeper(KeeperSpec(backend="mock", robot="ant", port=None, sits=False)) as keeper:

        def runs() -> bool:
            status = Path(f"/proc/{keeper._process.pid}/status").read_text()
            ignored = next(line for line in status.splitlines() if line.startswith("SigIgn"))
            ready = int(ignored.split()[1], 16) & 1 << signal.SIGTERM - 1
            return keeper._process.poll() is not None or bool(ready)

        wait_for(runs, 60.0, "the keeper does not start")
        assert keeper._process.poll() is None


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


@pytest.mark.slow
def test_a_look_at_what_draws_takes_no_module_from_the_working_folder() -> None:
    plant_common_modules()
    read_drawing()


#: Clears a screen, goes back in its line, turns its letters round, looks like markup and like an argument.
HOSTILE = "x\x1b[2J\r\u202e\u2066\x9b1m[bold red][link=http://there]\0connect\0\x07y\nhexctl: cleared"

#: What a text of Rich or of hexctl's messages would be lost as.
AS_IT_IS = "[bold red][link=http://there]"


#: Calls a command, and returns its exit code and output, which must be lines of text.
Text = Callable[..., tuple[int, str]]


@pytest.fixture
def printed(capsys: pytest.CaptureFixture[str]) -> Text:
    """Call a command that must print nothing but text."""

    def called(*words: str) -> tuple[int, str]:
        code = exit_code(words)
        output = "".join(capsys.readouterr())
        assert [line for line in output.split("\n") if not line.isprintable()] == []
        assert "Traceback" not in output
        return code, output

    return called


#: What a robot says of itself in one text or one number.
PLAIN = ("robot", "backend", "host", "user", "fault", "posture", "controller", "controller_since_s")
STATUS = {
    **dict.fromkeys((*PLAIN, "endpoint", "joints"), HOSTILE),
    "stopped": f"fault: {HOSTILE}",
    "stop": {"id": HOSTILE, "since_s": HOSTILE, "by": HOSTILE, "claims": [HOSTILE], "kept": HOSTILE},
    "cleared": {"reason": HOSTILE, "by": HOSTILE, "since_s": HOSTILE},
    "simulated": {"world": HOSTILE, "failure": HOSTILE},
    "commands": {HOSTILE: 1, "accepted": HOSTILE},
    "servo_link": {HOSTILE: 3},
    "malformed": {HOSTILE: 3},
    "ros": {"router": HOSTILE, "connected": True, "trouble": HOSTILE},
    "warnings": [HOSTILE],
    "at_rest": True,
    "failures": [HOSTILE],
}


def answers() -> dict[str, Any]:
    """What the robot answers at each key."""
    told = {"stopped": HOSTILE, "stop_id": HOSTILE, "error": HOSTILE, "note": HOSTILE, "failures": [HOSTILE]}
    described = {**describe(shipped()), "status": STATUS}
    return {
        "describe": described,
        "lease": {"error": HOSTILE},
        "estop": {**STATUS, **told},
        "failure": {**STATUS, **told},
    }


@contextmanager
def rogue(said: dict[str, Any]) -> Iterator[str]:
    """Endpoint of a robot that says what it likes."""
    endpoint, keys = f"tcp/127.0.0.1:{free_port()}", KeyMap.of("ant")

    def answerer(kind: str) -> Any:
        def answer(query: Any) -> None:
            query.reply(getattr(keys, kind), json.dumps(said[kind]).encode())
            query.drop()

        return answer

    with posing_as_robot(endpoint, {}) as session:
        for kind in said:
            session.declare_queryable(getattr(keys, kind), answerer(kind))
        yield endpoint


ROBOT_COMMANDS = {
    "status": 0,
    "status --json": 0,
    "estop": 0,
    "estop --json": 0,
    "estop --clear": 3,
    "estop --clear --json": 3,
    "sim fail 5:limp": 0,
    "sim heal 5 --json": 0,
    "run --backend zenoh --no-record --duration 0.1": 3,
    "drive --backend zenoh --page 127.0.0.1:0": 3,
    "diagnose --backend zenoh": 3,
    "adapt --backend zenoh --failed-leg 2 --budget 1": 3,
    "view": 3,
}


@pytest.mark.realtime
@pytest.mark.parametrize("command", ROBOT_COMMANDS)
def test_a_rogue_robot_prints_nothing_but_text(command: str, printed: Text) -> None:
    with rogue(answers()) as endpoint:
        code, output = printed(*command.split(), "--connect", endpoint)
    assert code == ROBOT_COMMANDS[command]
    if command == "status":
        assert AS_IT_IS in "".join(output.split("\n")).replace("  ", "")


def test_a_name_of_a_robot_is_short_and_has_no_other_signs() -> None:
    assert robot_name({"robot": "ant_2.b-c"}) == "ant_2.b-c"
    for name in (HOSTILE, "", "*", "$*", "a//b", "x" * 60_000, 7, None, ["ant"]):
        with pytest.raises(RobotFaultError):
            robot_name({"robot": name})


@pytest.mark.realtime
@pytest.mark.parametrize("name", [HOSTILE, None], ids=["hostile", "none"])
@pytest.mark.parametrize("command", ["estop --clear", "view", "run --backend zenoh --no-record"])
def test_a_robot_without_a_name_that_could_be_one_is_a_fault(command: str, name: Any, printed: Text) -> None:
    said = answers()
    said["describe"]["robot"] = {**said["describe"]["robot"], "name": name}
    said["describe"]["status"] = {**STATUS, "robot": name}
    with rogue(said) as endpoint:
        code, _ = printed(*command.split(), "--connect", endpoint)
    assert code == 3


#: Commands that read a session, and those which walk with it.
READING = [command for command in COMMANDS if command.split()[0] in ("sessions", "view")]
WALKING = [WALK_BEST, "adapt --resume NAME"]


def rewritten(text: str) -> str:
    """A line of a session with hostile texts in all places that take any text."""
    return json.dumps(_hostile(json.loads(text)))


def _hostile(value: Any) -> Any:
    if isinstance(value, dict):
        free = ("recording", "stopped", "hold_caveat", "error", "objective_label", "world", "robot", "gait")
        return {
            name: HOSTILE if name in free and isinstance(part, str | None) else _hostile(part)
            for name, part in value.items()
        }
    return value


@pytest.mark.parametrize("kind", ["session", "trial", "baseline"])
@pytest.mark.parametrize(
    "command", [*READING, *(pytest.param(words, marks=pytest.mark.slow) for words in WALKING)]
)
def test_a_foreign_session_prints_nothing_but_text(
    command: str, kind: str, printed: Text, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.adapt.sessions.session_viewing.open_viewer", lambda _: 0)
    name = walking.stored_session(Path("runs"), 0.2, tripod=0.3, auto=0.4)
    path = Path("runs", name, "session.jsonl")
    lines = path.read_text().splitlines()
    hostile = [rewritten(line) if line.startswith(f'{{"{kind}"') else line for line in lines]
    assert hostile != lines
    path.write_text("\n".join(hostile) + "\n")
    words = [word.replace("NAME", name).replace("OTHER", name) for word in command.split()]
    code, _ = printed(*words)
    assert code in (0, 2, 3)


def test_names_in_a_foreign_session_are_no_markup(printed: Text, monkeypatch: pytest.MonkeyPatch) -> None:
    world = "[bold red]flat[/] :smile:"
    monkeypatch.setattr(walking, "SessionSpec", lambda **fields: SessionSpec(**fields, world=world))
    name = walking.stored_session(Path("runs"), 0.2)
    for command in (["sessions", "list"], ["sessions", "show", name]):
        code, output = printed(*command)
        assert code == 0
        assert world in output


@pytest.mark.parametrize("option", ["--robot", "--world"])
def test_a_foreign_file_prints_nothing_but_text(option: str, printed: Text) -> None:
    Path("foreign.yaml").write_text(json.dumps({"name": HOSTILE, HOSTILE: HOSTILE}))
    code, _ = printed("run", "--no-record", "--duration", "0.1", option, "foreign.yaml")
    assert code == 2


@pytest.mark.slow
def test_settings_of_another_person_print_nothing_but_text(printed: Text) -> None:
    quoted = json.dumps(HOSTILE)
    Path("hexctl.toml").write_text(f"robot = {quoted}\n{quoted} = 1\n")
    for command in ("run --no-record", "check", "doctor"):
        printed(*command.split())
