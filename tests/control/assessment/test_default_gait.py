"""The stance and the default gait of imported robots: `hexctl check` agrees with them."""

from pathlib import Path

import pytest

from hexctl.control.assessment.default_gait import walkable
from hexctl.control.assessment.feasibility import RobotCheck, check_robot
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.formats.robot_import import ImportedRobot
from tests.robot.hexapods import TRUNK, hexapod, imported
from tests.robots import shipped


def limit(low: float, high: float, velocity: float = 5.0, effort: float = 2.0) -> str:
    return f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>'


def checked(made: ImportedRobot, folder: Path) -> RobotCheck:
    (folder / "made.yaml").write_text(made.text, encoding="utf-8")
    return check_robot(folder / "made.yaml")


WIDE = limit(-1.5, 1.5)
NARROW = {
    "coxae": (limit(-0.12, 0.1), WIDE, WIDE),
    "femurs": (WIDE, limit(0.1, 0.5), WIDE),
    "tibiae": (WIDE, WIDE, limit(-0.3, 0.2)),
    "all": (limit(-0.3, 0.3), limit(-0.3, 0.8), limit(-0.5, 0.3)),
    "slow joints": (limit(-1, 1, 0.3), limit(-1, 1, 0.3), limit(-1, 1, 0.3)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", NARROW)
def test_the_default_gait_is_one_that_the_check_agrees_with(case: str, tmp_path: Path) -> None:
    made = walkable(imported(tmp_path, hexapod(limits=NARROW[case])))
    report = checked(made, tmp_path)
    assert report.possible
    assert report.demand.speed_holds
    assert not any("no default gait" in note for note in made.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effort", "trunk", "words"),
    [
        (0.04, TRUNK, "too weak"),
        (0.5, TRUNK.replace("1.2", "15"), "too weak"),
        pytest.param(0.2, TRUNK.replace("1.2", "6"), "too weak", marks=pytest.mark.long),
    ],
)
def test_if_none_works_the_import_says_why(effort: float, trunk: str, words: str, tmp_path: Path) -> None:
    limits = (limit(-1, 1, effort=effort),) * 3
    made = walkable(imported(tmp_path, hexapod(limits=limits, trunk_inertial=trunk)))
    assert any("no default gait" in note and words in note for note in made.notes)
    assert not checked(made, tmp_path).possible


@pytest.mark.parametrize("name", ["ant", "freenove-big", "phantomx-ax"])
def test_a_gait_in_the_file_that_works_is_kept(name: str, tmp_path: Path) -> None:
    made = imported(tmp_path, mjcf_of(shipped(name)), "own.xml")
    assert walkable(made).content == made.content
