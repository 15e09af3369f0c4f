"""What a prior is built from: which landscapes, in which order, and what is refused."""

from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

from hexctl.backends.sim.family import WorldFamily, load_family
from hexctl.errors import InputError
from hexctl.study.prior.plan import WORLDS_PER_LEG, PriorPlan
from tests.robots import shipped


@cache
def _family() -> WorldFamily:
    return load_family("randomised")


def plan(**options: Any) -> PriorPlan:
    return PriorPlan(robot=shipped(), family=_family(), **options)


def test_landscapes_come_world_by_world_so_that_a_part_serves_all_legs() -> None:
    specs = plan(worlds=3, legs=(2, 5)).specs()
    assert [(spec.place, spec.leg) for spec in specs] == [
        ("world 1", 2), ("world 1", 5), ("world 2", 2), ("world 2", 5), ("world 3", 2), ("world 3", 5),
    ]  # fmt: skip
    assert specs[3].title == "leg 5 with self-rotation, world 2"


def test_fewer_worlds_are_the_first_of_more() -> None:
    few, many = (plan(worlds=worlds, legs=(1, 4)).specs() for worlds in (3, 8))
    assert [spec.fingerprint for spec in few] == [spec.fingerprint for spec in many[: len(few)]]


def test_a_leg_walks_the_same_landscapes_whichever_legs_there_are() -> None:
    alone, among = plan(worlds=3, legs=(4,)).specs(), plan(worlds=3).specs()
    assert [spec.fingerprint for spec in alone] == [spec.fingerprint for spec in among if spec.leg == 4]


def test_each_leg_has_worlds_of_its_own() -> None:
    specs = plan(worlds=16).specs()
    assert len({spec.world for spec in specs}) == len(specs) == 6 * 16
    for leg in (1, 6):
        worlds = [spec.world for spec in specs if spec.leg == leg]
        assert worlds == _family().members((leg - 1) * WORLDS_PER_LEG, 16)


def test_all_that_a_prior_says_is_in_its_landscapes() -> None:
    asked = plan(worlds=2, legs=(3,), failure="limp", self_rotation="front", duration_s=12.0)
    for spec in asked.specs():
        assert spec.robot is asked.robot
        assert (spec.failure, spec.self_rotation, spec.duration_s) == ("limp", "front", 12.0)
        assert spec.placed
        assert spec.codes == tuple(range(1, 121))


def test_robots_are_put_down_a_little_off_to_both_sides() -> None:
    misses_deg = np.degrees([spec.miss_rad for spec in plan(worlds=64).specs()])
    assert len(set(misses_deg.tolist())) == 6 * 64
    assert misses_deg.mean() == pytest.approx(0, abs=0.1)
    assert misses_deg.std() == pytest.approx(2.0, abs=0.2)
    assert (np.abs(misses_deg) <= 4).mean() == pytest.approx(0.9545, abs=0.02)


def test_a_robot_that_does_not_turn_misses_nothing() -> None:
    specs = plan(worlds=4, legs=(1, 2), self_rotation="none").specs()
    assert {spec.miss_rad for spec in specs} == {0.0}
    assert {spec.trial(1).facing_rad for spec in specs} == {0.0}


@pytest.mark.parametrize("worlds", [2, WORLDS_PER_LEG])
def test_a_prior_of_two_worlds_to_a_whole_block_is_allowed(worlds: int) -> None:
    plan(worlds=worlds, legs=(5,)).check()


@pytest.mark.parametrize("worlds", [-1, 0, 1, WORLDS_PER_LEG + 1])
def test_another_number_of_worlds_is_refused(worlds: int) -> None:
    with pytest.raises(InputError, match=rf"^--worlds: got {worlds}; allowed: 2\.\.1024$"):
        plan(worlds=worlds).check()


@pytest.mark.parametrize("self_rotation", ["rear", "front", "none"])
def test_each_shipped_robot_can_walk_the_default_prior(self_rotation: str) -> None:
    for name in ("ant", "phantomx", "pexod"):
        replace(plan(worlds=2, self_rotation=self_rotation), robot=shipped(name)).check()


def test_a_walk_that_the_legs_cannot_make_is_refused_before_anything_runs() -> None:
    robot = shipped("phantomx")
    long_strides = replace(robot, gait=replace(robot.gait, amplitude=0.3))
    with pytest.raises(InputError, match=r"^phantomx, leg 2 .*world 1: .*leg") as refused:
        replace(plan(worlds=2, legs=(2,)), robot=long_strides).check()
    assert "\n" not in str(refused.value)
