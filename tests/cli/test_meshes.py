"""Meshes named in a robot file: seen in every recording, and refused before anything moves."""

from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.recording import paths
from tests.recording.conftest import ReadBack
from tests.robot.meshmaking import stl_box
from tests.robots import edited_file, put

pytestmark = pytest.mark.slow


@pytest.fixture
def robot_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "trunk.stl").write_bytes(stl_box())
    return edited_file(tmp_path, put("meshes", {"body": {"file": "trunk.stl", "scale": 0.2}}))


def drawn(path: Path) -> bytes:
    """The mesh that a recording shows as the trunk."""
    return bytes(ReadBack(path).values(f"/{paths.BODY}", "Asset3D:blob")[0][0])


def test_a_run_and_a_trial_show_them(robot_file: Path, tmp_path: Path) -> None:
    run = ["run", "--robot", str(robot_file), "--duration", "0.5", "--record", "walk.rrd", "--json"]
    assert exit_code(run) == 0
    assert drawn(tmp_path / "walk.rrd") == stl_box()
    adapt = ["adapt", "--robot", str(robot_file), "--failed-leg", "5", "--duration", "0.5", "--json"]
    assert exit_code([*adapt, "--budget", "1", "--optimizer", "random"]) == 0
    (trial,) = (tmp_path / "runs").glob("*/trial-001.rrd")
    assert drawn(trial) == stl_box()


def test_check_names_them(robot_file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["check", str(robot_file)]) == 0
    assert "meshes for body, solids for the rest" in capsys.readouterr().out


@pytest.mark.parametrize("command", [["run"], ["adapt", "--failed-leg", "5"], ["check"]])
def test_a_broken_one_is_refused_before_anything_moves(
    command: list[str], robot_file: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "trunk.stl").write_bytes(b"no mesh")
    assert exit_code([*command, "--robot", str(robot_file)]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert "meshes.body.file" in printed.err
    assert not list(tmp_path.glob("runs/*"))


def test_without_a_recording_they_are_not_loaded(robot_file: Path, tmp_path: Path) -> None:
    (tmp_path / "trunk.stl").unlink()
    run = ["run", "--robot", str(robot_file), "--duration", "0.2", "--no-record", "--json"]
    assert exit_code(run) == 0
