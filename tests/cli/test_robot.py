"""`hexctl robot import`: a robot file from the command line."""

from pathlib import Path
from typing import Any

from hexctl.cli.main import exit_code
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from tests.robots import shipped

PHANTOMX = Path(__file__).parents[1] / "data" / "phantomx_humarobotics.urdf"


def test_a_robot_file_is_made_and_what_to_measure_is_told(tmp_path: Path, capsys: Any) -> None:
    mine = tmp_path / "mine.yaml"
    arguments = ["robot", "import", str(PHANTOMX), "--foot", "0,0.13,0", "--name", "mine", "-o", str(mine)]
    assert exit_code(arguments) == 0
    out = capsys.readouterr().out.splitlines()
    assert out == [
        str(mine),
        "to measure: body.size_m, foot_radius_m",
        f"next: hexctl check --robot {mine}",
    ]
    assert load_robot(mine).name == "mine"
    before = mine.read_text()
    assert exit_code(arguments) == 2
    assert "exists; allowed: a new file, nothing is replaced" in capsys.readouterr().err
    assert mine.read_text() == before


def test_what_is_wrong_is_told_in_one_line(tmp_path: Path, capsys: Any) -> None:
    urdf, mine = tmp_path / "ant.urdf", str(tmp_path / "mine.yaml")
    urdf.write_text(urdf_of(shipped()))
    for arguments, told in (
        ([str(PHANTOMX), "-o", mine], "urdf: nothing tells where the foot"),
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
