"""The symmetries of the shipped robots: as sets, as maps of gaits, and in simulated walks."""

import math
from functools import cache
from itertools import product

import numpy as np
import pytest

from hexctl.adapt.prior.symmetry import Symmetries, Symmetry
from hexctl.adapt.space import GaitSpace
from hexctl.backends.sim.world import World
from hexctl.control.batch import run_sim_trials
from hexctl.study.landscape import LandscapeSpec
from hexctl.study.prior import sag_of
from hexctl.types import FloatArray
from tests.robots import ROBOT_NAMES, shipped

HOW_MANY = {"ant": 12, "phantomx": 4, "pexod": 2}
LEGS = range(1, 7)


@cache
def symmetries(name: str) -> tuple[Symmetry, ...]:
    return Symmetries(shipped(name)).all


def each() -> list[Symmetry]:
    return list(dict.fromkeys(symmetry for name in ROBOT_NAMES for symmetry in symmetries(name)))


def ids(value: object) -> str:
    return f"{value.legs}{'m' if value.mirrored else ''}" if isinstance(value, Symmetry) else str(value)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_robot_has_as_many_symmetries_as_its_drawing(name: str) -> None:
    found = symmetries(name)
    assert len(found) == HOW_MANY[name]
    assert len(set(found)) == len(found)
    assert sum(symmetry.mirrored for symmetry in found) == len(found) // 2
    assert found[0] == Symmetry(tuple(LEGS), mirrored=False)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_left_and_right_change_places_in_every_robots_mirror(name: str) -> None:
    """Each robot is its own mirror image about its x axis: leg azimuths change their sign."""
    azimuths = shipped(name).leg_azimuths_rad
    (plain,) = [
        symmetry
        for symmetry in symmetries(name)
        if symmetry.mirrored
        and all(
            abs(math.remainder(azimuths[symmetry.legs[leg - 1] - 1] + azimuths[leg - 1], 2 * math.pi)) < 1e-6
            for leg in LEGS
        )
    ]
    assert plain.keeps_heading


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_only_that_mirror_and_the_identity_leave_forward_where_it_is(name: str) -> None:
    keeping = [symmetry for symmetry in symmetries(name) if symmetry.keeps_heading]
    assert [symmetry.mirrored for symmetry in keeping] == [False, True]
    assert keeping[0] == symmetries(name)[0]


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_a_turn_is_how_far_each_leg_comes(name: str) -> None:
    azimuths = shipped(name).leg_azimuths_rad
    for symmetry in symmetries(name):
        flip = -1 if symmetry.mirrored else 1
        for leg in LEGS:
            wanted = azimuths[symmetry.legs[leg - 1] - 1]
            off = math.remainder(flip * azimuths[leg - 1] + symmetry.turn_rad - wanted, 2 * math.pi)
            assert abs(off) < 1e-6


@pytest.mark.parametrize("symmetry", each(), ids=ids)
def test_every_leg_and_every_gait_has_one_place(symmetry: Symmetry) -> None:
    assert sorted(symmetry.legs) == list(LEGS)
    for leg in LEGS:
        codes = symmetry.codes(leg)
        assert sorted(codes.tolist()) == list(range(1, 121))


@pytest.mark.parametrize("symmetry", each(), ids=ids)
def test_a_moved_gait_has_the_same_lags_between_the_moved_legs(symmetry: Symmetry) -> None:
    for leg in LEGS:
        before, after = GaitSpace((leg,)), GaitSpace((symmetry.legs[leg - 1],))
        moved = after.slots[symmetry.codes(leg) - 1][:, np.array(symmetry.legs) - 1]
        shifts = (moved - before.slots) % 6
        np.testing.assert_array_equal(shifts, shifts[:, :1] * np.ones((1, 6), dtype=int))


