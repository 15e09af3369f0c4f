"""Tests."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.objectives import INVALID_SCORE, OBJECTIVES
from hexctl.backends.sim.world import World
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.control.batch import SimTrial, run_sim_trial, run_sim_trials
from hexctl.control.guard import Guard
from hexctl.control.log import TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import SelfRotation
from hexctl.control.trial_result import QUALITIES, TrialResult
from hexctl.study.landscape import Landscape, LandscapeSpec
from hexctl.study.walk_cache import WalkCache
from tests.robots import shipped
from tests.study.made_up import made_up, spec, spread_out

pytestmark = pytest.mark.slow


CODES = (3, 40, 77, 120)


def walked(asked: LandscapeSpec) -> Landscape:
    return Landscape.of(asked, asked.walk(asked.codes))


@pytest.fixture(scope="module")
def one() -> Landscape:
    return walked(spec(5, "none", 3.0, CODES))


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


def test_walks_are_kept_to_the_last_bit(one: Landscape, tmp_path: Path) -> None:
    walks = one.spec.walk(CODES)
    cache = WalkCache(tmp_path)
    cache.save(one.spec, walks)
    assert repr(list(cache.load(one.spec).values())) == repr(walks)


def test_scores_are_those_that_an_optimizer_is_told() -> None:
    asked = spec(2, "none", 6.0, CODES)
    results = [run_sim_trial(asked.trial(code)) for code in CODES]
    assert walked(asked).scores.tolist() == [OBJECTIVES["final"](result) for result in results]


def test_invalid_gaits_are_behind_all_others_and_never_the_best() -> None:
    landscape = made_up(5, "rear", np.linspace(0, 1, 120), invalid=[1, 2])
    assert landscape.scores[:2].tolist() == [INVALID_SCORE] * 2
    assert landscape.best_m == pytest.approx(2 / 119)
    assert np.isnan(made_up(5, "rear", spread_out(1.0), invalid=range(1, 121)).best_m)


def test_another_question_has_another_fingerprint() -> None:
    asked = [spec(), spec(leg=4), spec(self_rotation="rear"), spec(duration_s=0.5), spec(seed=1),
             spec(codes=CODES), spec(world=World(friction=0.5)), replace(spec(), placed=True),
             *(replace(spec(), placed=True, miss_rad=miss_rad) for miss_rad in (0.1, -0.1))]  # fmt: skip
    asked.append(replace(spec(), hold="line"))
    assert len({each.fingerprint for each in asked}) == len(asked)
    assert spec().fingerprint == spec().fingerprint


def placed(
    leg: int, self_rotation: SelfRotation, *, miss_deg: float = 0.0, duration_s: float = 0.4
) -> LandscapeSpec:
    asked = spec(leg, self_rotation, duration_s, CODES)
    return replace(asked, placed=True, miss_rad=math.radians(miss_deg))


def _watched(trial: SimTrial) -> tuple[TrialResult, TickLog]:
    log = TickLog()
    with trial.servos() as servos:
        return run_trial(Guard(servos), trial.plan, recorders=(log,), soft_stop=False), log


def _off_rad(angle_rad: float, wanted_rad: float) -> float:
    return abs(math.remainder(angle_rad - wanted_rad, math.tau))


@pytest.mark.parametrize(("self_rotation", "points_to_deg"), [("rear", 180.0), ("front", 0.0)])
@pytest.mark.parametrize("miss_deg", [0.0, 6.0])
@pytest.mark.parametrize("leg", [1, 2, 5])
def test_a_robot_that_is_put_down_stands_as_its_self_rotation_would_leave_it(
    leg: int, self_rotation: SelfRotation, points_to_deg: float, miss_deg: float
) -> None:
    result, log = _watched(placed(leg, self_rotation, miss_deg=miss_deg, duration_s=0.1).trial(3))
    assert log.frame is not None
    assert log.rows_of("turn") == slice(0, 0)
    assert result.turned_rad == 0.0
    leg_points_to_rad = log.frame.yaw_rad + float(shipped().leg_azimuths_rad[leg - 1])
    assert _off_rad(leg_points_to_rad, math.radians(points_to_deg + miss_deg)) < math.radians(0.5)
    assert _off_rad(log.frame.heading_rad, 0.0) < math.radians(0.5), "it still travels along the world's x"


def test_robots_put_down_differently_do_not_share_a_start() -> None:
    trials = [
        placed(5, "rear", miss_deg=miss_deg).trial(code) for miss_deg in (-3.0, 3.0) for code in (3, 40)
    ]
    trials.append(replace(trials[0], facing_rad=0.5))
    assert len({trial.shared_start() for trial in trials}) == 3
    for made, alone in zip(run_sim_trials(trials), map(run_sim_trial, trials), strict=True):
        assert made.to_dict() == alone.to_dict()
        np.testing.assert_array_equal(made.path_m, alone.path_m)


@pytest.mark.parametrize(("leg", "body_raise"), [(2, STAND_UP), (4, 0.0)])
def test_a_landscape_under_a_hold_stands_up_off_a_leg_that_does_not_trail(
    leg: int, body_raise: float
) -> None:
    held = replace(spec(leg), hold="line")
    plan = held.trial(7).plan
    assert (plan.hold, plan.gait.posture.body_raise) == ("line", body_raise)
