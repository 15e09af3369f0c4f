"""Searches in landscapes: their curves and statistics, and which legs are one experiment."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.optimizers.shipped import OPTIMIZERS
from hexctl.backends.sim.world import World
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.study.data_frames import where
from hexctl.study.landscape import Landscape
from hexctl.study.paper.leg_groups import experiments_of, image_of, is_mirror_of, landscape_by_symmetry
from hexctl.study.paper.searches import FRESH, PAPER, curve_of, search_landscape
from tests.robots import shipped
from tests.study.made_up import made_up, spread_out

SEEDS = (5000, 5001, 5002, 5003)

INVALID = range(1, 100, 2)


@pytest.fixture(scope="module")
def landscape() -> Landscape:
    return made_up(5, "rear", spread_out(2.0), invalid=list(INVALID))


def brute_force(landscape: Landscape, name: str, seed: int, budget: int, *, paper_count: bool) -> list[float]:
    """The best valid deviation after each evaluation, step by step and without arrays."""
    search = Deduplication(make_optimizer(name, landscape.spec.space, seed), seed, paper_count=paper_count)
    best, curve = math.nan, []
    for _ in range(budget):
        if not search.exhausted:
            (code,) = search.ask(1)
            final_m = abs(float(landscape.number("signed_m")[code - 1]))
            valid = landscape.status[code - 1] == "ok"
            search.tell([code], [final_m if valid else INVALID_SCORE])
            if valid and not best <= final_m:
                best = final_m
        curve.append(best)
    return curve


@pytest.mark.parametrize("name", list(OPTIMIZERS))
def test_curves_are_those_of_a_step_by_step_search(landscape: Landscape, name: str) -> None:
    for run in search_landscape(landscape, name, SEEDS, 130):
        paper_count = run["count"] == PAPER
        expected = brute_force(landscape, name, run["seed"], 130, paper_count=paper_count)
        np.testing.assert_array_equal(run["best_m"], expected)


def by_count(landscape: Landscape, name: str, seeds: Sequence[int], budget: int) -> list[Any]:
    from pandas import DataFrame

    runs = DataFrame(search_landscape(landscape, name, seeds, budget))
    return [where(runs, count=count) for count in (FRESH, PAPER)]


def test_the_fresh_count_pays_for_each_code_once_and_ends_with_all(landscape: Landscape) -> None:
    fresh, paper = by_count(landscape, "pso", SEEDS, 130)
    assert [np.unique(codes[codes > 0]).size for codes in fresh["codes"]] == [120] * 4
    assert all((codes[120:] == 0).all() for codes in fresh["codes"])
    assert {best_m[-1] for best_m in fresh["best_m"]} == {landscape.best_m}
    assert all(np.unique(codes).size < 120 for codes in paper["codes"])
    assert all((codes > 0).all() for codes in paper["codes"])


def curve(best_m: list[list[float]]) -> Any:
    from pandas import DataFrame

    return curve_of(DataFrame({"best_m": [np.array(run) for run in best_m]}))


def test_statistics_leave_out_runs_without_a_valid_gait() -> None:
    nan = math.nan
    found = curve([[nan, 3.0, 1.0], [nan, nan, 2.0], [nan, 5.0, 3.0]])
    np.testing.assert_allclose(found["mean_m"], [nan, 4.0, 2.0])
    np.testing.assert_allclose(found["median_m"], [nan, 4.0, 2.0])
    np.testing.assert_allclose(found["std_m"], [nan, 1.0, math.sqrt(2 / 3)])
    np.testing.assert_allclose(found["p10_m"], [nan, 3.2, 1.2])
    np.testing.assert_allclose(found["share_of_runs"], [0, 2 / 3, 1])


LEGS = range(1, 7)

ALONE = tuple((leg,) for leg in LEGS)

ALL_LEGS = ((1, 2, 3, 4, 5, 6),)

MIRRORED = ((1,), (2, 6), (3, 5), (4,))


@pytest.mark.parametrize(
    ("world", "rotated", "straight"),
    [
        ({}, ALL_LEGS, MIRRORED),
        ({"slope_deg": 5.0}, ALL_LEGS, MIRRORED),
        ({"slope_deg": 5.0, "slope_direction_deg": 90.0}, ALL_LEGS, ALONE),
        ({"roughness_m": 0.01}, ALL_LEGS, ALONE),
        ({"joint_offset_deg": 0.5}, ALONE, ALONE),
        ({"body_mass_shift_m": (0.01, 0.0, 0.0)}, MIRRORED, MIRRORED),
        ({"payload_kg": 1.0, "payload_position_m": (0.0, 0.02, 0.1)}, ((1, 4), (2, 3), (5, 6)), ALONE),
    ],
)
def test_legs_are_one_experiment_as_far_as_the_world_allows(
    world: dict[str, object], rotated: object, straight: object
) -> None:
    asked = World.model_validate(world)
    assert experiments_of(shipped(), asked, "rear", LEGS) == rotated
    assert experiments_of(shipped(), asked, "none", LEGS) == straight


def test_a_jammed_coxa_has_a_left_and_a_right() -> None:
    assert is_mirror_of(shipped(), World(), 1, 1, "none")
    assert not is_mirror_of(shipped(), World(), 1, 1, "none", "stuck:coxa:30")
    assert is_mirror_of(shipped(), World(), 1, 1, "none", "stuck:tibia:30")


def mirror() -> BodySymmetry:
    """The mirroring that puts leg 2 in the place of leg 6."""
    (found,) = [one for one in body_symmetries(shipped()) if one.mirrored and one.keeps_heading]
    return found


def test_the_image_of_an_image_is_the_landscape() -> None:
    landscape = made_up(2, "none", spread_out(2.0, np.where(np.arange(120) % 3, 1.0, -1.0)))
    image = image_of(landscape, mirror())
    assert (image.spec.leg, image.final_m.sum()) == (6, pytest.approx(landscape.final_m.sum()))
    back = image_of(image, mirror())
    np.testing.assert_array_equal(back.number("signed_m"), landscape.number("signed_m"))
    np.testing.assert_array_equal(back.paths_m, landscape.paths_m)


def test_legs_that_no_symmetry_reaches_have_no_image() -> None:
    second = made_up(2, "none", spread_out(1.0))
    assert landscape_by_symmetry([second], 6).spec.leg == 6
    with pytest.raises(KeyError):
        landscape_by_symmetry([second], 3)
