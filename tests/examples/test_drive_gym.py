"""The example of a robot that is driven as an environment reaches its goal."""

import runpy
from pathlib import Path

import pytest

pytestmark = pytest.mark.slow

ROOT = Path(__file__).parents[2]


def test_a_policy_that_goes_straight_reaches_the_goal_and_again_after_a_reset() -> None:
    example = runpy.run_path(str(ROOT / "examples" / "drive_gym.py"))
    steps, away_m = example["walk_to_goal"]()
    assert away_m < example["REACHED_M"]
    assert steps < 100
    env = example["GoalEnv"]()
    first, _ = env.reset()
    env.step([1.0, 0.0, 0.0])
    again, _ = env.reset()
    assert (first == again).all()
    env.close()
