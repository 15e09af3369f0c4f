"""Texts of robots, clients, sessions and files of another person print nothing but text."""

import json
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.cli.main import exit_code
from hexctl.wire.description import describe
from hexctl.wire.links import KeyMap
from tests.adapt import walking
from tests.robots import shipped
from tests.server.processes import free_port
from tests.wire.knocking import posing_as_robot

#: Clears a screen, goes back in its line, turns its letters round, looks like markup and like an argument.
HOSTILE = "x\x1b[2J\r\u202e\u2066\x9b1m[bold red][link=http://there]\0connect\0\x07y\nhexctl: cleared"

#: What a text of Rich or of hexctl's messages would be lost as.
AS_IT_IS = "[bold red][link=http://there]"


@pytest.fixture(autouse=True)
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    # As on a terminal: click would take the colours out, and other codes with them.
    monkeypatch.setattr("click.utils.should_strip_ansi", lambda *_, **__: False)
    return tmp_path


def printed(words: list[str], capsys: pytest.CaptureFixture[str]) -> tuple[int, str]:
    """Exit code and output of a command, which must be lines of text."""
    code = exit_code(words)
    output = "".join(capsys.readouterr())
    assert [line for line in output.split("\n") if not line.isprintable()] == []
    assert "Traceback" not in output
    return code, output


STATUS = {
    "robot": HOSTILE,
    "backend": HOSTILE,
    "host": HOSTILE,
    "user": HOSTILE,
    "stopped": f"fault: {HOSTILE}",
    "fault": HOSTILE,
    "posture": HOSTILE,
    "controller": HOSTILE,
    "controller_since_s": HOSTILE,
    "stop": {"id": HOSTILE, "since_s": HOSTILE, "by": HOSTILE, "claims": [HOSTILE], "kept": HOSTILE},
    "cleared": {"reason": HOSTILE, "by": HOSTILE, "since_s": HOSTILE},
    "simulated": {"world": HOSTILE, "failure": HOSTILE},
    "commands": {HOSTILE: 1, "accepted": HOSTILE},
    "servo_link": {HOSTILE: 3},
    "malformed": {HOSTILE: 3},
    "ros": {"router": HOSTILE, "connected": True, "trouble": HOSTILE},
    "endpoint": HOSTILE,
    "warnings": [HOSTILE],
    "at_rest": True,
    "joints": HOSTILE,
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
def test_a_rogue_robot_prints_nothing_but_text(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    with rogue(answers()) as endpoint:
        code, output = printed([*command.split(), "--connect", endpoint], capsys)
    assert code == ROBOT_COMMANDS[command]
    if command == "status":
        assert AS_IT_IS in "".join(output.split("\n")).replace("  ", "")


@pytest.mark.realtime
@pytest.mark.parametrize("name", [HOSTILE, "", "*", "a//b", "$*", "x" * 60_000, 7, None, ["ant"]])
@pytest.mark.parametrize("command", ["estop --clear", "view", "run --backend zenoh --no-record"])
def test_a_robot_without_a_name_that_could_be_one_is_a_fault(
    name: Any, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    said = answers()
    said["describe"]["robot"] = {**said["describe"]["robot"], "name": name}
    said["describe"]["status"] = {**STATUS, "robot": name}
    with rogue(said) as endpoint:
        code, _ = printed([*command.split(), "--connect", endpoint], capsys)
    assert code == 3


SESSION_COMMANDS = [
    "sessions list",
    "sessions list --json",
    "sessions show NAME",
    "sessions show NAME --json",
    "sessions show NAME --pareto final,speed",
    "sessions compare NAME NAME",
    "sessions export NAME trials.csv",
    "view NAME",
    "run --failed-leg 2 --backend mock --duration 0.1 --no-record --gait best:NAME",
    "adapt --resume NAME",
]


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
@pytest.mark.parametrize("command", SESSION_COMMANDS)
def test_a_foreign_session_prints_nothing_but_text(
    command: str, kind: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.adapt.sessions.session_viewing.open_viewer", lambda _: 0)
    name = walking.stored_session(Path("runs"), 0.2, tripod=0.3, auto=0.4)
    path = Path("runs", name, "session.jsonl")
    lines = path.read_text().splitlines()
    hostile = [rewritten(line) if line.startswith(f'{{"{kind}"') else line for line in lines]
    assert hostile != lines
    path.write_text("\n".join(hostile) + "\n")
    code, _ = printed([word.replace("NAME", name) for word in command.split()], capsys)
    assert code in (0, 2, 3)


def test_names_in_a_foreign_session_are_no_markup(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    world = "[bold red]flat[/] :smile:"
    monkeypatch.setattr(walking, "SessionSpec", lambda **fields: SessionSpec(**fields, world=world))
    name = walking.stored_session(Path("runs"), 0.2)
    for command in (["sessions", "list"], ["sessions", "show", name]):
        code, output = printed(command, capsys)
        assert code == 0
        assert world in output


@pytest.mark.parametrize("option", ["--robot", "--world"])
def test_a_foreign_file_prints_nothing_but_text(option: str, capsys: pytest.CaptureFixture[str]) -> None:
    Path("foreign.yaml").write_text(json.dumps({"name": HOSTILE, HOSTILE: HOSTILE}))
    code, _ = printed(["run", "--no-record", "--duration", "0.1", option, "foreign.yaml"], capsys)
    assert code == 2


def test_settings_of_another_person_print_nothing_but_text(capsys: pytest.CaptureFixture[str]) -> None:
    quoted = json.dumps(HOSTILE)
    Path("hexctl.toml").write_text(f"robot = {quoted}\n{quoted} = 1\n")
    for command in ("run --no-record", "check", "doctor"):
        printed(command.split(), capsys)
