"""Whether a robot can make a gait, with verdicts beside walks; and the stance and gait that it is given."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hexctl import InputError
from hexctl.control.checks.check_options import CheckOptions
from hexctl.control.checks.default_gait import TARGET_LIFT, walkable
from hexctl.control.checks.feasibility import GOOD_SPEED, LEAST_SPEED, RobotCheck, check_robot
from hexctl.control.checks.gait_load import load_verdict
from hexctl.control.planning.stance_width import stance_width
from hexctl.gait.gait import NAMED_SLOTS, make_gait
from hexctl.ik.clearance import PARTS
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.configs import find_config, read_mapping
from hexctl.robot.formats.importing.robot_import import ImportedRobot
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.loader import load_robot_file, robot_of_content
from hexctl.robot.model import in_stance_of
from tests.control.checks.loads import changed, load_of, moved
from tests.robot.hexapods import MOUNTS, TIBIA_M, TRUNK, hexapod, imported, solid
from tests.robots import ROBOT_NAMES, shipped
from tests.trials import walk


def test_an_impossible_gait_is_a_result_and_a_bad_value_an_error() -> None:
    assert not check_robot("ant", amplitude=0.5).possible
    with pytest.raises(InputError, match="pace_hz"):
        check_robot("ant", pace_hz=0)
    refused: dict[str, Any] = {"world": "flat", "duration_s": 5.0, "pace_hz": 11.0, "turn_rate_rad_s": 7.0}
    for option, value in refused.items():
        with pytest.raises(InputError, match=f"^{option}"):
            CheckOptions(**{option: value})
    assert CheckOptions(physics=True, world="slope", duration_s=5.0).duration_s == 5.0


@pytest.mark.parametrize(("height_m", "verdict"), [(0.2, "can"), (0.245, "doubtful"), (0.26, "cannot")])
def test_a_trunk_that_reaches_to_the_floor_is_noticed(height_m: float, verdict: str) -> None:
    checked = check_robot("makeyourpet")
    stands_m = checked.robot.standing_height_m
    height_m *= stands_m / 0.125
    body = replace(checked.robot.body, size_m=(*checked.robot.body.size_m[:2], height_m))
    found = replace(checked, robot=replace(checked.robot, body=body)).verdict
    assert (found.possible, found.doubtful) == (verdict != "cannot", verdict == "doubtful")
    assert any(text.startswith("trunk") for text in (*found.obstacles, *found.warnings)) == (verdict != "can")


def test_a_joint_above_its_torque_makes_a_gait_doubtful() -> None:
    load = load_of(changed("phantomx"))
    torques_nm = load.max_torques_nm * np.where(np.arange(18) == 7, 1.02, 0.3)
    verdict = load_verdict(replace(load, torques_nm=torques_nm, capacity=3.5))
    assert verdict.doubtful
    assert verdict.warnings[0].startswith("overloaded: leg3_femur would need up to 102 %")


def test_legs_that_are_nearer_together_touch_then_cross_then_cross_longer() -> None:
    """With solid legs in the simulation robots walk whose legs cross, and no depth or time separates them."""
    loads = [load_of(moved(share=share)) for share in (0.5, 0.4, 0.2, 0.05)]
    apart, touching, crossing, longer = loads
    assert apart.least_clearance_m > 0
    assert touching.least_clearance_m < 0
    assert touching.crossing_share == 0
    assert 0 < crossing.crossing_share < 0.25 < longer.crossing_share
    assert load_verdict(apart).warnings == ()
    for load, word in ((touching, "touch"), (crossing, "cross"), (longer, "cross")):
        verdict = load_verdict(load)
        assert verdict.possible
        assert any(word in warning for warning in verdict.warnings)


def test_gap_and_depth_are_those_of_the_parts_that_are_named() -> None:
    """Thick coxae that overlap have a lesser gap than thin tibiae whose axes meet; these are named."""
    robot = replace(moved(share=0.2), link_radii_m=np.array([0.06, 0.015, 0.015]))
    load = load_of(robot)
    one, other = (PARTS.index(part) for part in load.nearest_parts)
    radii = np.append(robot.link_radii_m, robot.foot_radius_m)
    touching_m = radii[one] + radii[other]
    assert load.crossing
    assert "coxa" not in load.nearest_parts
    assert load.least_clearance_m == pytest.approx(-load.overlap * touching_m)


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("gait", NAMED_SLOTS)
def test_shipped_robots_walk_every_named_gait_in_all_directions(name: str, gait: str) -> None:
    checked = check_robot(name, gait)
    assert checked.possible
    assert checked.warnings == ()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "change", "word", "possible"),
    [
        ("ant", {"torque": 0.02}, "weak", False),  # 0.05 N m
        ("phantomx", {"mass": 8.0, "torque": 100.0}, "soft", False),
        ("ant", {"torque": 0.05}, "hot", True),  # twice the static torque without friction, and walks
        ("phantomx", {"stiffness": 0.3}, "soft", True),
        ("pexod", {"torque": 0.14}, "weak", True),
    ],
)
def test_a_robot_that_does_not_walk_is_impossible_and_one_at_its_limits_is_warned_of(
    name: str, change: dict[str, float], word: str, possible: bool
) -> None:
    robot = changed(name, **change)
    verdict = load_verdict(load_of(robot))
    assert verdict.possible == possible
    assert any(word in text for text in (verdict.warnings if possible else verdict.obstacles))
    assert (walk(robot=robot, duration_s=6.0).result.status == "ok") == possible


@pytest.mark.parametrize(("stiffness", "soft"), [(1.0, False), (0.5, True), (0.4, True), (0.25, True)])
def test_a_soft_robot_is_doubtful(stiffness: float, soft: bool) -> None:
    verdict = load_verdict(load_of(changed("phantomx", stiffness=stiffness)))
    assert verdict.doubtful == soft == any(warning.startswith("soft") for warning in verdict.warnings)


@pytest.mark.parametrize("share", [0.19, 0.2, 0.39, 0.4])
def test_a_robot_too_slow_for_a_gait_cannot_walk_it_and_a_slow_one_is_warned_of(share: float) -> None:
    check = check_robot("ant")
    slow = replace(check, demand=replace(check.demand, speed_share=share))
    assert slow.possible == (share >= LEAST_SPEED)
    assert any(text.startswith("slow") for text in slow.warnings) == (share < GOOD_SPEED)


def test_a_robot_whose_weight_is_outside_its_feet_tips_over_under_finite_loads() -> None:
    load = load_of(moved(back_m=0.9))
    assert load.tipping == 1
    assert np.isfinite(load.torques_nm).all()
    assert not load_verdict(load).possible


# The stance and the default gait of imported robots


def limit(low: float, high: float, velocity: float = 5.0, effort: float = 2.0) -> str:
    return f'<limit lower="{low}" upper="{high}" effort="{effort}" velocity="{velocity}"/>'


def checked(made: ImportedRobot, folder: Path) -> RobotCheck:
    (folder / "made.yaml").write_text(made.text, encoding="utf-8")
    return check_robot(folder / "made.yaml")


WIDE = limit(-1.5, 1.5)
LIMITS = {
    "all": (limit(-0.3, 0.3), limit(-0.3, 0.8), limit(-0.5, 0.3)),
    "slow joints": (limit(-1, 1, 0.3),) * 3,
    "coxae": (limit(-0.12, 0.1), WIDE, WIDE),
    "femurs": (WIDE, limit(0.1, 0.5), WIDE),
    "tibiae": (WIDE, WIDE, limit(-0.3, 0.2)),
}


@pytest.mark.slow
@pytest.mark.parametrize("case", LIMITS)
def test_the_default_gait_is_one_that_the_check_agrees_with(case: str, tmp_path: Path) -> None:
    made = walkable(imported(tmp_path, hexapod(limits=LIMITS[case])))
    report = checked(made, tmp_path)
    assert report.possible
    assert report.demand.speed_reached
    assert not any("no default gait" in note for note in made.notes)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("effort", "trunk_kg", "possible", "said"),
    [
        (0.04, 1.2, False, "too weak"),
        (0.5, 15.0, False, "too weak"),
        (0.35, 1.2, True, "doubts the default gait: weak"),
    ],
)
def test_if_none_works_or_all_are_doubtful_the_import_says_why(
    effort: float, trunk_kg: float, possible: bool, said: str, tmp_path: Path
) -> None:
    limits, trunk = (limit(-1, 1, effort=effort),) * 3, TRUNK.replace("1.2", str(trunk_kg))
    made = walkable(imported(tmp_path, hexapod(limits=limits, trunk_inertial=trunk)))
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
    soft = usual < TARGET_LIFT
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
    made = imported(tmp_path, mjcf_of(shipped(name)))
    assert walkable(made).content == made.content


def test_feet_that_touch_and_servos_that_clip_are_in_the_verdict(tmp_path: Path) -> None:
    content = yaml.safe_load(find_config("robots", "ant").read_text(encoding="utf-8"))
    path = tmp_path / "ant.yaml"
    for change, words in (
        ({"foot_radius_m": 0.07}, "feet touch"),
        ({"servos": {"tibia": {"offset_deg": 75, "min_us": 1250}}}, "limits of the servos"),
    ):
        path.write_text(yaml.safe_dump(content | change), encoding="utf-8")
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
