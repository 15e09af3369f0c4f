"""`hexctl demo` as a user calls it."""

import json
import sys
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.console import StopOnInterrupt
from hexctl.cli.main import exit_code
from hexctl.cli.walk.demo import _activate
from hexctl.demo import rescue


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("DISPLAY", raising=False)
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)


def test_it_says_what_happens_and_what_to_do_next(tmp_path: Path, capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr("hexctl.cli.walk.demo.shutil.which", lambda _: "/bin/hexctl")
    assert exit_code(["demo", "--budget", "1"]) == 0
    printed = capsys.readouterr()
    lines = printed.out.splitlines()
    assert lines[0].startswith("Leg 5 of ant is locked 6.3 s into a walk of 15 s")
    assert "without recovery" in lines[1]
    assert "with recovery" in lines[2]
    assert "glided to slots" in lines[2]
    assert "hexctl adapt --failed-leg 5 --budget 1 --world transfer:501" in lines
    assert any(line.startswith("ended: ") for line in lines)
    following = lines[lines.index("next:") + 1 :]
    assert [line.split()[:2] for line in following] == [
        ["hexctl", "view"],
        ["hexctl", "run"],
        ["hexctl", "check"],
    ]
    for word in following[0].split()[3:-1]:
        assert (tmp_path / word).is_file()
    assert "finds no display; hexctl view --web" in printed.err


def test_json_is_the_result_alone(capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(rescue, "WALK_S", 7.0)
    assert exit_code(["demo", "--budget", "1", "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["adaptation"]["budget"] == 1
    assert Path(told["walked_on"]["recording"]).is_file()


def test_ctrl_c_ends_it(capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(StopOnInterrupt, "requested", lambda _: True)
    assert exit_code(["demo"]) == 130
    assert "with recovery" not in capsys.readouterr().out


def test_ctrl_c_in_the_search_names_the_session(capsys: Any, monkeypatch: Any) -> None:
    monkeypatch.setattr(rescue, "WALK_S", 7.0)
    monkeypatch.setattr(StopOnInterrupt, "requested", lambda _: any(Path("runs").glob("*-leg5-*")))
    assert exit_code(["demo", "--budget", "1"]) == 130
    (session,) = Path("runs").glob("*-leg5-*")
    said = f"hexctl: interrupted; continue the search with: hexctl adapt --resume {session.name}; "
    assert capsys.readouterr().err.splitlines()[-1].startswith(said)


def test_a_folder_that_cannot_be_used_is_one_line(tmp_path: Path, capsys: Any) -> None:
    (tmp_path / "runs").touch()
    assert exit_code(["demo", "--budget", "1"]) == 2
    assert "runs" in capsys.readouterr().err


def test_the_environment_is_named_where_the_command_is_not_on_the_path(monkeypatch: Any) -> None:
    monkeypatch.setattr("hexctl.cli.walk.demo.shutil.which", lambda _: None)
    script = Path(sys.executable).with_name("activate")
    said = _activate()
    assert (said is None) is not script.is_file()
