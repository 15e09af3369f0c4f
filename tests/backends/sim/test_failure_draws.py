"""Families that draw failures: what members get, and what is refused."""

from collections import Counter
from pathlib import Path

import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import load_randomization, load_world
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from tests.robots import shipped

#: All that a drawn failure may say; members of 0.1 s walks reach it.
FULL = """\
seed: 3
ranges:
  friction: {low: 0.5, high: 1.0}
failures:
  - at_s: {low: 0.02, high: 0.06}
    legs: [2, 5]
    failure: [limp, "stuck:femur", weak, "weak:coxa"]
    torque_share: {low: 0.2, high: 0.4}
    heals_after_s: {low: 1, high: 2}
    share: 0.75
  - at_s: {low: 3, high: 4, scale: log}
    legs: [5, 2]
"""

HEAD = "seed: 1\nranges:\n  friction: {low: 0.4, high: 1.0}\n"


def _written(text: str, folder: Path) -> Path:
    path = folder / "family.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def test_members_draw_leg_time_kind_torque_and_healing(tmp_path: Path) -> None:
    members = load_randomization(_written(FULL, tmp_path)).members(0, 256)
    assert load_randomization(_written(FULL, tmp_path)).members(7, 1) == [members[7]]
    first = [world.events[0] for world in members if world.healings]
    assert 0.7 < len(first) / len(members) < 0.8
    legs = Counter(event.leg for event in first)
    assert set(legs) == {2, 5}
    assert min(legs.values()) > 0.4 * len(first)
    kinds = Counter((event.failure.kind, event.failure.joint) for event in first if event.failure)
    assert set(kinds) == {("limp", None), ("stuck", "femur"), ("weak", None), ("weak", "coxa")}
    assert min(kinds.values()) > 0.2 * len(first)
    shares = [e.failure.torque_fraction for e in first if e.failure and e.failure.kind == "weak"]
    assert min(shares) >= 0.2
    assert max(shares) <= 0.4
    assert max(shares) - min(shares) > 0.15
    for world in members:
        failing = [event for event in world.events if event.failure]
        assert len({event.leg for event in failing}) == len(failing), "the second has another leg"
        assert 3 <= failing[-1].at_s <= 4
        for healing in (event for event in world.events if not event.failure):
            (before,) = (event.at_s for event in failing if event.leg == healing.leg)
            assert 0.99 <= healing.at_s - before <= 2.01


def test_a_family_is_written_down_with_its_failures(tmp_path: Path) -> None:
    family = load_randomization(_written(HEAD, tmp_path))
    assert family.model_dump(mode="json")["failures"] == []
    again = type(family).model_validate(load_randomization("failing").model_dump(mode="json"))
    assert again.members(5, 3) == load_randomization("failing").members(5, 3)


@pytest.mark.slow
def test_batches_and_single_simulations_get_what_was_drawn(tmp_path: Path) -> None:
    path = _written(FULL, tmp_path)
    text = f"{path}:4"
    (event, *_) = load_world(text).events
    model = shipped()
    with SimServos(model, world=text) as servos:
        servos.walk_begins()
        for _ in range(6):
            servos.clock.tick()
        assert [failure.leg for failure in servos.failures] == [event.leg]
    plan = TrialPlan(gait=make_gait(model, "tripod"), duration_s=1.5)
    trials = [SimTrial(robot=model, plan=plan, failure=None, world=f"{path}:{n}") for n in (3, 4, 5)]
    together = run_sim_trials(trials, threads=1)
    assert together[1] == run_sim_trial(trials[1])
    whole = trials[1].world.model_copy(update={"failures": (), "healings": ()})
    intact = run_sim_trial(SimTrial(robot=model, plan=plan, failure=None, world=whole))
    assert together[1].path_m[-1, 0] != intact.path_m[-1, 0]


#: Draws that a family cannot have, and what is named of each; `T` is a good time.
WRONG = {
    "{}": "at_s",
    "{at_s: {low: -1, high: 2}}": "at_s",
    "{T, legs: [0]}": "legs",
    "{T, legs: [2, 2]}": "legs",
    "{T, legs: []}": "legs",
    "{T, failure: [tired]}": "failure",
    "{T, failure: ['stuck:femur:30']}": "failure",
    "{T, failure: [unknown]}": "failure",
    "{T, torque_share: {low: 0, high: 2}}": "torque_share",
    "{T, heals_after_s: {low: 0, high: 0}}": "heals_after_s",
    "{T, share: 0}": "share",
    "{T, angle_deg: 3}": "angle_deg",
    "{T}, {T, legs: [4]}": "more legs than",
}


@pytest.mark.parametrize("draw", WRONG)
def test_a_draw_that_cannot_be_is_refused_by_its_key(tmp_path: Path, draw: str) -> None:
    path = _written(f"{HEAD}failures: [{draw.replace('T', 'at_s: {low: 1, high: 2}')}]\n", tmp_path)
    with pytest.raises(InputError, match=WRONG[draw]) as caught:
        load_randomization(path)
    assert "family.yaml" in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_leg_heals_after_it_has_failed(tmp_path: Path) -> None:
    soon = "failures: [{at_s: {low: 1, high: 2}, heals_after_s: {low: 0.02, high: 0.02}}]\n"
    family = load_randomization(_written(HEAD + soon, tmp_path))
    for world in family.members(0, 64):
        fails, heals = world.events
        assert 0.019 < heals.at_s - fails.at_s < 0.031


def test_failures_have_one_source(tmp_path: Path) -> None:
    both = "failures: [{at_s: {low: 1, high: 2}}]\nkinds: [{name: a, world: {failures: ['1:limp@1']}}]\n"
    with pytest.raises(InputError, match="of the kind a"):
        load_randomization(_written(HEAD + both, tmp_path))
