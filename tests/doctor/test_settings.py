"""What `hexctl doctor` says of settings."""

from pathlib import Path

import pytest

from hexctl.doctor.settings import SettingFound, read_settings_found


def test_values_have_their_place_and_name_nobody(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setenv("HOME", str(tmp_path))
    monkeypatch.setenv("HEXCTL_ROBOT", f"{tmp_path}/my.yaml")
    monkeypatch.setenv("HEXCTL_RUN_SEED", "3")
    Path("hexctl.toml").write_text(
        "robot = 'ant'\nconnect = 'tls/secret.lab:7447'\n[run]\nduration = 2\n[see]\ncamera = 'http://a/b'\n"
    )
    found = {one.key: one for one in read_settings_found().values}
    assert found["robot"] == SettingFound(key="robot", value="~/my.yaml", origin="environment")
    assert found["run.duration"] == SettingFound(key="run.duration", value="2", origin="hexctl.toml")
    assert found["HEXCTL_RUN_SEED"].value == "3"
    assert found["connect"].value == found["see.camera"].value == "given"


def test_what_is_wrong_is_told_and_no_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.delenv("HEXCTL_REQUIRE_VIEWER", raising=False)  # a variable of the tests
    Path("hexctl.toml").write_text("robot = [")
    found = read_settings_found()
    assert found.values == ()
    assert found.problems[0].startswith("hexctl.toml: is not valid TOML")
