"""Claims of the paper: what holds, what does not, and what random numbers or a symmetry would say as well."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.study.paper.claims import claims_of
from hexctl.study.paper.evidence import Claim
from hexctl.study.paper.searches import Findings, search_all
from hexctl.types import FloatArray
from tests.study.made_up import made_up, made_up_findings, spread_out

CLAIMS = {
    "left": "moves to the left",
    "right": "moves to the right",
    "both": "goes straight or turns",
    "straighter": "avoids motions",
    "rotation": "After the self-rotation",
    "converges": "converge to about 2.5 cm",
    "flat": "fastest in the first 20",
    "minimal": "Minimal values",
    "early": "about 10 cm",
    "late": "2.5 cm on average",
    "competitive": "competitive",
    "best": "keeps the direction",
}

SEARCHES = ("converges", "flat", "minimal", "early", "late", "competitive", "best")

SIGNS = np.where(np.arange(120) % 2, 1.0, -1.0)


@pytest.fixture(scope="module")
def good() -> Findings:
    """Many gaits near the line, and the sides that the paper saw."""
    return made_up_findings(spread_out(0.25, SIGNS), runs=3)


@pytest.fixture(scope="module")
def bad() -> Findings:
    """All gaits far off, farther than without self-rotation, and each leg on the wrong side."""
    wrong = {1: 1.0, 2: 0.5, 3: 0.0, 4: 0.0, 5: 1.0, 6: 0.5}
    return made_up_findings(2.5 + spread_out(3.0), wrong, runs=3)


#: Findings that were judged and their claims, by the id of the findings.
JUDGED: dict[int, tuple[Findings, list[Claim]]] = {}


def named(findings: Findings, key: str) -> Claim:
    if id(findings) not in JUDGED:
        JUDGED[id(findings)] = findings, list(claims_of(findings))
    (claim,) = [claim for claim in JUDGED[id(findings)][1] if CLAIMS[key] in claim.claim]
    return claim


@pytest.mark.slow
@pytest.mark.parametrize(
    "key", ["left", "right", "straighter", "rotation", "converges", "early", "late", "best"]
)
def test_claims_that_do_not_hold(bad: Findings, key: str) -> None:
    claim = named(bad, key)
    assert (claim.holds, claim.verdict) == (False, "does not hold"), claim


@pytest.mark.long
@pytest.mark.parametrize("worst_m", [0.25, 1.2])
def test_no_claim_about_searches_is_green_on_random_numbers(worst_m: float) -> None:
    findings = made_up_findings(spread_out(worst_m, SIGNS), legs=(1, 2), runs=5)
    claims = [named(findings, key) for key in SEARCHES]
    assert not any(claim.holds for claim in claims), claims
    grey = [claim for claim in claims if claim.no_evidence]
    assert {claim.verdict for claim in grey} == {"no evidence: also holds on random numbers"}
    assert all("of 19 draws" in claim.null for claim in claims)


@pytest.mark.slow
def test_what_only_the_order_of_the_codes_makes_possible_is_green() -> None:
    """In a valley a search that keeps to its best code ends at the bottom; in random numbers it does not."""
    valley = np.abs(np.arange(1, 121) - 60.0) * 0.3 + 0.026
    findings = made_up_findings(valley, legs=(1,), runs=10, optimizers=("debest",))
    claim = named(findings, "late")
    assert (claim.verdict, claim.null) == ("holds", "holds in 0 of 19 draws")


@pytest.mark.slow
def test_what_symmetry_implies_is_no_evidence(good: Findings) -> None:
    both = named(good, "both")
    assert both.verdict == "no evidence: the mirror symmetry implies it"
    assert "one vote" in named(good, "right").symmetric
    assert "legs 1, 2, 3, 4, 5, 6 (one experiment)" in named(good, "rotation").measured


def with_invalid(signed_m: FloatArray, invalid: range) -> Findings:
    """Leg 2 with gaits that are invalid without self-rotation."""
    plan = made_up_findings(signed_m, {2: 1.0}, legs=(2,), optimizers=("random",), runs=2).plan
    return search_all(plan, [made_up(2, "none", np.ones(120), invalid), made_up(2, "rear", signed_m)])


def test_a_leg_without_valid_gaits_is_not_judged() -> None:
    claim = named(with_invalid(spread_out(0.25, SIGNS), range(1, 121)), "left")
    assert claim.verdict == "not judged: leg 2: 0 of 120 gaits valid"
    assert "leg 2 100%" in claim.beside
    some = named(with_invalid(spread_out(0.25, SIGNS), range(1, 101)), "left")
    assert some.holds is True
    assert "20 of 120 gaits valid" in some.measured


def test_worlds_that_disagree_are_no_evidence() -> None:
    plan = made_up_findings(spread_out(2.0), legs=(2,), optimizers=("pso", "random"), runs=2).plan
    plan = replace(plan, worlds=3)
    landscapes = [
        replace(made_up(spec.leg, spec.self_rotation, spread_out(worst_m)), spec=spec)
        for specs, worst_m in zip(plan.specs_by_world(), (0.5, 1.2, 30.0), strict=True)
        for spec in specs
    ]
    early = named(search_all(plan, landscapes), "early")
    assert early.verdict == "no evidence: the interval over worlds reaches across the limit"
    assert "3 worlds]" in early.measured


def test_what_was_not_measured_is_not_judged() -> None:
    findings = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=10)
    judged = {key for key in CLAIMS if named(findings, key).verdict != "not measured"}
    assert judged == {"both", "straighter", "rotation"}


@pytest.mark.slow
def test_walks_that_are_too_short_are_measured_but_not_judged() -> None:
    findings = made_up_findings(spread_out(0.25, SIGNS), legs=(1, 2), runs=2, duration_s=0.5)
    for claim in claims_of(findings):
        judged = CLAIMS["right"] not in claim.claim
        words = "not judged: walks of 0.5 s, needs at least 30 s" if judged else "not measured"
        assert (claim.holds, claim.verdict) == (None, words)
        assert claim.measured
