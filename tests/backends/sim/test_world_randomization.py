"""Families of worlds: the same members every time, spread evenly, and files that say what they mean."""

from collections import Counter
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from hexctl.backends.sim.draws import Distribution
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import (
    MAX_MEMBERS,
    DomainRandomization,
    World,
    load_randomization,
    load_world,
)
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import InputError
from hexctl.gait.gait import make_gait
from hexctl.study.priors.prior_options import WORLDS_PER_LEG
from hexctl.types import JOINT_KINDS, FloatArray
from tests.robots import shipped

FAMILIES = ("randomised", "transfer", "real")

#: The least that a file of a family says, and a time of a failure in it.
SMALL, TIME = "seed: 1\nranges:\n  friction: {low: 0.4, high: 1.0}\n", "at_s: {low: 1, high: 2}"

numbers = st.integers(0, MAX_MEMBERS - 1)


@cache
def family(name: str = "randomised") -> DomainRandomization:
    return load_randomization(name)


def _written(text: str, folder: Path) -> Path:
    path = folder / "family.yaml"
    path.write_text(text, encoding="utf-8")
    return path


def _values(worlds: list[World], key: str) -> FloatArray:
    """One quantity of some worlds, a column for each of its parts."""
    name, _, kind = key.partition(".")
    columns = np.array([np.atleast_1d(getattr(world, name)) for world in worlds])
    return columns[:, JOINT_KINDS.index(kind) :: 3] if kind else columns


def _shares(worlds: list[World], key: str, spread: Distribution) -> FloatArray:
    """Share of the family below each value, 0..1."""
    values = _values(worlds, key)
    if spread.scale == "log":
        return np.asarray(np.log(values / spread.low) / np.log(spread.high / spread.low))
    if spread.scale == "normal":
        from scipy.special import ndtr

        return np.asarray(ndtr((values - (spread.low + spread.high) / 2) / ((spread.high - spread.low) / 4)))
    return (values - spread.low) / (spread.high - spread.low)


@given(first=st.integers(0, MAX_MEMBERS - 8), count=st.integers(1, 8), at=st.integers(0, 7))
@settings(max_examples=5)
def test_a_member_is_the_same_whatever_it_is_asked_with(first: int, count: int, at: int) -> None:
    at = min(at, count - 1)
    for name in FAMILIES:
        members = family(name).members(first, count)
        assert members[at] == load_randomization(name).members(first + at, 1)[0]
        assert len(set(members)) == count


