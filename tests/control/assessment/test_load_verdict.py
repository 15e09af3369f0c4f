"""Verdicts on the load of a gait, each beside a simulated walk."""

import pytest

from hexctl.control.assessment.load_verdict import LoadVerdict, load_verdict
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.robot.model import Robot
from tests.control.assessment.loads import changed, load_of, moved_back, moved_together
from tests.robots import ROBOT_NAMES, shipped
from tests.trials import walk


def verdict_of(robot: Robot, gait: str = "demo") -> LoadVerdict:
    return load_verdict(load_of(robot, gait))


def walks(robot: Robot, gait: str = "demo") -> bool:
    return walk(gait, robot=robot, duration_s=8.0).result.status == "ok"


@pytest.mark.parametrize("name", ROBOT_NAMES)
@pytest.mark.parametrize("gait", NAMED_SLOTS)
def test_shipped_robots_carry_themselves_in_every_named_gait(name: str, gait: str) -> None:
    verdict = verdict_of(shipped(name), gait)
    assert verdict.possible
    assert not any(warning.split(":")[0] in ("weak", "soft", "unsteady") for warning in verdict.warnings)
    assert load_of(shipped(name), gait).least_clearance_m > 0


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
    verdict = verdict_of(robot)
    assert not verdict.possible
    assert word in verdict.obstacles[0]
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
    verdict = verdict_of(robot)
    assert verdict.possible
    assert word is None or any(warning.startswith(word) for warning in verdict.warnings)
    assert walks(robot)


@pytest.mark.parametrize(
    ("stiffness", "drags", "walked"),
    [
        (1.0, None, None),
        (0.5, "a foot keeps", "of 20 such robots that were simulated, 17 made half"),
        (0.4, "not leave the floor", "of 20 such robots that were simulated, 12 made half"),
        (0.25, "no foot leaves the floor", "of 20 such robots that were simulated, 2 made half"),
    ],
)
def test_a_soft_robot_is_told_how_many_like_it_walked(
    stiffness: float, drags: str | None, walked: str | None
) -> None:
    verdict = verdict_of(changed("phantomx", stiffness=stiffness))
    soft = [warning for warning in verdict.warnings if warning.startswith("soft")]
    assert verdict.doubtful == bool(soft) == (drags is not None)
    for warning in soft:
        assert drags is not None
        assert drags in warning
        assert walked is not None
        assert walked in warning


def test_servos_that_hold_more_than_35_percent_for_most_of_the_cycle_overheat() -> None:
    assert not any(warning.startswith("hot") for warning in verdict_of(shipped("ant")).warnings)
    assert any(warning.startswith("hot") for warning in verdict_of(changed("ant", torque=0.05)).warnings)


def test_legs_that_touch_or_cross_are_warned_of() -> None:
    apart, touching = (verdict_of(moved_together(share)) for share in (0.5, 0.4))
    assert apart.warnings == ()
    assert touching.possible
    assert any("touch" in warning for warning in touching.warnings)
    # With solid legs in the simulation robots walk whose legs cross, and no depth or time separates them.
    for share, walked in ((0.2, "18 made half"), (0.05, "16 made half")):
        load = load_of(moved_together(share))
        verdict = load_verdict(load)
        assert verdict.possible
        (warning,) = [text for text in verdict.warnings if "cross" in text]
        assert f"{100 * load.crossing_share:.0f} % of the cycle" in warning
        assert walked in warning


def test_a_robot_whose_weight_is_outside_its_feet_tips_over() -> None:
    verdict = verdict_of(moved_back(0.9))
    assert not verdict.possible
    assert "tips over" in verdict.obstacles[0]


def test_a_robot_is_called_weak_well_before_it_sinks() -> None:
    """A limit analysis shares the weight better than legs in motion do."""
    robot = changed("ant", torque=0.07)
    verdict = verdict_of(robot)
    assert 1.25 < load_of(robot).capacity < 3
    assert verdict.doubtful
    assert any(warning.startswith("weak") for warning in verdict.warnings)
