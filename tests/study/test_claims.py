"""Claims of the paper: tolerances, verdicts, the matrix of verdicts, and claims that are no evidence."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.study.paper.claims import claims_of
from hexctl.study.paper.evidence import Claim, Measure, Tolerance, judge, judge_all
from hexctl.study.paper.matrix import Cell, MatrixPlan, cells_of
from hexctl.study.paper.searches import Findings, search_all
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from tests.robots import shipped
from tests.study.made_up import Remembering, made_up, made_up_findings, spread_out

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

SIGNS = np.where(np.arange(120) % 2, 1.0, -1.0)


def judged(findings: Findings) -> dict[str, Claim]:
    """The claims of findings by their keys."""
    claims = list(claims_of(findings))
    return {key: claim for key, words in CLAIMS.items() for claim in claims if words in claim.claim}


@pytest.mark.slow
def test_claims_that_do_not_hold() -> None:
    """All gaits far off, farther than without self-rotation, and each leg on the wrong side."""
    wrong = {1: 1.0, 2: 0.5, 3: 0.0, 4: 0.0, 5: 1.0, 6: 0.5}
    claims = judged(made_up_findings(2.5 + spread_out(3.0), wrong, runs=3))
    for key in ("left", "right", "straighter", "rotation", "converges", "early", "late", "best"):
        assert (claims[key].holds, claims[key].verdict) == (False, "does not hold"), key


@pytest.mark.long
@pytest.mark.parametrize("worst_m", [0.25, 1.2])
def test_no_claim_about_searches_is_green_on_random_numbers(worst_m: float) -> None:
    findings = made_up_findings(spread_out(worst_m, SIGNS), legs=(1, 2), runs=5)
    found = judged(findings)
    about_searches = ("converges", "flat", "minimal", "early", "late", "competitive", "best")
    claims = [found[key] for key in about_searches]
    assert not any(claim.holds for claim in claims), claims
    grey = [claim for claim in claims if claim.no_evidence]
    assert {claim.verdict for claim in grey} == {"no evidence: also holds on random numbers"}
    assert all("of 19 draws" in claim.null for claim in claims)


@pytest.mark.slow
def test_what_only_the_order_of_the_codes_makes_possible_is_green() -> None:
    """In a valley a search that keeps to its best code ends at the bottom; in random numbers it does not."""
    valley = np.abs(np.arange(1, 121) - 60.0) * 0.3 + 0.026
    findings = made_up_findings(valley, legs=(1,), runs=10, optimizers=("debest",))
    claim = judged(findings)["late"]
    assert (claim.verdict, claim.null) == ("holds", "holds in 0 of 19 draws")


@pytest.mark.slow
def test_what_symmetry_implies_is_no_evidence() -> None:
    claims = judged(made_up_findings(spread_out(0.25, SIGNS), runs=3))
    assert claims["both"].verdict == "no evidence: the mirror symmetry implies it"
    assert "one vote" in claims["right"].symmetric
    assert "legs 1, 2, 3, 4, 5, 6 (one experiment)" in claims["rotation"].measured


def test_a_leg_without_valid_gaits_is_not_judged() -> None:
    signed_m = spread_out(0.25, SIGNS)
    plan = made_up_findings(signed_m, {2: 1.0}, legs=(2,), optimizers=("random",), runs=2).plan
    none, some = (
        judged(search_all(plan, [made_up(2, "none", np.ones(120), invalid), made_up(2, "rear", signed_m)]))
        for invalid in (range(1, 121), range(1, 101))
    )
    assert none["left"].verdict == "not judged: leg 2: 0 of 120 gaits valid"
    assert "leg 2 100%" in none["left"].beside
    assert some["left"].holds is True
    assert "20 of 120 gaits valid" in some["left"].measured


def test_worlds_that_disagree_are_no_evidence() -> None:
    plan = made_up_findings(spread_out(2.0), legs=(2,), optimizers=("pso", "random"), runs=2).plan
    plan = replace(plan, worlds=3)
    landscapes = [
        replace(made_up(spec.leg, spec.self_rotation, spread_out(worst_m)), spec=spec)
        for specs, worst_m in zip(plan.specs_by_world(), (0.5, 1.2, 30.0), strict=True)
        for spec in specs
    ]
    early = judged(search_all(plan, landscapes))["early"]
    assert early.verdict == "no evidence: the interval over worlds reaches across the limit"
    assert "3 worlds]" in early.measured


def test_what_was_not_measured_is_not_judged() -> None:
    findings = made_up_findings(spread_out(0.25), legs=(1,), optimizers=("random",), budget=10)
    measured = {key for key, claim in judged(findings).items() if claim.verdict != "not measured"}
    assert measured == {"both", "straighter", "rotation"}


@pytest.mark.slow
def test_walks_that_are_too_short_are_measured_but_not_judged() -> None:
    findings = made_up_findings(spread_out(0.25, SIGNS), legs=(1, 2), runs=2, duration_s=0.5)
    for key, claim in judged(findings).items():
        too_short = "not judged: walks of 0.5 s, needs at least 30 s"
        assert (claim.holds, claim.verdict) == (None, "not measured" if key == "right" else too_short)
        assert claim.measured


def test_the_interval_over_worlds_is_students() -> None:
    from scipy import stats

    values = (0.08, 0.11, 0.09, 0.14)
    expected = stats.t.interval(0.95, 3, loc=sum(values) / 4, scale=stats.sem(values))
    assert Measure("pso", values).interval == pytest.approx(expected)
    assert Measure("share", (0.9, 1.0), most=1.0).interval == pytest.approx((0.3147, 1.0), abs=1e-4)
    assert Measure("pso", (0.01, 0.3)).interval[0] == 0.0
    assert Measure("pso", (0.08, float("nan"))).interval == (0.08, 0.08)


@pytest.mark.parametrize(
    ("values", "where"),
    [
        ((0.03,), "below"),
        ((0.2,), "above"),
        ((0.09, 0.1, 0.11), "within"),
        ((0.05, 0.1, 0.15), "across"),
        ((float("nan"),), "unknown"),
    ],
)
def test_an_interval_is_within_outside_or_across(values: tuple[float, ...], where: str) -> None:
    """A tolerance about a number is half of it to both sides."""
    assert judge(Measure("pso", values), Tolerance.about(0.1)) == where


def test_one_number_outside_is_enough_and_one_unknown_leaves_open() -> None:
    good, high = Measure("pso", (0.1,)), Measure("dps", (0.3,))
    none = Measure("leg 2", (float("nan"),), "0 valid")
    about = Tolerance.about(0.1)
    assert judge_all([good], about).holds is True
    assert judge_all([good, high, none], about).holds is False
    assert judge_all([good, none], about).not_judged == "leg 2: 0 valid"
    assert judge_all([], about).holds is None
    assert Tolerance.about(40, 60) == Tolerance(20, 90)


WORLDS = {"flat": World(), "slippery": World(friction=0.3)}


def test_each_failure_is_walked_in_the_first_setting_and_in_every_other_one() -> None:
    robots = [shipped(), shipped("pexod")]
    cells = cells_of(robots, WORLDS, ["locked", "weak:0.5"], [0.002, 0.004], worlds=2)
    assert [cell.title for cell in cells] == [
        "ant, flat, 2 ms, locked",
        "ant, flat, 2 ms, weak:0.5",
        "ant, slippery, 2 ms, locked",
        "ant, slippery, 2 ms, weak:0.5",
        "ant, flat, 4 ms, locked",
        "ant, flat, 4 ms, weak:0.5",
        "pexod, flat, 2 ms, locked",
        "pexod, flat, 2 ms, weak:0.5",
    ]
    assert {cell.plan.worlds for cell in cells} == {2}
    assert cells[4].plan.world.time_step_s == 0.004
    with pytest.raises(InputError, match="failure"):
        cells_of(robots, WORLDS, [], [0.002])


@pytest.mark.long
def test_a_matrix_is_walked_once_and_written(tmp_path: Path) -> None:
    small = {"legs": (2,), "duration_s": 0.2, "runs": 1, "budget": 3, "worlds": 1, "without_gaits": 3}
    cells = cells_of([shipped()], {"flat": World()}, ["locked", "limp"], [0.004], **small)
    cache, watching = WalkCache(tmp_path / "cache"), Remembering()
    plan = MatrixPlan(cells=cells)
    plan.run(tmp_path / "out", Work(cache=cache, jobs=1, progress=watching))
    assert watching.walks == 2 * (120 + 3)
    again = Remembering()
    result = plan.run(tmp_path / "out", Work(cache=cache, progress=again))
    assert again.walks == 0
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"matrix.html", "matrix.json"}
    values = json.loads((tmp_path / "out" / "matrix.json").read_text(encoding="utf-8"))
    assert values == json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert [cell["failure"] for cell in values["cells"]] == ["locked", "limp"]
    page = (tmp_path / "out" / "matrix.html").read_text(encoding="utf-8")
    assert "not judged" in page
    assert "Without self-rotation 3 gaits" in page


def test_a_verdict_of_one_world_is_in_brackets() -> None:
    """One world has no interval: its red and green are not those of three worlds that agree."""
    plan = made_up_findings(spread_out(0.25), legs=(2,), optimizers=("random",), runs=1, budget=5).plan
    one, three = (Cell(title="", plan=replace(plan, worlds=worlds)) for worlds in (1, 3))
    red = Claim(claim="", rule="", measured="", holds=False)
    claims = [red, replace(red, holds=None, no_evidence="why")] * 6
    assert [row["short"] for row in one.rows(claims)][:2] == ["(does not hold)", "no evidence"]
    assert [row["short"] for row in three.rows(claims)][:2] == ["does not hold", "no evidence"]
