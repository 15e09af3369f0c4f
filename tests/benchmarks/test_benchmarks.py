"""The benchmarks: rows and bars, and what trials bring to walks."""

from dataclasses import replace

import pytest

from benchmarks.rows import Bar, Row
from benchmarks.search_gain import OPEN_LOOP, OPEN_LOOP_PRIOR, OpenLoop, fast_lines, open_loop_lines
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import drift_samples_of
from hexctl.backends.sim.world import World
from hexctl.control.trial_result import Deviation
from tests.adapt.walking import result_of
from tests.robots import shipped


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
