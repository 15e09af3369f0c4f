import json
from dataclasses import replace
from typing import Any

import pytest

from hexctl.adapt.prior.prior import PriorKey
from hexctl.backends.sim.world import load_randomization
from hexctl.errors import InputError
from hexctl.robot.failure import Failure, drawn_failure
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.transfer.transfer_settings import FIRST_WORLD
from tests.adapt.priors import made_up_prior, plan_of
from tests.robots import shipped
from tests.study.made_up_transfer import (
    DURATION_S,
    LEGS,
    WORLDS,
    plan,
    question,
)


def test_landscapes_come_world_by_world_from_behind_those_that_were_looked_at() -> None:
    asked = plan()
    specs = asked.specs()
    assert [(spec.seed, spec.leg) for spec in specs] == [
        (FIRST_WORLD + world, leg) for world in range(WORLDS) for leg in LEGS
    ]
    assert [spec.world for spec in specs[:: len(LEGS)]] == asked.family.members(FIRST_WORLD, WORLDS)
    assert {(spec.self_rotation, spec.placed) for spec in specs} == {("rear", False)}


def test_no_world_has_a_value_in_common_with_one_of_a_prior() -> None:
    believed = load_randomization("randomised")
    known = PriorPlan(robot=shipped(), family=believed, worlds=100).specs()
    for key in believed.ranges:
        tried = {json.dumps(spec.world.model_dump()[key]) for spec in plan(worlds=100).specs()}
        assert not tried & {json.dumps(spec.world.model_dump()[key]) for spec in known}


def test_every_run_has_a_seed_of_its_own() -> None:
    asked = plan(worlds=30, legs=(1, 2, 3, 4, 5, 6), runs=5)
    seeds = [asked.seed_of(spec, run) for spec in asked.specs() for run in range(5)]
    assert len(set(seeds)) == len(seeds) == 30 * 6 * 5
    other = replace(asked, seed=1)
    assert not {other.seed_of(spec, run) for spec in other.specs() for run in range(5)} & set(seeds)


@pytest.mark.parametrize(("options", "words"), [
    ({"worlds": 1001}, "worlds: got 1001; allowed: 1..1000"),
    ({"legs": ()}, "legs"),
    ({"legs": (2, 2)}, "legs: got 2,2"),
    ({"seed": -1}, "seed: got -1"),
    ({"optimizers": ("random", "random")}, "optimizers: got random,random"),
    ({"duration_s": float("nan")}, "duration"),
    ({"duration_s": float("inf")}, "duration"),
    ({"prior": made_up_prior(question(self_rotation="front"))}, "self-rotation front, not rear"),
    ({"prior": made_up_prior(question("phantomx"))}, "robot phantomx, not ant"),
], ids=lambda value: value if isinstance(value, str) else "-")  # fmt: skip
def test_what_cannot_be_done_is_refused_in_one_line(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refused:
        plan(**options).check()
    assert words in str(refused.value)
    assert "\n" not in str(refused.value)


def test_a_prior_that_says_nothing_about_a_leg_is_refused_before_anything_runs() -> None:
    pexod = shipped("pexod")
    prior = made_up_prior(question("pexod"), legs=(1,))
    with pytest.raises(InputError, match=r"nothing on legs \[2\]"):
        plan(robot=pexod, prior=prior, legs=(1, 2)).check()
    plan(robot=pexod, prior=prior, legs=(1, 6)).check()


def test_no_optimizers_are_refused() -> None:
    with pytest.raises(InputError, match="optimizers: got"):
        plan(optimizers=()).check()


def test_the_trials_of_the_benchmark_are_those_of_a_session() -> None:
    session = PriorKey.of(shipped(), plan_of(shipped(), duration_s=DURATION_S))
    assert PriorKey.of(shipped(), plan().specs()[0].trial(1).plan).differences(session) == []


def test_one_leg_may_fail_in_each_world_the_next_one_in_the_next() -> None:
    asked = plan(worlds=5, legs=(2, 3, 5), one_leg=True).specs()
    legs = [(2, 3, 5)[number % 3] for number in range(FIRST_WORLD, FIRST_WORLD + 5)]
    assert [(spec.seed, spec.leg) for spec in asked] == list(enumerate(legs, FIRST_WORLD))


def test_what_is_not_known_differs_from_world_to_world_and_needs_a_prior_for_that() -> None:
    unknown = plan_of(shipped(), duration_s=DURATION_S, failure=Failure(leg=5, kind="unknown"))
    prior = made_up_prior(PriorKey.of(shipped(), unknown))
    asked = plan(failure="unknown", prior=prior, worlds=20)
    asked.check()
    broken = [
        drawn_failure(spec.robot, trial.failure, trial.seed)
        for spec in asked.specs()
        for trial in [spec.trial(1)]
    ]
    assert len({str(one) for one in broken}) > 8
    assert {str(spec.trial(1).plan.belief) for spec in asked.specs()} == {"unknown"}
    with pytest.raises(InputError, match="failure locked, not unknown"):
        plan(failure="unknown").check()
