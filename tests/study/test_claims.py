import numpy as np
import pytest

from hexctl.study.claims import Claim, bar_rows, claims_of, cm, expected_best_rank
from hexctl.study.searches import Findings
from tests.study.landscapes import made_up_findings, spread_out

CLAIMS = {
    "left": "moves to the left",
    "right": "moves to the right",
    "both": "goes straight or turns",
    "rotation": "After the self-rotation",
    "converges": "converge to about 2.5 cm",
    "flat": "fastest in the first 20",
    "minimal": "40 to 60",
    "early": "about 10 cm",
    "competitive": "competitive",
    "best": "keeps the direction",
}

SIGNS = np.where(np.arange(120) % 2, 1.0, -1.0)


@pytest.fixture(scope="module")
def good() -> Findings:
    """Many gaits near the line, and the sides that the paper saw."""
    return made_up_findings(spread_out(0.25, SIGNS), runs=5)


@pytest.fixture(scope="module")
def bad() -> Findings:
    """All gaits far off, and each leg on the wrong side."""
    wrong = {1: 1.0, 2: 0.5, 3: 0.0, 4: 0.0, 5: 1.0, 6: 0.5}
    return made_up_findings(0.5 + spread_out(3.0), wrong, runs=5)


def named(findings: Findings, key: str) -> Claim:
    (claim,) = [claim for claim in claims_of(findings) if CLAIMS[key] in claim.claim]
    return claim


def test_every_claim_is_there_once(good: Findings) -> None:
    assert len(claims_of(good)) == len(CLAIMS)
    assert all(claim.rule and claim.measured for claim in claims_of(good))


@pytest.mark.parametrize("key", list(CLAIMS))
def test_claims_that_hold(good: Findings, key: str) -> None:
    claim = named(good, key)
    assert (claim.holds, claim.verdict) == (True, "holds"), claim


@pytest.mark.parametrize("key", ["left", "right", "both", "rotation", "converges", "early", "best"])
def test_claims_that_do_not_hold(bad: Findings, key: str) -> None:
    claim = named(bad, key)
    assert (claim.holds, claim.verdict) == (False, "does not hold"), claim


def test_a_single_good_gait_is_found_late() -> None:
    needle = np.full(120, 1.0)
    needle[77] = 0.001
    findings = made_up_findings(needle, optimizers=("pso", "derand", "random"), legs=(1, 2), runs=20)
    assert named(findings, "flat").holds is False
    assert named(findings, "minimal").holds is False


def test_by_how_much_is_said(bad: Findings) -> None:
    assert "too much: pso " in named(bad, "early").measured
    assert "0 of 30 cases" in named(bad, "converges").measured
    assert "leg 3: 0% left" in named(bad, "left").measured


def test_the_random_baseline_stands_beside(good: Findings) -> None:
    assert "random: " in named(good, "early").beside
    assert "5.8 of 120" in named(good, "early").beside
    assert "better than random" in named(good, "competitive").beside


def test_what_was_not_measured_is_not_judged() -> None:
    findings = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=10)
    judged = {key for key in CLAIMS if named(findings, key).holds is not None}
    assert judged == {"both", "rotation"}


def test_walks_that_are_too_short_are_measured_but_not_judged() -> None:
    findings = made_up_findings(spread_out(0.25, SIGNS), legs=(1, 2), runs=2, duration_s=0.5)
    for claim in claims_of(findings):
        judged = CLAIMS["right"] not in claim.claim
        words = "not judged: walks of 0.5 s, needs at least 30 s" if judged else "not measured"
        assert (claim.holds, claim.verdict) == (None, words)
        assert claim.measured
    rows = bar_rows(findings, paper_count=False)
    assert {(row.holds, row.verdict) for row in rows} == {
        (None, "not judged: walks of 0.5 s, needs at least 30 s")
    }
    assert named(made_up_findings(spread_out(0.25, SIGNS), legs=(1, 2), runs=2), "both").holds is True


def test_the_bar_is_the_mean_of_what_each_leg_allows(good: Findings, bad: Findings) -> None:
    rows = bar_rows(good, paper_count=False)
    assert len(rows) == 6 * 2 * 7
    assert all(row.holds for row in rows if row.leg is None)
    assert {round(row.limit_m, 9) for row in rows} == {0.10, 0.025}
    late = [row for row in bar_rows(bad, paper_count=True) if row.evaluations == 60]
    best = bad.rotated(1).best_m
    assert [row.limit_m for row in late] == [pytest.approx(best + 0.01)] * len(late)
    row = next(row for row in late if not row.holds)
    assert row.over_m == pytest.approx(row.mean_m - row.limit_m)
    assert row.over_m > 0


def test_no_bar_beyond_the_budget() -> None:
    findings = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=30)
    assert {row.evaluations for row in bar_rows(findings, paper_count=False)} == {20}


def test_the_expected_rank_of_random_draws() -> None:
    assert expected_best_rank(20) == pytest.approx(5.76, abs=0.01)
    assert expected_best_rank(500) == 1.0


def test_small_lengths_keep_a_digit() -> None:
    assert (cm(0.123), cm(0.0004), cm(float("nan"))) == ("12.3 cm", "0.04 cm", "none")
