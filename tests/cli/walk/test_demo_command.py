"""`hexctl demo` as a user calls it."""

import errno
import json
import os
import sys
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.sessions.store import stored_names
from hexctl.cli.console import StopOnInterrupt
from hexctl.cli.main import exit_code
from hexctl.cli.walk.demo_command import _activate, _another_walk, _view_command
from hexctl.demo import rescue


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


@pytest.mark.slow
def test_it_says_what_happens_and_what_to_do_next(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("hexctl.cli.walk.demo_command.shutil.which", lambda _: "/bin/hexctl")
    assert exit_code(["demo", "--budget", "1"]) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert len(lines) <= 20
    assert rescue.WORLD in lines[0]
    (without,) = (line for line in lines if "without recovery" in line)
    (recovered,) = (line for line in lines if " with recovery" in line)
    assert lines.index(without) < lines.index(recovered)
    assert "leg 5 detected at 6." in lines[lines.index(recovered) + 1]
    command = printed.out.replace("\\\n", " ").split("hexctl adapt ")[1].splitlines()[0].split()
    assert command[command.index("--failed-leg") + 1] == "5"
    assert command[command.index("--world") + 1] == rescue.WORLD
    following = [line.split() for line in lines[lines.index("next:") + 1 :]]
    assert [line[:2] for line in following] == [["hexctl", "view"], ["hexctl", "sessions"], ["hexctl", "run"]]
    assert "--view" not in following[-1]  # there is no screen
    assert (tmp_path / following[0][-1]).is_file()
    assert "display" not in printed.err


@pytest.mark.long
def test_json_is_the_result_alone(capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(rescue, "WALK_S", 7.0)
    assert exit_code(["demo", "--budget", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["adaptation"]["budget"] == 1
    assert Path(told["walked_on"]["recording"]).is_file()


@pytest.mark.slow
def test_ctrl_c_ends_it(capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(StopOnInterrupt, "requested", lambda _: True)
    assert exit_code(["demo"]) == 130
    printed = capsys.readouterr()
    assert "with recovery" not in printed.out
    assert printed.err.splitlines()[-1] == "hexctl: interrupted before the search: nothing was recorded"
    assert not list(Path("runs").iterdir())


@pytest.mark.slow
def test_with_a_screen_the_walks_are_shown_in_a_window(monkeypatch: Any) -> None:
    monkeypatch.setenv("DISPLAY", ":0")
    assert _view_command() == "hexctl view"
    assert _another_walk() == ["  hexctl run --failure 2:limp@4 --realtime --view"]


@pytest.mark.slow
def test_ctrl_c_in_the_search_names_the_session(capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(rescue, "WALK_S", 7.0)
    monkeypatch.setattr(StopOnInterrupt, "requested", lambda _: any(Path("runs").glob("*-leg5-*")))
    assert exit_code(["demo", "--budget", "1"]) == 130
    (session,) = stored_names(Path("runs"))
    said = f"hexctl: interrupted; continue the search with: hexctl adapt --resume {session}; "
    line = capsys.readouterr().err.splitlines()[-1]
    assert line.startswith(said)
    seen = line.partition("; look at it with: hexctl view --web ")[2].split()
    assert [Path(path).name for path in seen if Path(path).is_file()] == ["walked-on.rrd", "recovered.rrd"]


@pytest.mark.slow
def test_two_ctrl_c_name_what_is_there(capsys: Any, monkeypatch: Any) -> None:
    def cut_off(policy: str, recording: Path, **_: Any) -> None:
        if policy == rescue.RECOVER:
            raise KeyboardInterrupt
        recording.touch()

    monkeypatch.setattr(rescue, "walk_and_fail", cut_off)
    monkeypatch.setattr("hexctl.cli.walk.demo_command._walk_line", lambda *_, **__: "")
    assert exit_code(["demo"]) == 130
    (folder,) = Path("runs").iterdir()
    assert f"{folder}/" in capsys.readouterr().err
    monkeypatch.setattr(rescue, "WALK_ON", rescue.RECOVER)
    (folder / "walked-on.rrd").unlink()
    folder.rmdir()
    assert exit_code(["demo"]) == 130
    assert "runs" not in capsys.readouterr().err
    assert not list(Path("runs").iterdir())


@pytest.mark.slow
def test_a_disk_without_room_is_a_fault_that_names_no_option_of_other_commands(
    capsys: Any, monkeypatch: Any
) -> None:
    def refuse(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr("hexctl.recording.rrd.os.posix_fallocate", refuse)
    assert exit_code(["demo"]) == 3
    assert "--" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_that_cannot_be_used_is_one_line(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "runs").touch()
    assert exit_code(["demo", "--budget", "1"]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    for word in ("runs is a file, not a folder", "HEXCTL_RUNS"):
        assert word in printed.err


@pytest.mark.slow
def test_the_environment_is_named_where_the_command_is_not_on_the_path(monkeypatch: Any) -> None:
    monkeypatch.setattr("hexctl.cli.walk.demo_command.shutil.which", lambda _: None)
    script = Path(sys.executable).with_name("activate")
    said = _activate()
    assert (said is None) is not script.is_file()