@pytest.mark.parametrize("symmetry", each(), ids=ids)
def test_a_failed_leg_that_stays_keeps_the_phase_of_every_gait(symmetry: Symmetry) -> None:
    for leg in LEGS:
        assert symmetry.keeps_phase(leg) == (symmetry.legs[leg - 1] == leg)
        if not symmetry.keeps_phase(leg):
            continue
        space = GaitSpace((leg,))
        moved = space.slots[symmetry.codes(leg) - 1][:, np.array(symmetry.legs) - 1]
        np.testing.assert_array_equal(moved, space.slots)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_the_identity_leaves_every_gait_alone(name: str) -> None:
    for leg in LEGS:
        assert symmetries(name)[0].codes(leg).tolist() == list(range(1, 121))


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_one_symmetry_after_another_is_a_third(name: str) -> None:
    known = {(symmetry.legs, symmetry.mirrored): symmetry for symmetry in symmetries(name)}
    for first, second in product(symmetries(name), repeat=2):
        legs = tuple(second.legs[leg - 1] for leg in first.legs)
        both = known[legs, first.mirrored != second.mirrored]
        for leg in (1, 5):
            after_first = first.codes(leg)
            after_second = second.codes(first.legs[leg - 1])[after_first - 1]
            np.testing.assert_array_equal(both.codes(leg), after_second)


@pytest.mark.parametrize("name", ROBOT_NAMES)
def test_every_symmetry_can_be_undone(name: str) -> None:
    for symmetry in symmetries(name):
        back = [
            other
            for other in symmetries(name)
            if all(other.legs[symmetry.legs[leg - 1] - 1] == leg for leg in LEGS)
            and other.mirrored == symmetry.mirrored
        ]
        assert len(back) == 1
        for leg in LEGS:
            there, again = symmetry.codes(leg), back[0].codes(symmetry.legs[leg - 1])
            assert again[there - 1].tolist() == list(range(1, 121))


def test_a_leg_of_ant_serves_all_others_and_one_of_pexod_one() -> None:
    goals = {
        name: {symmetry.legs[1] for symmetry in symmetries(name)} for name in ("ant", "phantomx", "pexod")
    }
    assert goals == {"ant": {1, 2, 3, 4, 5, 6}, "phantomx": {2, 5}, "pexod": {2, 5}}


WORLD = World(
    slope_deg=1.5,
    slope_direction_deg=50.0,
    body_mass_shift_m=(0.01, 0.012, -0.004),
    joint_offset_deg=tuple(np.random.default_rng(3).normal(0, 1, 18).round(2).tolist()),
    added_mass_share=0.1,
    friction=0.7,
)


def mirrored(world: World, symmetry: Symmetry) -> World:
    """Return a world as it is seen in a mirror along the line of travel."""
    assert isinstance(world.joint_offset_deg, tuple)
    offsets: FloatArray = np.empty((6, 3))
    offsets[np.array(symmetry.legs) - 1] = np.array(world.joint_offset_deg).reshape(6, 3) * [-1, 1, 1]
    x, y, z = world.body_mass_shift_m
    return world.model_copy(
        update={
            "slope_direction_deg": -world.slope_direction_deg,
            "body_mass_shift_m": (x, -y, z),
            "joint_offset_deg": tuple(offsets.ravel().tolist()),
        }
    )


def walked(spec: LandscapeSpec, codes: list[int]) -> FloatArray:
    """Return signed deviation, progress and yaw of some gaits, (gaits, 3)."""
    results = run_sim_trials([spec.trial(code) for code in codes])
    assert all(result.status == "ok" for result in results)
    rows = [[result.path_m[-1, 1], result.path_m[-1, 0], result.yaw_change_rad] for result in results]
    return np.array(rows, dtype=float)


CODES = list(range(3, 121, 6))


