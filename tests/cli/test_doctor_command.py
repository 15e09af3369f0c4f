"""`hexctl doctor` as a user calls it."""

import json
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.main import exit_code

pytestmark = pytest.mark.slow


def test_it_says_what_there_is_and_what_works(capsys: Any) -> None:
    assert exit_code(["doctor"]) == 0
    facts, _, works = capsys.readouterr().out.partition("\nwhat works\n")
    labels = [line.split("  ")[0] for line in facts.splitlines()]
    assert labels[:4] == ["hexctl", "python", "system", "processor"]
    lines = dict(line.split("  ", 1) for line in works.splitlines())
    assert lines["simulate walks"].strip() == "yes"
    assert all(line.strip() == "yes" or line.strip().startswith("NO: ") for line in lines.values())


def test_json_is_one_object(capsys: Any) -> None:
    assert exit_code(["doctor", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["works"]["simulate walks"] is None


def test_it_says_which_settings_are_in_force_and_what_is_wrong(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hexctl.toml").write_text("robot = 'pexod'\nconnect = 'tls/secret.lab:7447'\n[run]\nduraton = 3\n")
    assert exit_code(["doctor"]) == 0
    printed = capsys.readouterr()
    row = next(line for line in printed.out.splitlines() if line.startswith("settings "))
    assert row.split(maxsplit=1)[1] == "hexctl.toml: robot = pexod, connect = given, run.duraton = 3"
    assert "secret.lab" not in printed.out + printed.err
    assert printed.err.startswith("hexctl: hexctl.toml: run.duraton: unknown option; ")


def test_variables_that_no_command_has_are_unknown(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: Any
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("HEXCTL_OTHERS", "HEXCTL_PRIOR_BUILD_WORLDS", "HEXCTL_RUN_DURATON"):
        monkeypatch.setenv(name, "3")
    assert exit_code(["doctor", "--json"]) == 0
    settings = json.loads(capsys.readouterr().out)["settings"]
    assert "HEXCTL_PRIOR_BUILD_WORLDS" in {one["key"] for one in settings["values"]}
    assert {"HEXCTL_OTHERS", "HEXCTL_RUN_DURATON"} <= {*settings["unknown"]}
    assert exit_code(["doctor"]) == 0
    row = next(line for line in capsys.readouterr().out.splitlines() if line.startswith("unknown variables "))
    assert "HEXCTL_OTHERS" in row
    assert "HEXCTL_PRIOR_BUILD_WORLDS" not in row
