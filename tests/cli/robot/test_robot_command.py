"""`hexctl robot`, `gaits` and `worlds`: what is shipped, and robot files from the command line."""

import json
from pathlib import Path
from typing import Any

from hexctl.backends.sim.world import load_world
from hexctl.cli.main import exit_code
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import config_names
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from tests.robots import shipped

PHANTOMX = Path(__file__).parents[2] / "data" / "phantomx_humarobotics.urdf"


def test_a_robot_file_is_made_and_what_to_measure_is_told(tmp_path: Path, capsys: Any) -> None:
    mine = tmp_path / "mine.yaml"
    arguments = ["robot", "import", str(PHANTOMX), "--foot", "0,0.13,0", "--name", "mine", "-o", str(mine)]
    assert exit_code(arguments) == 0
    out = capsys.readouterr().out.splitlines()
    assert out[0] == str(mine)
    assert out[1].startswith("to measure: ")
    assert any(line.startswith("  body.size_m: no solid covers") for line in out)
    assert out[-1] == f"next: hexctl check --robot {mine}"
    assert load_robot(mine).name == "mine"
    before = mine.read_text()
    assert exit_code(arguments) == 2
    assert "exists; allowed: a new file, nothing is replaced" in capsys.readouterr().err
    assert mine.read_text() == before


def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, capsys: Any) -> None:
    urdf, mine = tmp_path / "ant.urdf", str(tmp_path / "mine.yaml")
    urdf.write_text(urdf_of(shipped()))
    for arguments, told in (
        ([str(urdf), "-o", mine, "--foot", "1,2"], "--foot: got '1,2'; allowed: three numbers in m"),
        ([str(urdf), "-o", mine, "--foot", "a,b,nan"], "--foot: got 'a,b,nan'"),
        ([str(urdf), "-o", mine, "--forward", "up"], "--forward: got up; allowed: x, y, -x, -y"),
        ([str(urdf), "-o", str(tmp_path / "mine.txt")], "--output: got"),
        ([str(urdf), "-o", str(tmp_path / "no" / "mine.yaml")], "--output: "),
        ([str(urdf), "-o", mine, "--name", "Not A Name"], "--name: got Not A Name"),
        ([mine, "-o", mine], f"{mine}: cannot be read"),
    ):
        assert exit_code(["robot", "import", *arguments]) == 2
        error = capsys.readouterr().err
        assert error.startswith(f"hexctl: {told}"), error
        assert error.count("\n") == 1
    assert sorted(path.name for path in tmp_path.iterdir()) == ["ant.urdf"]


def test_shipped_robots_are_listed_and_copied(tmp_path: Path, capsys: Any) -> None:
    assert exit_code(["robot", "list", "--json"]) == 0
    names = json.loads(capsys.readouterr().out)
    assert set(names) == set(config_names("robots"))
    mine = tmp_path / "mine.yaml"
    for code in (0, 2):  # nothing is replaced
        assert exit_code(["robot", "copy", "Pexod", str(mine)]) == code
        assert load_robot(mine).fingerprint == load_robot("pexod").fingerprint
    assert "FILE: " in capsys.readouterr().err
    assert exit_code(["robot", "copy", "mars", str(tmp_path / "other.yaml")]) == 2
    assert not (tmp_path / "other.yaml").exists()


def test_names_of_gaits_and_worlds_are_those_that_options_take(capsys: Any) -> None:
    assert exit_code(["gaits", "--json"]) == 0
    for name, slots in json.loads(capsys.readouterr().out).items():
        assert list(make_gait(shipped(), name).slots) == slots
    assert exit_code(["worlds", "--json"]) == 0
    for name, text in json.loads(capsys.readouterr().out).items():
        assert load_world(name.replace("NUMBER", "3")) is not None
        assert text.endswith(".")
