"""Settings: which files and variables are found, what they say, and what is wrong with them."""

from pathlib import Path

import pytest

import hexctl
from hexctl.settings import find_settings, settings_files


@pytest.fixture(autouse=True)
def _here(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    home = tmp_path / "home"
    (home / "project" / "deep").mkdir(parents=True)
    monkeypatch.setenv("HOME", str(home))
    monkeypatch.setenv("XDG_CONFIG_HOME", str(tmp_path / "config"))
    monkeypatch.chdir(home / "project")


def users(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "config" / "hexctl" / "hexctl.toml"
    path.parent.mkdir(parents=True)
    path.write_text(text)
    return path


def test_without_files_and_variables_nothing_is_said() -> None:
    settings = hexctl.read_settings()
    assert settings.values == {}
    assert settings.runs == Path("runs")
    assert settings.of("run") == {}


def test_variables_come_before_the_folders_file_and_that_before_the_users(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    users(tmp_path, 'robot = "pexod"\nworld = "rough"\nbackend = "mock"\n[run]\nduration = 5\nseed = 1\n')
    Path("hexctl.toml").write_text('robot = "phantomx"\nbackend = "sim"\n[run]\nduration = 7\n')
    monkeypatch.setenv("HEXCTL_ROBOT", "ant")
    monkeypatch.setenv("HEXCTL_WORLD", "")  # empty is not said
    settings = hexctl.read_settings()
    assert settings.values == {"robot": "ant", "backend": "sim", "world": "rough"}
    assert settings.origins["robot"] == "HEXCTL_ROBOT"
    assert settings.origins["backend"] == "hexctl.toml: backend"
    assert settings.of("run") == {"duration": 7, "seed": 1}


def test_the_nearest_file_above_counts_up_to_the_home_folder(tmp_path: Path) -> None:
    home = tmp_path / "home"
    (tmp_path / "hexctl.toml").write_text("")
    assert settings_files(home / "project" / "deep") == ()
    (home / "hexctl.toml").write_text("")
    assert settings_files(home / "project" / "deep") == (home / "hexctl.toml",)
    (home / "project" / "hexctl.toml").write_text("")
    assert settings_files(home / "project" / "deep") == (home / "project" / "hexctl.toml",)


def test_a_repository_is_a_world_of_its_own(tmp_path: Path) -> None:
    (tmp_path / "home" / "hexctl.toml").write_text("")
    (tmp_path / "home" / "project" / ".git").mkdir()
    assert settings_files(tmp_path / "home" / "project" / "deep") == ()


def test_outside_of_home_and_repositories_only_the_folder_itself_counts(tmp_path: Path) -> None:
    shared = tmp_path / "shared"
    (shared / "mine").mkdir(parents=True)
    (shared / "hexctl.toml").write_text("")
    assert settings_files(shared / "mine") == ()
    assert settings_files(shared) == (shared / "hexctl.toml",)


def test_a_variable_names_the_only_file_or_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    Path("hexctl.toml").write_text('robot = "pexod"')
    monkeypatch.setenv("HEXCTL_SETTINGS", "none")
    assert hexctl.read_settings().values == {}
    other = tmp_path / "other.toml"
    other.write_text('robot = "lukas"')
    monkeypatch.setenv("HEXCTL_SETTINGS", str(other))
    assert hexctl.read_settings().values == {"robot": "lukas"}
    monkeypatch.setenv("HEXCTL_SETTINGS", str(tmp_path / "gone.toml"))
    with pytest.raises(hexctl.InputError, match=r"gone\.toml: cannot be read: No such file"):
        hexctl.read_settings()
    monkeypatch.setenv("HEXCTL_SETTINGS", "~nobody-of-this-name/mine.toml")
    with pytest.raises(hexctl.InputError, match=r"mine\.toml: cannot be read: No such file"):
        hexctl.read_settings()


@pytest.mark.parametrize(
    ("content", "line"),
    [
        (b"robot = [", r"^hexctl\.toml: is not valid TOML: Invalid value"),
        (b"\xff\xfe", r"^hexctl\.toml: cannot be read as text"),
        (b"robot = 3", r"^hexctl\.toml: robot: got 3; allowed: text, a shipped name or a robot file$"),
        (b'robot = ""', r"^hexctl\.toml: robot: got ''; allowed: text"),
        (b'runs = "a\\u0000b"', r"^hexctl\.toml: runs: got 'a.x00b'; allowed: text without null"),
        (b"run.a-b = 1\nrun.a_b = 2", r"^hexctl\.toml: run\.a-b: is given twice"),
        (b"x = 1\n" * 200_000, r"^hexctl\.toml: cannot be read: it is larger than 0\.1 MB"),
        (b"a." * 3000 + b"b = 1", r"^hexctl\.toml: is not valid TOML"),
        (b"x = " + b"[" * 5000, r"^hexctl\.toml: is not valid TOML"),
    ],
)
def test_a_damaged_file_is_one_line(content: bytes, line: str) -> None:
    Path("hexctl.toml").write_bytes(content)
    with pytest.raises(hexctl.InputError, match=line) as caught:
        hexctl.read_settings()
    assert len(str(caught.value).splitlines()) == 1
    assert find_settings().problems == (str(caught.value),)


def test_a_file_that_is_a_folder_or_leads_nowhere_is_one_line() -> None:
    Path("hexctl.toml").symlink_to("nowhere")
    with pytest.raises(hexctl.InputError, match=r"^hexctl\.toml: cannot be read: No such file"):
        hexctl.read_settings()
    Path("hexctl.toml").unlink()
    Path("hexctl.toml").mkdir()
    with pytest.raises(hexctl.InputError, match=r"^hexctl\.toml: cannot be read: it is a pipe, a device"):
        hexctl.read_settings()
