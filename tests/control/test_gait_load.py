"""The load of a gait, each verdict beside a simulated walk."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.control.gait_load import GaitLoad, gait_load
from hexctl.gait.gait import NAMED_SLOTS, Motion, make_gait
from hexctl.robot.model import Robot
from tests.robots import ROBOT_NAMES, shipped, without_friction
from tests.trials import walk

AHEAD = (Motion(),)


def changed(name: str, *, mass: float = 1.0, stiffness: float = 1.0, torque: float = 1.0) -> Robot:
    """A shipped robot with multiples of mass (on the trunk), stiffness and torque, without dry friction."""
    robot = without_friction(name)
    body = replace(robot.body, mass_kg=robot.body.mass_kg + (mass - 1) * robot.mass_kg)
    servo = replace(robot.servo, stiffness_nm_per_rad=stiffness * robot.servo.stiffness_nm_per_rad)
    return replace(robot, body=body, servo=servo, joint_max_torque_nm=torque * robot.joint_max_torque_nm)


def load_of(robot: Robot, gait: str = "demo") -> GaitLoad:
    return gait_load(robot, make_gait(robot, gait), AHEAD)


def walks(robot: Robot, gait: str = "demo") -> bool:
    return walk(gait, robot=robot, duration_s=8.0).result.status == "ok"


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("gait", NAMED_SLOTS)
def test_shipped_robots_carry_themselves_in_every_named_gait(name: str, gait: str) -> None:
    load = load_of(shipped(name), gait)
    assert load.possible
    assert not any(warning.split(":")[0] in ("weak", "soft", "unsteady") for warning in load.warnings)
    assert load.least_clearance_m > 0


@pytest.mark.parametrize(
    ("name", "change", "word"),
    [
        ("ant", {"torque": 0.02}, "too weak"),  # 0.05 N m
        ("pexod", {"torque": 0.05}, "too weak"),
        ("phantomx", {"mass": 8.0, "torque": 100.0}, "too soft"),
        ("ant", {"stiffness": 0.03}, "too soft"),
    ],
)
def test_a_robot_that_does_not_walk_is_impossible_and_says_why(
    name: str, change: dict[str, float], word: str
) -> None:
    robot = changed(name, **change)
    load = load_of(robot)
    assert not load.possible
    assert word in load.obstacles[0]
    assert not walks(robot)


@pytest.mark.parametrize(
    ("name", "change", "word"),
    [
        ("ant", {"torque": 0.05}, None),  # twice the static torque without friction, and walks
        ("phantomx", {"mass": 2.0}, "soft"),
        ("phantomx", {"stiffness": 0.3}, "soft"),
        ("pexod", {"torque": 0.14}, "weak"),
    ],
)
def test_a_robot_at_its_limits_walks_and_is_warned_of(
    name: str, change: dict[str, float], word: str | None
) -> None:
    robot = changed(name, **change)
    load = load_of(robot)
    assert load.possible
    assert word is None or any(warning.startswith(word) for warning in load.warnings)
    assert walks(robot)


@pytest.mark.parametrize(
    ("stiffness", "drags", "walked"),
    [
        (1.0, None, None),
        (0.5, "a foot keeps", "of 35 such robots that were simulated, 31 made half"),
        (0.4, "not leave the floor", "of 32 such robots that were simulated, 22 made half"),
        (0.25, "no foot leaves the floor", "of 42 such robots that were simulated, 3 made half"),
    ],
)
def test_a_soft_robot_is_told_how_many_like_it_walked(
    stiffness: float, drags: str | None, walked: str | None
) -> None:
    load = load_of(changed("phantomx", stiffness=stiffness))
    soft = [warning for warning in load.warnings if warning.startswith("soft")]
    assert load.doubtful == bool(soft) == (drags is not None)
    for warning in soft:
        assert drags is not None
        assert drags in warning
        assert walked is not None
        assert walked in warning


def test_servos_that_hold_more_than_35_percent_for_most_of_the_cycle_overheat() -> None:
    robot = shipped("ant")
    strong = load_of(robot)
    assert (strong.duties == 0).all()
    weak = load_of(changed("ant", torque=0.05))
    assert 0.5 < weak.duties[1::3].max() <= 1
    assert any(warning.startswith("hot") for warning in weak.warnings)
    assert (weak.duties[0::3] == 0).all()


def moved_together(share: float) -> Robot:
    """Pexod with its legs nearer to one another along the body."""
    robot = shipped("pexod")
    mounts, feet = robot.mount_positions_body.copy(), robot.stance_feet_body.copy()
    mounts[:, 0] *= share
    feet[:, 0] += mounts[:, 0] - robot.mount_positions_body[:, 0]
    return replace(robot, mount_positions_body=mounts, stance_feet_body=feet)


def test_legs_that_touch_or_cross_are_warned_of() -> None:
    apart, touching, crossing, longer = (load_of(moved_together(share)) for share in (0.5, 0.4, 0.2, 0.05))
    assert apart.least_clearance_m > 0
    assert apart.warnings == ()
    assert touching.least_clearance_m < 0
    assert touching.possible
    assert any("touch" in warning for warning in touching.warnings)
    assert touching.crossing_share == 0
    # With solid legs in the simulation robots walk whose legs cross, and no depth or time separates them.
    assert 0 < crossing.crossing_share < 0.25 < longer.crossing_share
    for load, walked in ((crossing, "of 26 such robots"), (longer, "of 30 such robots")):
        assert load.possible
        (warning,) = [text for text in load.warnings if "cross" in text]
        assert f"{100 * load.crossing_share:.0f} % of the cycle" in warning
        assert walked in warning


def test_a_robot_whose_weight_is_outside_its_feet_tips_over() -> None:
    robot = shipped("pexod")
    feet, mounts = robot.stance_feet_body.copy(), robot.mount_positions_body.copy()
    mounts[:, 0] -= 0.9
    feet[:, 0] -= 0.9
    load = load_of(replace(robot, stance_feet_body=feet, mount_positions_body=mounts))
    assert not load.possible
    assert load.tipping == 1
    assert "tips over" in load.obstacles[0]
    assert np.isfinite(load.torques_nm).all()
