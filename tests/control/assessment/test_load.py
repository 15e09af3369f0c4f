"""Whether a robot can make a gait: range and speed, torques, clearance, and verdicts beside walks."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl import InputError
from hexctl.control.assessment.check_options import CheckOptions
from hexctl.control.assessment.feasibility import GOOD_SPEED, LEAST_SPEED, check_robot
from hexctl.control.assessment.gait_load import load_verdict
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.ik.clearance import PARTS
from tests.control.assessment.loads import changed, load_of, moved
from tests.robots import ROBOT_NAMES
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
