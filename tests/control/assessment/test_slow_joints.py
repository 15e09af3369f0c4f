"""Joints that are too slow for a gait: what the check says, and the cause of a walk that gets nowhere."""

from dataclasses import replace
from pathlib import Path

import pytest
import yaml

from hexctl.backends.sim.world import World
from hexctl.control.assessment.feasibility import check_robot, gait_demand
from hexctl.control.batch import SimTrial, run_sim_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.gait.gait import Motion, make_gait
from hexctl.robot.configs import find_config
from hexctl.robot.model import Robot
from tests.robots import shipped


def slowed(name: str, gait: str, share: float) -> Robot:
    """A shipped robot whose joints reach a share of the speed of a gait."""
    robot = shipped(name)
    now = gait_demand(robot, make_gait(robot, gait), [Motion()]).speed_share
    return replace(robot, joint_max_speed_rad_s=robot.joint_max_speed_rad_s * share / now)


@pytest.mark.parametrize(("name", "gait"), [("ant", "wave"), ("phantomx", "wave"), ("lukas", "wave")])
def test_a_walk_with_clipped_commands_names_them(name: str, gait: str) -> None:
    robot = slowed(name, gait, 0.1)
    plan = TrialPlan(gait=make_gait(robot, gait), duration_s=8.0)
    result = run_sim_trial(SimTrial(robot=robot, plan=plan, failure=None, world=World()))
    assert (result.status, result.cause) == ("no_progress", "clipping")


def slow_file(folder: Path, name: str, speed_deg_s: float) -> Path:
    content = yaml.safe_load(find_config("robots", name).read_text(encoding="utf-8"))
    for joint in content["joints"].values():
        joint["max_speed_deg_s"] = speed_deg_s
    path = folder / f"{name}.yaml"
    path.write_text(yaml.safe_dump(content), encoding="utf-8")
    return path


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ant", "pexod", "jethexa"])
def test_the_verdict_of_a_check_holds_the_speed_of_the_joints(name: str, tmp_path: Path) -> None:
    needed = check_robot(name).demand.peak_speed_rad_s.max() * 180 / 3.141592653589793
    for share, possible, doubtful in ((0.001, False, False), (0.15, False, False), (0.3, True, True)):
        checked = check_robot(slow_file(tmp_path, name, float(share * needed)))
        assert checked.possible == possible
        assert checked.verdict.doubtful == doubtful
        assert any(f"joints reach {100 * share:.0f} % of the speed" in text for text in checked.warnings)
    checked = check_robot(slow_file(tmp_path, name, float(0.8 * needed)))
    assert checked.possible
    assert not any("joints reach" in text for text in checked.warnings)


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
