"""What `hexctl doctor` says of settings."""

from pathlib import Path

import pytest

from hexctl.doctor.settings_check import SettingFound, read_settings_found


def test_values_have_their_place_and_name_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("HEXCTL_ROBOT", f"{tmp_path}/my.yaml")
    monkeypatch.setenv("HEXCTL_RUN_SEED", "3")
    Path("hexctl.toml").write_text(
        "robot = 'ant'\nconnect = 'tls/secret.lab:7447'\n[run]\nduration = 2\n[see]\ncamera = 'http://a/b'\n"
    )
    found = {one.key: one for one in read_settings_found("HEXCTL_RUN_SEED".__eq__).values}
    assert found["robot"] == SettingFound(key="robot", value="~/my.yaml", origin="environment")
    assert found["run.duration"] == SettingFound(key="run.duration", value="2", origin="hexctl.toml")
    assert found["HEXCTL_RUN_SEED"].value == "3"
    assert found["connect"].value == found["see.camera"].value == "given"


def test_what_is_wrong_is_told_and_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    Path("hexctl.toml").write_text("robot = [")
    found = read_settings_found()
    assert found.values == ()
    assert found.problems[0].startswith("hexctl.toml: is not valid TOML")


def test_variables_that_are_no_setting_are_named_and_not_in_force(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    for name in ("HEXCTL_RUN_SEED", "HEXCTL_OTHERS", "HEXCTL_WORLD"):
        monkeypatch.setenv(name, "3")
    monkeypatch.setenv("HEXCTL_EMPTY", "")
    found = read_settings_found("HEXCTL_RUN_SEED".__eq__)
    assert {"world", "HEXCTL_RUN_SEED"} <= {one.key for one in found.values}
    assert "HEXCTL_OTHERS" in found.unknown
    assert not {"HEXCTL_RUN_SEED", "HEXCTL_WORLD", "HEXCTL_EMPTY"} & {*found.unknown}
    assert "HEXCTL_RUN_SEED" in read_settings_found().unknown  # without the command line
