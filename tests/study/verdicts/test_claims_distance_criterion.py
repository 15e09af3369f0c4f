"""The project's own bar."""

import numpy as np
import pytest

from hexctl.study.verdicts.claims import bar_rows
from tests.study.made_up import made_up_findings, spread_out

SIGNS = np.where(np.arange(120) % 2, 1.0, -1.0)


def test_the_bar_is_the_mean_of_what_each_leg_allows() -> None:
    good = made_up_findings(spread_out(0.25, SIGNS), runs=5)
    rows = bar_rows(good, paper_count=False)
    assert len(rows) == 6 * 2 * 7
    assert all(row.holds for row in rows if row.leg is None)
    assert {round(row.limit_m, 9) for row in rows} == {0.10, 0.025}
    bad = made_up_findings(0.5 + spread_out(3.0), runs=5)
    late = [row for row in bar_rows(bad, paper_count=True) if row.evaluations == 60]
    best = bad.rotated(1).best_m
    assert [row.limit_m for row in late] == [pytest.approx(best + 0.01)] * len(late)
    row = next(row for row in late if not row.holds)
    assert row.over_m == pytest.approx(row.mean_m - row.limit_m)
    assert row.over_m > 0


def test_no_bar_beyond_the_budget() -> None:
    findings = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=30)
    assert {row.evaluations for row in bar_rows(findings, paper_count=False)} == {20}


def test_short_walks_have_no_verdict() -> None:
    findings = made_up_findings(spread_out(0.25, SIGNS), legs=(1, 2), runs=2, duration_s=0.5)
    rows = bar_rows(findings, paper_count=False)
    assert {(row.holds, row.verdict) for row in rows} == {
        (None, "not judged: walks of 0.5 s, needs at least 30 s")
    }
