"""The stance and the default gait of robots: `hexctl check` agrees with them, and proposes a stance."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml

from hexctl.control.assessment.default_gait import WANTED_LIFT, walkable
from hexctl.control.assessment.feasibility import RobotCheck, check_robot
from hexctl.control.assessment.stance_width import stance_width
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.configs import find_config, read_mapping
from hexctl.robot.formats.importing.robot_import import ImportedRobot
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.loader import load_robot_file, robot_of_content
from hexctl.robot.model import in_stance_of
from tests.robot.hexapods import MOUNTS, TIBIA_M, TRUNK, hexapod, imported, solid
from tests.robots import ROBOT_NAMES, shipped


def limit(low: float, high: float, velocity: float = 5.0, effort: float = 2.0) -> str:
    return f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>'


def checked(made: ImportedRobot, folder: Path) -> RobotCheck:
    (folder / "made.yaml").write_text(made.text, encoding="utf-8")
    return check_robot(folder / "made.yaml")


@pytest.mark.slow
@pytest.mark.parametrize(
    "limits",
    [(limit(-0.3, 0.3), limit(-0.3, 0.8), limit(-0.5, 0.3)), (limit(-1, 1, 0.3),) * 3],
    ids=["narrow joints", "slow joints"],
)
def test_the_default_gait_is_one_that_the_check_agrees_with(
    limits: tuple[str, str, str], tmp_path: Path
) -> None:
    made = walkable(imported(tmp_path, hexapod(limits=limits)))
    report = checked(made, tmp_path)
    assert report.possible
    assert report.demand.speed_holds
    assert not any("no default gait" in note for note in made.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effort", "possible", "said"), [(0.04, False, "too weak"), (0.35, True, "doubts the default gait: weak")]
)
def test_if_none_works_or_all_are_doubtful_the_import_says_why(
    effort: float, possible: bool, said: str, tmp_path: Path
) -> None:
    made = walkable(imported(tmp_path, hexapod(limits=(limit(-1, 1, effort=effort),) * 3)))
    assert said in str(made.notes)
    assert ("no default gait" in str(made.notes)) != possible
    verdict = checked(made, tmp_path).verdict
    assert (verdict.possible, verdict.doubtful) == (possible, possible)


#: Legs that point straight to the sides, some of them near to one another.
NEAR = [(0.7 * x, y, math.copysign(90, y)) for x, y, _ in MOUNTS]


@pytest.mark.slow
@pytest.mark.parametrize("radius_m", [0.008, 0.029])
def test_feet_that_would_touch_get_shorter_strides(radius_m: float, tmp_path: Path) -> None:
    ball = solid(f'<sphere radius="{radius_m}"/>', f"{TIBIA_M} 0 0")
    made = imported(tmp_path, hexapod(shin=ball, mounts=NEAR))
    wide, walks = checked(made, tmp_path), checked(walkable(made), tmp_path)
    assert ("feet touch" in str(wide.warnings)) == (radius_m > 0.01)
    assert "touch" not in str(walks.warnings)


@pytest.mark.slow
@pytest.mark.parametrize("trunk_kg", ["1.2", "3.5"])
def test_soft_robots_step_higher(trunk_kg: str, tmp_path: Path) -> None:
    limits = (limit(-1.2, 1.2, effort=1.5),) * 3
    first = imported(tmp_path, hexapod(limits=limits, trunk_inertial=TRUNK.replace("1.2", trunk_kg)))
    made, kept = walkable(first), walkable(replace(first, own_gait=True))
    usual = checked(kept, tmp_path).load.lift_left
    soft = usual < WANTED_LIFT
    assert soft == (trunk_kg != "1.2")
    assert (made.content["gait"]["height"] > kept.content["gait"]["height"]) == soft
    assert (checked(made, tmp_path).load.lift_left > usual) == soft


@pytest.mark.slow
@pytest.mark.parametrize("foot_y_m", [0.02, -0.035])
def test_projected_feet_are_exact_in_the_stance_that_is_taken(foot_y_m: float, tmp_path: Path) -> None:
    limits = (limit(-1.5, 1.5), limit(-0.2, 0.2), limit(-0.1, 0.1))
    first = imported(tmp_path, hexapod(foot_y_m=foot_y_m, limits=limits))
    made = walkable(replace(first, stances=(*first.stances[::-1],)))
    assert made.stances[0] != first.stances[0]
    robot, outward_m = made.robot(), made.stances[0][0]
    assert made.content["stance"]["outward_m"] == pytest.approx(math.hypot(outward_m, foot_y_m))
    angle = math.radians(MOUNTS[0][2]) + math.atan2(foot_y_m, outward_m)
    wanted_m = np.array(MOUNTS[0][:2]) + math.hypot(outward_m, foot_y_m) * np.array(
        [math.cos(angle), math.sin(angle)]
    )
    assert foot_positions_body(robot, robot.stance_angles_rad)[0, :2] == pytest.approx(wanted_m, abs=1e-6)


@pytest.mark.parametrize("name", ["ant", "freenove-big", "phantomx-ax"])
def test_a_gait_in_the_file_that_works_is_kept(name: str, tmp_path: Path) -> None:
    made = imported(tmp_path, mjcf_of(shipped(name)), "own.xml")
    assert walkable(made).content == made.content


def test_feet_that_touch_and_servos_that_clip_are_in_the_verdict(tmp_path: Path) -> None:
    content = yaml.safe_load(find_config("robots", "ant").read_text(encoding="utf-8"))
    path = tmp_path / "ant.yaml"
    for changed, words in (
        ({"foot_radius_m": 0.07}, "feet touch"),
        ({"servos": {"tibia": {"offset_deg": 75, "min_us": 1400}}}, "limits of the servos"),
    ):
        path.write_text(yaml.safe_dump(content | changed), encoding="utf-8")
        checked = check_robot(path)
        assert checked.verdict.doubtful
        assert any(words in text for text in checked.warnings)


# The stance width that a check proposes: the servos carry the robot on any five legs


@pytest.mark.parametrize(("name", "gait"), [*((name, "tripod") for name in ROBOT_NAMES), ("lukas", "demo")])
def test_shipped_robots_stand_as_is_proposed(name: str, gait: str) -> None:
    found = stance_width(shipped(name), make_gait(shipped(name), gait))
    assert found["proposed_outward_m"] == found["stance_outward_m"]
    assert (found["five_leg_drive"] or math.inf) <= 1


def test_no_stance_is_proposed_for_a_robot_that_tips_over_on_five_legs() -> None:
    file = load_robot_file("ant")
    content = read_mapping(file.path)
    tips = robot_of_content(
        {**content, "body": {**content["body"], "mass_kg": 5.0, "com_m": [0.3, 0.0, 0.0]}}, file.path
    )
    found = stance_width(tips, make_gait(tips, "tripod"))
    assert found["five_leg_drive"] is found["proposed_five_leg_drive"] is None


@pytest.mark.slow
def test_a_stance_too_wide_for_five_legs_gets_the_widest_that_its_servos_carry() -> None:
    robot = shipped("phantomx")
    wide = in_stance_of(robot, 0.15)
    found = stance_width(wide, make_gait(wide, "tripod"))
    assert (found["five_leg_drive"] or 0.0) > 1 >= (found["proposed_five_leg_drive"] or math.inf)
    assert found["proposed_outward_m"] == pytest.approx(robot.stance_outward_m)
    wider = in_stance_of(wide, robot.stance_outward_m + 0.02 * 0.15)
    assert (stance_width(wider, make_gait(wide, "tripod"))["five_leg_drive"] or 0.0) > 1
