"""The benchmarks: rows and bars, what trials bring to steered walks, and what stops a robot."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.causes import DEFECTS, cause_rows
from benchmarks.check import make_legs_solid
from benchmarks.rows import Bar, Count, Row
from benchmarks.scale import QUICK
from benchmarks.search_gain import (
    AFTER,
    END_POINTS,
    FAMILY,
    OPEN_LOOP,
    OPEN_LOOP_PRIOR,
    OpenLoop,
    fast_lines,
    losses,
    open_loop_lines,
    regrets,
    searches,
    session_scores,
    specs,
    table,
)
from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import drift_samples_of
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.sim.world import World, load_randomization
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.control.trial_result import Deviation
from hexctl.robot.model import Robot
from hexctl.study.landscape import NUMBERS, Landscape
from hexctl.types import FloatArray
from tests.adapt.priors import made_up_score_prior
from tests.adapt.walking import result_of
from tests.control.assessment.loads import moved_together
from tests.robots import shipped
from tests.study.made_up import made_up_in

DISTANCE = NUMBERS.index("distance_m")


def landscape(way_m: FloatArray, invalid: tuple[int, ...] = (), leg: int = 5) -> Landscape:
    """Steered walks of some ways, the last second of which is straight on."""
    (asked,) = [spec for spec in specs(shipped(), load_randomization(FAMILY), 300, 5) if spec.leg == leg]
    made = made_up_in(replace(asked, duration_s=6.0), np.zeros(120), invalid)
    made.numbers[:, DISTANCE] = way_m
    made.paths_m[:, -END_POINTS:, 0] = way_m[:, np.newaxis]
    return made


def test_each_world_has_one_locked_leg_on_its_line_and_the_sensors_of_the_comparison() -> None:
    asked = specs(shipped(), load_randomization(FAMILY), 300, 8)
    assert [spec.leg for spec in asked] == [1, 2, 3, 4, 5, 6, 1, 2]
    assert [spec.seed for spec in asked] == list(range(300, 308))
    assert {(spec.hold, spec.self_rotation, spec.failure) for spec in asked} == {("line", "none", "locked")}
    assert {spec.world.lost_poses for spec in asked} == {0.05}
    assert asked[1].trial(1).plan.gait.posture.body_raise == STAND_UP


def test_a_loss_is_against_the_fastest_valid_gait() -> None:
    way_m = np.linspace(2.0, 4.0, 120)
    made = landscape(way_m, invalid=(120,))
    assert losses(made)[118] == 0.0
    assert losses(made)[0] == pytest.approx(1 - 2.0 / way_m[118])
    assert losses(made)[119] == 1.0
    assert session_scores(made)[119] == INVALID_SCORE
    assert session_scores(made)[0] == pytest.approx(6.0 / 2.0)


def test_regrets_begin_with_the_gait_auto_and_never_grow() -> None:
    way_m = np.random.default_rng(0).uniform(2, 4, 120)
    found = regrets(landscape(way_m), [*range(1, 11)])
    assert len(found) == len(AFTER)
    assert found == sorted(found, reverse=True)
    assert regrets(landscape(way_m), [int(np.argmax(way_m)) + 1] * 10)[1:] == [0.0] * (len(AFTER) - 1)


def test_a_prior_that_knows_the_gaits_is_ahead_of_chance_and_of_a_shuffled_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr("benchmarks.search_gain.RUNS", 5)
    prior = made_up_score_prior(legs=(5,), worlds=4)
    unseen = made_up_score_prior(legs=(5,), worlds=1, seed=8).log_scores[0, 0, :, 0]
    rows = table(prior, [landscape(6.0 / np.exp(unseen))])
    assert list(rows) == ["order of the prior", "bayes", "random", "bayes, codes of the prior shuffled"]
    third = AFTER.index(3)
    assert rows["bayes"][0, third] < 0.5 * rows["random"][0, third]
    assert rows["bayes"][0, third] < 0.5 * rows["bayes, codes of the prior shuffled"][0, third]
    assert {values[0, 0] for values in rows.values()} == {rows["bayes"][0, 0]}, "auto is auto"
    assert [runs for runs, _ in searches(prior, shipped(), 5).values()] == [1, 5, 5]


def test_an_open_loop_search_counts_every_walk_until_one_is_confirmed() -> None:
    known = drift_samples_of(load_prior(shipped_priors() / OPEN_LOOP_PRIOR), shipped(), 5)
    one = OpenLoop(number=1, world=World(), leg=5, search=OPEN_LOOP["trim"](known, range(1, 121)))
    trims = []
    for off_m in (0.3, 0.01, 0.03, 0.02, 0.02):
        plan = one.trial().plan
        trims.append(plan.trim_rad)
        walk = replace(result_of(off_m), trim_rad=plan.trim_rad, turn_trim_rad_s=plan.turn_trim_rad_s)
        one.take(replace(walk, true_deviation=Deviation(off_m + 0.01, 0.1, 0.1, off_m)))
    assert (trims[1], trims[3]) == (trims[2], trims[4])
    assert one.confirmed == 5
    assert [one.best_m(walks) for walks in (1, 2)] == pytest.approx([0.31, 0.02])
    assert open_loop_lines([one])[-1] == "confirmed: 100%, after 5 walks (median)"


def test_fast_walks_are_compared_world_by_world() -> None:
    walked = replace(result_of(0.01), true_deviation=result_of(0.01).deviation)
    usual = [replace(walked, distance_m=way_m) for way_m in (1.0, 1.0, 2.0, 2.0, 2.0, 2.0)]
    fast = [replace(one, distance_m=1.5 * (one.distance_m or 0.0), clipped_ticks=3) for one in usual]
    lines = fast_lines(usual, fast)
    assert lines[0] == "speed over the usual: 1.50 ± 0.00"
    assert lines[2].startswith("fast: 0 of 6 not ok, 3.0 clipped")


def test_a_row_without_a_value_does_not_clear_its_bar() -> None:
    assert Row("x", None, "gaits", Bar(low=1)).as_json()["holds"] is False


def test_the_verdict_is_of_the_value_before_rounding() -> None:
    row = Row("x", 1.250004, "ratio", Bar(high=1.25))
    assert row.as_json()["value"] == 1.25
    assert row.holds is False


@pytest.mark.parametrize(
    ("count", "interval"),
    [
        (Count(31, 35), (0.740, 0.955)),
        (Count(0, 20), (0.0, 0.161)),
        (Count(20, 20), (0.839, 1.0)),
        (Count(0, 0), (0.0, 1.0)),
    ],
)
def test_intervals_hold_without_a_failure_and_without_a_robot(
    count: Count, interval: tuple[float, float]
) -> None:
    assert count.interval == pytest.approx(interval, abs=0.001)


def legs_in_contact(robot: Robot, *, solid: bool) -> int:
    """Contacts between two legs of a robot in its stance, after one control period."""
    with SimServos(robot) as servos:
        if solid:
            make_legs_solid(servos)
        servos.clock.tick()
        servos.read()
        physics = servos.compiled.physics
        names = [
            [physics.model.id2name(geom, "geom") for geom in (contact.geom1, contact.geom2)]
            for contact in physics.data.contact
        ]
    return sum(all("/leg" in name for name in pair) for pair in names)


def test_solid_legs_touch_where_others_pass_through() -> None:
    crowded = moved_together(0.05)
    assert legs_in_contact(crowded, solid=False) == 0
    assert legs_in_contact(crowded, solid=True) > 0
    assert legs_in_contact(moved_together(1.0), solid=True) == 0


@pytest.mark.slow
def test_the_defect_of_a_robot_is_found() -> None:
    rows = {row.name: row for row in cause_rows(replace(QUICK, walk_s=15.0))}
    assert rows.keys() == {f"check.causes.{defect}" for defect in DEFECTS}
    for row in rows.values():
        assert row.value == 1.0, row.note
        assert "1 of 1 named" in row.note
