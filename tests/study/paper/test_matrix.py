"""The matrix of verdicts."""

import json
from dataclasses import replace
from pathlib import Path

import pytest
from pandas import DataFrame

from hexctl.backends.sim.world import World
from hexctl.errors import InputError
from hexctl.study.paper.claims import NAMES, OF_SEARCHES, claims_of
from hexctl.study.paper.evidence import Claim
from hexctl.study.paper.matrix import Cell, MatrixPlan, cells_of
from hexctl.study.paper.study_figures import PALE, verdicts_figure
from hexctl.study.paper.trajectory_claims import OF_WALKS
from hexctl.study.walk_cache import WalkCache
from tests.robots import shipped
from tests.study.made_up import made_up_findings, spread_out
from tests.study.watching import Remembering

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
    with pytest.raises(InputError, match="failure: got none"):
        cells_of(robots, WORLDS, [], [0.002])


@pytest.mark.slow
def test_a_matrix_is_walked_once_and_written(tmp_path: Path) -> None:
    small = {"legs": (2,), "duration_s": 0.2, "runs": 1, "budget": 3, "worlds": 1, "without_gaits": 3}
    cells = cells_of([shipped()], {"flat": World()}, ["locked", "limp"], [0.004], **small)
    cache, watching = WalkCache(tmp_path / "cache"), Remembering()
    plan = MatrixPlan(cells=cells)
    plan.run(folder=tmp_path / "out", cache=cache, jobs=1, progress=watching)
    assert watching.walks == 2 * (120 + 3)
    again = Remembering()
    result = plan.run(folder=tmp_path / "out", cache=cache, progress=again)
    assert again.walks == 0
    written = {path.name for path in (tmp_path / "out").iterdir()}
    assert written == {"matrix.html", "matrix.json", "matrix.md", "matrix.svg"}
    values = json.loads((tmp_path / "out" / "matrix.json").read_text(encoding="utf-8"))
    assert values == json.loads(json.dumps(result.to_json(), allow_nan=False))
    assert [cell["failure"] for cell in values["cells"]] == ["locked", "limp"]
    assert "not judged" in (tmp_path / "out" / "matrix.md").read_text(encoding="utf-8")
    assert "without self-rotation 3 gaits" in (tmp_path / "out" / "matrix.html").read_text(encoding="utf-8")


@pytest.mark.slow
def test_the_table_shows_red_where_it_is_red_and_what_survives_everywhere(tmp_path: Path) -> None:
    assert len(NAMES) == len(OF_WALKS) + len(OF_SEARCHES)
    few = ("pso", "debest", "random")
    near, far = (made_up_findings(spread_out(worst_m), optimizers=few, runs=2) for worst_m in (0.25, 0.5))
    lost = made_up_findings(2.5 + spread_out(1.0), optimizers=few, runs=2)
    cells = tuple(Cell(title=title, plan=near.plan) for title in ("near", "far", "lost"))
    walked = zip(cells, (near, far, lost), strict=True)
    claims = DataFrame([row for cell, findings in walked for row in cell.rows(claims_of(findings))])
    plan = MatrixPlan(cells=cells)
    plan.write(claims, tmp_path)
    values = plan.numbers(claims)
    header, _, *rows = plan.lines(claims)
    assert [cell.strip() for cell in header.split("|")[1:4]] == ["setting", "worlds", "left"]
    assert rows[2].count("**does not hold**") > rows[0].count("**does not hold**")
    assert values["survive"] == ["left", "right"]
    assert "(holds)" in rows[0]
    assert "(**does not hold**)" in rows[2]
    assert {cell["interval_tested"] for cell in values["cells"]} == {False}
    page = (tmp_path / "matrix.html").read_text(encoding="utf-8")
    assert "that of a single world" in page
    assert "mirror symmetry" in page


def test_a_verdict_of_one_world_is_in_brackets_and_pale() -> None:
    """One world has no interval: its red and green are not those of three worlds that agree."""
    plan = made_up_findings(spread_out(0.25), legs=(2,), optimizers=("random",), runs=1, budget=5).plan
    one, three = (Cell(title="", plan=replace(plan, worlds=worlds)) for worlds in (1, 3))
    red = Claim(claim="", rule="", measured="", holds=False)
    claims = [red, replace(red, holds=None, no_evidence="why")] * 6
    assert [row["short"] for row in one.rows(claims)][:2] == ["(does not hold)", "no evidence"]
    assert [row["short"] for row in three.rows(claims)][:2] == ["does not hold", "no evidence"]
    figure = verdicts_figure([("one", ["(holds)", "holds", "not judged"])], ["a", "b", "c"])
    pale, full, unjudged = figure.axes[0].patches
    assert pale.get_facecolor()[:3] == full.get_facecolor()[:3] != unjudged.get_facecolor()[:3]
    assert (pale.get_alpha(), full.get_alpha()) == (PALE, 1.0)
