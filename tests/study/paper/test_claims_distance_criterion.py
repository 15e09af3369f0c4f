"""The project's own bar."""

import numpy as np
import pytest

from hexctl.study.frames import where
from hexctl.study.paper.claims import bars_of
from hexctl.study.paper.searches import ALL, FRESH, PAPER
from tests.study.made_up import made_up_findings, spread_out

SIGNS = np.where(np.arange(120) % 2, 1.0, -1.0)


@pytest.mark.slow
def test_the_bar_is_the_mean_of_what_each_leg_allows() -> None:
    good = bars_of(made_up_findings(spread_out(0.25, SIGNS), runs=5))
    fresh = where(good, count=FRESH)
    assert len(fresh) == 6 * 2 * 7
    assert where(fresh, leg=ALL)["holds"].all()
    assert set(fresh["limit_m"].round(9)) == {0.10, 0.025}
    findings = made_up_findings(0.5 + spread_out(3.0), runs=5)
    late = where(bars_of(findings), count=PAPER, evaluations=60)
    assert late["limit_m"].to_numpy() == pytest.approx(findings.rotated(1).best_m + 0.01)
    missed = late[~late["holds"].astype(bool)]
    assert missed["over_m"].to_numpy() == pytest.approx((missed["mean_m"] - missed["limit_m"]).to_numpy())
    assert len(missed)
    assert (missed["over_m"] > 0).all()


def test_no_bar_beyond_the_budget() -> None:
    findings = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=30)
    assert set(bars_of(findings)["evaluations"]) == {20}
    nothing = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=3)
    assert bars_of(nothing).empty


def test_short_walks_have_no_verdict() -> None:
    findings = made_up_findings(spread_out(0.25, SIGNS), legs=(1, 2), runs=2, duration_s=0.5)
    bars = bars_of(findings)
    assert set(bars["holds"]) == {None}
    assert set(bars["verdict"]) == {"not judged: walks of 0.5 s, needs at least 30 s"}
