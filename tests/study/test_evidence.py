"""Tolerances, intervals over worlds, verdicts, and the matrix of verdicts."""

import json
from dataclasses import replace
from pathlib import Path

import pytest

from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.study.paper.evidence import Claim, Measure, Tolerance, judge, judge_all
from hexctl.study.paper.matrix import Cell, MatrixPlan, cells_of
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from tests.robots import shipped
from tests.study.made_up import Remembering, made_up_findings, spread_out


def test_about_a_number_is_half_of_it_to_both_sides() -> None:
    about = Tolerance.about(0.1)
    assert (about.low, about.high) == pytest.approx((0.05, 0.15))
    assert Tolerance.about(40, 60) == Tolerance(20, 90)


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
        ((0.1,), "within"),
        ((0.03,), "below"),
        ((0.2,), "above"),
        ((0.09, 0.1, 0.11), "within"),
        ((0.05, 0.1, 0.15), "across"),
        ((0.2, 0.21, 0.22), "above"),
        ((float("nan"),), "unknown"),
    ],
)
def test_an_interval_is_within_outside_or_across(values: tuple[float, ...], where: str) -> None:
    assert judge(Measure("pso", values), Tolerance.about(0.1)) == where


def test_one_number_outside_is_enough_and_one_unknown_leaves_open() -> None:
    good, high = Measure("pso", (0.1,)), Measure("dps", (0.3,))
    none = Measure("leg 2", (float("nan"),), "0 valid")
    about = Tolerance.about(0.1)
    assert judge_all([good], about).holds is True
    assert judge_all([good, high, none], about).holds is False
    assert judge_all([good, none], about).not_judged == "leg 2: 0 valid"
    assert judge_all([], about).holds is None


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
