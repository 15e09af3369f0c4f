"""What `hexctl estop` prints, and when it does not print."""

import fcntl
import os
from contextlib import suppress
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import pytest

from hexctl.cli.interrupts import NOT_CONFIRMED
from hexctl.cli.main import exit_code
from hexctl.cli.network import estop_command
from hexctl.client.stop_client import ReadyStop, StopResult
from hexctl.errors import InputError, RobotFaultError, argument
from hexctl.wire.links import load_link
from tests.server.processes import free_port


class StoppedRobot:
    """In place of a robot: it rests, and has kept the stop or not."""

    kept, echoed = True, False

    def __init__(self, *, again: bool, connect: str | None, link: str | None, **given: Any) -> None:
        self.link = load_link(link, endpoint=connect, **given)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def wait_for_rest(self, *, identity_s: float = 0.0) -> StopResult:
        """Result of a stop by datagram."""
        return StopResult(
            stopped="estop",
            stop_id="0011223344556677",
            at_rest=True,
            kept=self.kept,
            robot="ant",
            ways=("datagram",),
            took_s=0.01,
            rested_s=0.3,
            answers=(),
            echoed=self.echoed,
        )


@pytest.mark.parametrize("kept", [True, False])
def test_a_stop_that_a_restart_would_end_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], kept: bool
) -> None:
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "kept", kept)
    assert exit_code(["estop"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("stopped (estop), at rest;")
    assert ("a restart of hexctl serve ends it" in printed.err) is not kept


@pytest.mark.parametrize(
    ("error", "words", "code"),
    [
        (RobotFaultError("no robot answers here"), "no robot answers here. ", 3),
        (RobotFaultError("does it hang?"), "does it hang? ", 3),
        (InputError(f"{argument('credentials')}: is for 'viewer'"), "--keys: is for 'viewer'. ", 2),
        (KeyboardInterrupt(), "interrupted. ", 130),
    ],
)
def test_a_stop_that_failed_ends_with_what_the_operator_has_to_do(
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    error: BaseException,
    words: str,
    code: int,
) -> None:
    def fail(_: object, **__: object) -> None:
        raise error

    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "wait_for_rest", fail)
    assert exit_code(["estop"]) == code
    assert capsys.readouterr().err == f"hexctl: {words}{NOT_CONFIRMED}\n"


def test_a_ready_stop_that_ctrl_c_ends_says_that_it_has_stopped_nothing(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def interrupt(_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(estop_command, "_wait_for_a_press", interrupt)
    assert exit_code(["estop", "--ready"]) == 130
    assert capsys.readouterr().err == f"hexctl: ended, which is no stop. {NOT_CONFIRMED}\n"


def test_the_command_that_clears_it_leads_to_the_same_robot(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    assert exit_code(["estop", "--connect", "tls/ant.local:7448", "--keys", "my keys"]) == 0
    command = "hexctl estop --clear --connect tls/ant.local:7448 --keys 'my keys' when"
    assert command in capsys.readouterr().out


def test_servos_that_report_no_angles_are_not_said_to_be_at_rest(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "echoed", True)
    assert exit_code(["estop"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("stopped (estop), its targets no longer change (its servos do not report")
    assert "at rest" not in printed.out + printed.err


def test_a_link_file_that_has_gone_meanwhile_is_no_error_of_a_stop(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("endpoint: tcp/127.0.0.1:7448\n", encoding="utf-8")
    result = StoppedRobot.wait_for_rest

    def remove(robot: StoppedRobot, **_: object) -> StopResult:
        file.unlink()
        return result(robot)

    monkeypatch.setattr("hexctl.client.stop_client.ReadyStop", StoppedRobot)
    monkeypatch.setattr(StoppedRobot, "wait_for_rest", remove)
    assert exit_code(["estop", "--link", str(file)]) == 0
    assert "hexctl estop --clear --connect tcp/127.0.0.1:7448 when" in capsys.readouterr().out


def test_that_nothing_listens_is_said_while_the_robot_is_still_tried(
    capsys: pytest.CaptureFixture[str],
) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert exit_code(["estop", "--connect", endpoint]) == 3
    early, last = capsys.readouterr().err.splitlines()
    assert early.startswith(f"hexctl: nothing listens at {endpoint}; trying for some seconds more")
    assert last.startswith(f"hexctl: nothing listens at {endpoint}; is hexctl serve running there?")
    assert early.endswith(NOT_CONFIRMED)
    assert last.endswith(NOT_CONFIRMED)


@pytest.mark.parametrize("command", ["status", "view"])
def test_others_say_it_too(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    assert exit_code([command, "--connect", endpoint]) == 3
    early, _ = capsys.readouterr().err.splitlines()
    assert early == f"hexctl: nothing listens at {endpoint}; trying for some seconds more"


def test_the_link_of_a_stop_is_that_of_its_file(tmp_path: Path) -> None:
    file = tmp_path / "lab.yaml"
    file.write_text("endpoint: tcp/127.0.0.1:7448\n", encoding="utf-8")
    ready = ReadyStop(link=str(file))
    file.unlink()
    assert ready.link.clear_command == "hexctl estop --clear --connect tcp/127.0.0.1:7448"


def test_what_stops_is_what_there_is_now() -> None:
    assert estop_command._what_stops(keys=True, gamepads=0) == "any key stops it"
    assert estop_command._what_stops(keys=True, gamepads=1) == "any key or any button of a gamepad stops it"
    assert estop_command._what_stops(keys=False, gamepads=2) == "any button of a gamepad stops it"
    assert "NOTHING HERE STOPS IT" in estop_command._what_stops(keys=False, gamepads=0)


def test_nothing_is_printed_where_it_would_wait(monkeypatch: pytest.MonkeyPatch) -> None:
    read, write = os.pipe()
    with os.fdopen(read, "rb"), os.fdopen(write, "w") as stream:
        monkeypatch.setattr("sys.stderr", stream)
        assert estop_command._takes_text()
        fcntl.fcntl(write, fcntl.F_SETFL, os.O_NONBLOCK)
        with suppress(BlockingIOError):
            while True:
                os.write(write, bytes(4096))
        assert not estop_command._takes_text()
        os.read(read, 1 << 20)
        assert estop_command._takes_text()