@pytest.mark.slow
@given(block=st.integers(0, MAX_MEMBERS // 16 - 1))
def test_each_sixteen_members_are_spread_evenly(block: int) -> None:
    """One in each sixteenth of every range, and so eight in each of its halves."""
    for name in FAMILIES:
        kinds_touch = {key for kind in family(name).kinds for key in kind.world}
        worlds = family(name).members(16 * block, 16)
        for key, spread in family(name).ranges.items():
            assert key not in kinds_touch
            shares = _shares(worlds, key, spread)
            assert ((shares < 0.5).sum(axis=0) == 8).all(), (name, key)
            sixteenths = np.sort(np.floor(shares * 16), axis=0)
            assert (sixteenths == np.arange(16)[:, np.newaxis]).all(), (name, key)


@given(block=st.integers(0, MAX_MEMBERS // 16 - 1))
def test_what_belongs_to_a_member_and_not_to_its_world_is_spread_as_evenly(block: int) -> None:
    spread = Distribution(low=-4.0, high=4.0)
    spare = family().spare(spread, 16 * block, 16)
    assert sorted(np.floor((spare + 4) * 2).tolist()) == list(range(16))
    assert spare[5] == family().spare(spread, 16 * block + 5, 1)[0]


def test_kinds_take_turns() -> None:
    transfer = family("transfer")
    names = [transfer.kind(number).name for number in range(20)]
    assert names[:10] == ["plain", "rough", "plain", "backlash", "plain", "delay", "plain", "wavy",
                          "plain", "timestep"]  # fmt: skip
    assert names[10:] == names[:10]
    for first in (0, 10, 7):
        for number, world in enumerate(transfer.members(first, 10), first):
            plain = {key: getattr(World(), key) for key in World.model_fields if key not in transfer.ranges}
            wanted = plain | transfer.kind(number).world
            assert {key: getattr(world, key) for key in wanted} == wanted


def test_a_kind_comes_before_a_range(tmp_path: Path) -> None:
    text = SMALL + "kinds: [{name: plain}, {name: icy, world: {friction: 0.05}}]\n"
    first, icy, third = load_randomization(_written(text, tmp_path)).members(0, 3)
    assert icy.friction == 0.05
    assert min(first.friction, third.friction) >= 0.4


@pytest.mark.parametrize(
    ("scale", "shares", "values"),
    [
        ("even", [0.0, 0.25, 1.0], [0.5, 0.875, 2.0]),
        ("log", [0.0, 0.5, 1.0], [0.5, 1.0, 2.0]),
        ("normal", [0.02275, 0.5, 0.97725], [0.5, 1.25, 2.0]),
    ],
)
def test_a_scale_says_how_a_range_is_filled(scale: str, shares: list[float], values: list[float]) -> None:
    spread = Distribution.model_validate({"low": 0.5, "high": 2.0, "scale": scale})
    np.testing.assert_allclose(spread.at(np.array(shares)), values, atol=1e-4)
    one = Distribution.model_validate({"low": 0.7, "high": 0.7, "scale": scale})
    np.testing.assert_allclose(one.at(np.array([0.0, 0.3, 1.0])), 0.7)


def test_a_member_is_a_world_by_name_or_path(tmp_path: Path) -> None:
    for name in FAMILIES:
        for number in (7, MAX_MEMBERS - 1):
            assert load_world(f"{name}:{number}") == family(name).members(number, 1)[0]
    path = _written(SMALL, tmp_path)
    assert load_world(f"{path}:3") == load_randomization(path).members(3, 1)[0]


@pytest.mark.parametrize(
    ("name", "named"),
    [
        ("randomised", "randomised:7"),
        *((f"randomised:{number}", f"'randomised:{number}'") for number in ("x", "", "-1", "1.5")),
        (f"randomised:{MAX_MEMBERS}", f"0..{MAX_MEMBERS - 1}"),
        ("randomised:99999999999999999999", "number of a member"),
        ("flat:3", "flat.yaml"),
        ("mars:3", "unknown world 'mars'"),
        (":7", "unknown world ''"),
    ],
)
def test_a_member_that_is_not_there_is_refused(name: str, named: str) -> None:
    with pytest.raises(InputError, match=named):
        load_world(name)


@pytest.mark.parametrize(("first", "count"), [(-1, 1), (0, 0), (MAX_MEMBERS - 1, 2), (MAX_MEMBERS, 1)])
def test_members_that_a_family_does_not_have_are_refused(first: int, count: int) -> None:
    with pytest.raises(InputError, match=f"0..{MAX_MEMBERS - 1}"):
        family().members(first, count)


#: Ranges that a family cannot have, and what is named of each.
WRONG_RANGES = {
    "friction: {low: 1, high: 0.4}": "ranges.friction",
    "friction: {low: -1, high: 1, scale: log}": "log",
    "friction: {low: .nan, high: 1}": "ranges.friction.low",
    "friction: {low: 1, high: 2, scale: cubic}": "cubic",
    "friction: {low: -1, high: 1}": "friction",
    "fricton: {low: 0.4, high: 1}": "fricton",
    "friction_cone: {low: 0, high: 1}": "friction_cone",
    "friction.coxa: {low: 1, high: 2}": "friction.coxa",
    "joint_friction_nm.coxa: {low: 0.1, high: 0.2}": "joint_friction_nm.coxa",
    "joint_stiffness: {low: 1, high: 2}, joint_stiffness.tibia: {low: 1, high: 2}": "joint_stiffness.tibia",
    "joint_stiffness.knee: {low: 1, high: 2}": "joint_stiffness.knee",
}

#: Draws that a family cannot have, and what is named of each; `T` is a good time.
WRONG_DRAWS = {
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

WRONG_FAMILIES = {
    **{f"seed: 1\nranges: {{{ranges}}}": named for ranges, named in WRONG_RANGES.items()},
    "seed: 1\n": "ranges",
    "": "ranges",
    SMALL.removeprefix("seed: 1\n"): "seed",
    SMALL.replace("seed: 1", "seed: -1"): "seed",
    SMALL + "kindz: []": "kindz",
    SMALL + "kinds: []": "kinds",
    SMALL + "kinds: [{name: a, world: {fricton: 1}}]": r"kinds\[0\].world.fricton",
    SMALL + "kinds: [{name: a}, {name: b, world: {friction: -1}}]": r"kinds\[1\].world.friction",
    SMALL
    + f"failures: [{{{TIME}}}]\nkinds: [{{name: a, world: {{failures: ['1:limp@1']}}}}]": "of the kind a",
    **{f"{SMALL}failures: [{draw.replace('T', TIME)}]": named for draw, named in WRONG_DRAWS.items()},
}


@pytest.mark.parametrize("text", WRONG_FAMILIES)
def test_a_bad_family_is_refused_with_file_and_key(text: str, tmp_path: Path) -> None:
    path = _written(text, tmp_path)
    with pytest.raises(InputError, match=WRONG_FAMILIES[text]) as refused:
        load_randomization(path)
    assert str(refused.value).startswith(f"{path}: ")
    assert "\n" not in str(refused.value)


def test_a_range_of_one_joint_kind_leaves_the_other_joints_as_they_are(tmp_path: Path) -> None:
    text = "seed: 1\nranges: {joint_stiffness.tibia: {low: 0.5, high: 0.9}}"
    (world,) = load_randomization(_written(text, tmp_path)).members(3, 1)
    stiffness = np.reshape(world.joint_stiffness, (6, 3))
    assert (stiffness[:, :2] == 1).all()
    assert len(set(stiffness[:, 2].tolist())) == 6
    assert ((stiffness[:, 2] >= 0.5) & (stiffness[:, 2] <= 0.9)).all()


def test_the_joints_of_real_robots_are_as_stiff_as_those_measured() -> None:
    """Hips of 22 to 79 and knees of 10 to 24 N m/rad, on a file's 18."""
    worlds = family("real").members(0, 256)
    joints = np.array(
        [18 * world.servo_stiffness * np.reshape(world.joint_stiffness, (6, 3)) for world in worlds]
    )
    hips, knees = joints[..., :2], joints[..., 2]
    assert hips.min() == pytest.approx(22, abs=1)
    assert hips.max() == pytest.approx(79, abs=3)
    assert knees.min() == pytest.approx(10, abs=0.5)
    assert knees.max() == pytest.approx(24, abs=1)


def _worlds_of_legs(name: str, count: int) -> Iterator[World]:
    """Give the first worlds of each leg of a prior."""
    for leg in range(6):
        yield from family(name).members(leg * WORLDS_PER_LEG, count)


def test_no_world_that_a_prior_is_tried_on_is_one_that_it_was_built_from() -> None:
    built_from = set(_worlds_of_legs("randomised", 64))
    assert len(built_from) == 6 * 64
    for name in ("transfer", "real"):
        tried_on = set(_worlds_of_legs(name, 64)) | set(family(name).members(0, 256))
        assert built_from.isdisjoint(tried_on)


def test_a_prior_is_tried_on_wider_ranges_and_other_kinds_than_it_was_built_from() -> None:
    built, tried = family("randomised"), family("transfer")
    assert built.ranges.keys() == tried.ranges.keys()
    for key, spread in built.ranges.items():
        assert tried.ranges[key].low <= spread.low, key
        assert tried.ranges[key].high >= spread.high, key
        assert tried.ranges[key].scale == spread.scale, key
    others = [kind for kind in tried.kinds if kind.world]
    assert len(others) == len(tried.kinds) / 2
    for kind in others:
        assert not built.ranges.keys() & kind.world.keys(), "no range makes such a world"
        assert World.model_validate(kind.world) != World()


# Failures that are drawn.

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
    family = load_randomization(_written(SMALL, tmp_path))
    assert family.model_dump(mode="json")["failures"] == []
    again = type(family).model_validate(load_randomization("failing").model_dump(mode="json"))
    assert again.members(5, 3) == load_randomization("failing").members(5, 3)


@pytest.mark.slow
def test_batches_and_single_simulations_get_what_was_drawn(tmp_path: Path) -> None:
    path = _written(FULL, tmp_path)
    (event, *_) = load_world(f"{path}:4").events
    model = shipped()
    with SimServos(model, world=f"{path}:4") as servos:
        servos.walk_begins()
        for _ in range(6):
            servos.clock.tick()
        assert [failure.leg for failure in servos.failures] == [event.leg]
    plan = TrialPlan(gait=make_gait(model, "tripod"), duration_s=1.5)
    trials = [SimTrial(robot=model, plan=plan, failures=None, world=f"{path}:{n}") for n in (3, 4, 5)]
    together = run_sim_trials(trials, threads=1)
    assert together[1] == run_sim_trial(trials[1])
    whole = trials[1].world.model_copy(update={"failures": (), "healings": ()})
    intact = run_sim_trial(SimTrial(robot=model, plan=plan, failures=None, world=whole))
    assert together[1].path_m[-1, 0] != intact.path_m[-1, 0]


def test_a_leg_heals_after_it_has_failed(tmp_path: Path) -> None:
    soon = "failures: [{at_s: {low: 1, high: 2}, heals_after_s: {low: 0.02, high: 0.02}}]\n"
    family = load_randomization(_written(SMALL + soon, tmp_path))
    for world in family.members(0, 64):
        fails, heals = world.events
        assert 0.019 < heals.at_s - fails.at_s < 0.031