@pytest.mark.parametrize("miss_rad", [0.0, 0.05])
def test_a_mirrored_world_gives_the_mirrored_walk(miss_rad: float) -> None:
    """The leg at the rear stays where it is in the mirror, so its gaits keep their phase."""
    (symmetry,) = [one for one in symmetries("ant") if one.mirrored and one.legs[3] == 4]
    spec = LandscapeSpec(
        robot=shipped(), world=WORLD, leg=4, self_rotation="rear", duration_s=3.0, placed=True,
        miss_rad=miss_rad,
    )  # fmt: skip
    image = LandscapeSpec(
        robot=shipped(), world=mirrored(WORLD, symmetry), leg=4, self_rotation="rear", duration_s=3.0,
        placed=True, miss_rad=-miss_rad,
    )  # fmt: skip
    moved = symmetry.codes(4)[np.array(CODES) - 1].tolist()
    assert moved != CODES
    true, seen = walked(spec, CODES), walked(image, moved)
    differences = np.abs(true * [-1, 1, -1] - seen).max(axis=1)
    # Contacts are chaotic: a few gaits may meet the floor another way at the last digit.
    assert np.median(differences) < 1e-5
    assert (differences < 1e-3).mean() >= 0.7
    # And the mirror is no formality: these walks do deviate.
    assert np.median(np.abs(true - seen).max(axis=1)) > 1e-2


def test_the_same_world_does_not_give_the_mirrored_walk() -> None:
    (symmetry,) = [one for one in symmetries("ant") if one.mirrored and one.legs[3] == 4]
    spec = LandscapeSpec(
        robot=shipped(), world=WORLD, leg=4, self_rotation="rear", duration_s=3.0, placed=True
    )
    moved = symmetry.codes(4)[np.array(CODES) - 1].tolist()
    true, same_world = walked(spec, CODES), walked(spec, moved)
    assert np.median(np.abs(true * [-1, 1, -1] - same_world).max(axis=1)) > 1e-3


def test_a_turned_robot_walks_nearly_the_same_with_another_leg_failed() -> None:
    """Turned by 60 degrees leg 5 is leg 4; the walk begins at another point of the cycle."""
    (symmetry,) = [one for one in symmetries("ant") if not one.mirrored and one.legs[4] == 4]
    plain = World(friction=0.7)
    five, four = (
        LandscapeSpec(
            robot=shipped(), world=plain, leg=leg, self_rotation="rear", duration_s=6.0, placed=True
        )
        for leg in (5, 4)
    )
    moved = symmetry.codes(5)[np.array(CODES) - 1].tolist()
    true, seen = walked(five, CODES), walked(four, moved)
    spread = true.std(axis=0)
    assert np.median(np.abs(true - seen), axis=0)[0] < 0.5 * spread[0]
    assert np.corrcoef(true[:, 0], seen[:, 0])[0, 1] > 0.8


def standing(world: World, leg: int) -> FloatArray:
    return sag_of(LandscapeSpec(robot=shipped(), world=world, leg=leg, self_rotation="rear"))


def test_a_mirrored_world_gives_the_mirrored_stance() -> None:
    (symmetry,) = [one for one in symmetries("ant") if one.mirrored and one.keeps_heading]
    true, seen = standing(WORLD, 2), standing(mirrored(WORLD, symmetry), symmetry.legs[1])
    np.testing.assert_allclose(symmetry.joints(true), seen, atol=1e-6)
    assert np.abs(true - seen).max() > 1e-3, "the mirror is no formality"


@pytest.mark.parametrize("symmetry", [one for one in symmetries("ant") if not one.mirrored], ids=ids)
def test_a_turned_payload_and_bent_joints_give_the_turned_stance(symmetry: Symmetry) -> None:
    """Not on a slope: the robot stands there as it is, and turns only then."""
    plain = WORLD.model_copy(update={"slope_deg": 0.0, "friction_cone": "elliptic"})
    x, y, z = plain.body_mass_shift_m
    cos, sin = math.cos(symmetry.turn_rad), math.sin(symmetry.turn_rad)
    turned = plain.model_copy(
        update={
            "body_mass_shift_m": (cos * x - sin * y, sin * x + cos * y, z),
            "joint_offset_deg": tuple(symmetry.joints(np.array(plain.joint_offset_deg)).tolist()),
        }
    )
    true, seen = standing(plain, 5), standing(turned, symmetry.legs[4])
    np.testing.assert_allclose(symmetry.joints(true), seen, atol=1e-4)
    assert symmetry.legs == tuple(LEGS) or np.abs(true - seen).max() > 1e-3
