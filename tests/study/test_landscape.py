"""Landscapes and searches in them: rows, scores, curves, and which legs are one experiment."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES
from hexctl.adapt.optimizers.deduplication import Deduplication
from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.backends.sim.world import World
from hexctl.control.batch import run_sim_trial, run_sim_trials
from hexctl.control.body_symmetry import body_symmetries
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import SelfRotation
from hexctl.control.trial_result import QUALITIES
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.paper.leg_groups import experiments_of, image_of, is_mirror_of, landscape_by_symmetry
from hexctl.study.paper.searches import curve_of, search_landscape
from hexctl.study.walk_cache import WalkCache
from tests.robots import shipped
from tests.study.made_up import made_up, spec, spread_out

CODES = (3, 40, 77, 120)


@pytest.fixture(scope="module")
def one() -> Landscape:
    asked = spec(5, "none", 3.0, CODES)
    return Landscape.of(asked, asked.walk(CODES))


@pytest.mark.slow
def test_rows_are_those_of_the_trials_alone(one: Landscape) -> None:
    for row, code in enumerate(CODES):
        alone = run_sim_trial(one.spec.trial(code))
        assert alone.deviation is not None
        assert one.status[row] == alone.status
        expected = [
            alone.deviation.signed,
            alone.distance_m,
            alone.yaw_change_rad,
            *(getattr(alone, name) for name in QUALITIES),
        ]
        assert one.numbers[row].tolist() == expected
        assert one.paths_m[row].tolist() == alone.path_m[9::10].astype(np.float32).tolist()
        assert one.paths_m[row, -1, 1] == np.float32(alone.deviation.signed)


@pytest.mark.slow
def test_walks_are_kept_to_the_last_bit(one: Landscape, tmp_path: Path) -> None:
    walks = one.spec.walk(CODES)
    cache = WalkCache(tmp_path)
    cache.save(one.spec, walks)
    assert repr(list(cache.load(one.spec).values())) == repr(walks)


@pytest.mark.slow
def test_scores_are_those_that_an_optimizer_is_told() -> None:
    asked = spec(2, "none", 6.0, CODES)
    results = [run_sim_trial(asked.trial(code)) for code in CODES]
    landscape = Landscape.of(asked, asked.walk(CODES))
    assert landscape.scores.tolist() == [OBJECTIVES["final"](result) for result in results]


def test_invalid_gaits_are_behind_all_others_and_never_the_best() -> None:
    landscape = made_up(5, "rear", np.linspace(0, 1, 120), invalid=[1, 2])
    assert landscape.scores[:2].tolist() == [INVALID_SCORE] * 2
    assert landscape.best_m == pytest.approx(2 / 119)
    assert np.isnan(made_up(5, "rear", spread_out(1.0), invalid=range(1, 121)).best_m)


def placed(
    leg: int, self_rotation: SelfRotation, *, miss_deg: float = 0.0, duration_s: float = 0.4
) -> LandscapeSpec:
    asked = spec(leg, self_rotation, duration_s, CODES)
    return replace(asked, placed=True, miss_rad=math.radians(miss_deg))


def _off_rad(angle_rad: float, requested_rad: float) -> float:
    return abs(math.remainder(angle_rad - requested_rad, math.tau))


@pytest.mark.slow
@pytest.mark.parametrize(("self_rotation", "points_to_deg"), [("rear", 180.0), ("front", 0.0)])
@pytest.mark.parametrize("miss_deg", [0.0, 6.0])
@pytest.mark.parametrize("leg", [1, 2, 5])
def test_a_robot_that_is_put_down_stands_as_its_self_rotation_would_leave_it(
    leg: int, self_rotation: SelfRotation, points_to_deg: float, miss_deg: float
) -> None:
    trial, log = placed(leg, self_rotation, miss_deg=miss_deg, duration_s=0.1).trial(3), TickLog()
    with trial.servos() as servos:
        result = run_trial(Guard(servos), trial.plan, recorders=(log,), soft_stop=False)
    assert log.frame is not None
    assert log.rows_of("turn") == slice(0, 0)
    assert result.turned_rad == 0.0
    leg_points_to_rad = log.frame.yaw_rad + float(shipped().leg_azimuths_rad[leg - 1])
    assert _off_rad(leg_points_to_rad, math.radians(points_to_deg + miss_deg)) < math.radians(0.5)
    assert _off_rad(log.frame.heading_rad, 0.0) < math.radians(0.5), "it still travels along the world's x"


@pytest.mark.slow
def test_robots_put_down_differently_do_not_share_a_start() -> None:
    trials = [
        placed(5, "rear", miss_deg=miss_deg).trial(code) for miss_deg in (-3.0, 3.0) for code in (3, 40)
    ]
    trials.append(replace(trials[0], facing_rad=0.5))
    assert len({trial.shared_start() for trial in trials}) == 3
    for made, alone in zip(run_sim_trials(trials), map(run_sim_trial, trials), strict=True):
        assert made.to_dict() == alone.to_dict()
        np.testing.assert_array_equal(made.path_m, alone.path_m)


def brute_force(landscape: Landscape, name: str, seed: int, budget: int) -> list[float]:
    """The best valid deviation after each evaluation, step by step and without arrays."""
    search = Deduplication(make_optimizer(name, landscape.spec.space, seed), seed, paper_count=True)
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


@pytest.mark.parametrize("name", ["pso", "psosp", "dps", "debest", "derand", "random", "exhaustive"])
def test_curves_are_those_of_a_step_by_step_search(name: str) -> None:
    landscape = made_up(5, "rear", spread_out(2.0), invalid=range(1, 100, 2))
    for run in search_landscape(landscape, name, range(5000, 5004), 130):
        np.testing.assert_array_equal(run["best_m"], brute_force(landscape, name, run["seed"], 130))


def test_statistics_leave_out_runs_without_a_valid_gait() -> None:
    from pandas import DataFrame

    nan = math.nan
    runs = ([nan, 3.0, 1.0], [nan, nan, 2.0], [nan, 5.0, 3.0])
    found: Any = curve_of(DataFrame({"best_m": list(map(np.array, runs))}))
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


def test_the_image_of_an_image_is_the_landscape() -> None:
    """The mirroring puts leg 2 in the place of leg 6."""
    (mirror,) = [one for one in body_symmetries(shipped()) if one.mirrored and one.keeps_heading]
    landscape = made_up(2, "none", spread_out(2.0, np.where(np.arange(120) % 3, 1.0, -1.0)))
    image = image_of(landscape, mirror)
    assert (image.spec.leg, image.final_m.sum()) == (6, pytest.approx(landscape.final_m.sum()))
    back = image_of(image, mirror)
    np.testing.assert_array_equal(back.number("signed_m"), landscape.number("signed_m"))
    np.testing.assert_array_equal(back.paths_m, landscape.paths_m)
    assert landscape_by_symmetry([landscape], 6).spec.leg == 6
    with pytest.raises(KeyError):
        landscape_by_symmetry([landscape], 3)
