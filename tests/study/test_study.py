"""Studies: options and plans, a study from Python, and its page, figures and tables."""

import math
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.options import options_of
from hexctl.palette import INVALID_COLOR, deviation_color
from hexctl.study.experiment import where
from hexctl.study.hold_plan import HoldPlan
from hexctl.study.paper.claims import claims_of
from hexctl.study.paper.paper_study import PaperStudy
from hexctl.study.paper.searches import Findings, curve_of
from hexctl.study.paper.study_figures import trajectories_figure
from hexctl.study.planned_study import planned_study
from hexctl.study.priors.prior_options import PriorOptions
from hexctl.study.report_page import Block, Bullets, Picture, Section, Table, render_page
from hexctl.study.study_options import TAKEN_BY, StudyOptions
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from tests.robots import shipped
from tests.study.made_up import Remembering, made_up, made_up_findings, spread_out


def test_a_comparison_of_holds_takes_lists() -> None:
    options = StudyOptions(hold=True, robot="ant,pexod", world="transfer,real", failure="limp,stuck:femur")
    planned = planned_study(options)
    plan = planned.plan
    assert isinstance(plan, HoldPlan)
    assert ([one.name for one in plan.robots], list(plan.families)) == (
        ["ant", "pexod"],
        ["transfer", "real"],
    )
    assert (plan.failures, plan.self_rotation) == (("limp", "stuck:femur"), "auto")


def test_time_steps_of_a_matrix_are_milliseconds() -> None:
    options = StudyOptions(
        matrix=True, robot="ant", world="flat", failure="locked,limp", time_steps_ms=(4, 2)
    )
    cells = planned_study(options).plan.cells
    assert [(cell.plan.world.time_step_s, cell.plan.failure) for cell in cells] == [
        (0.004, "locked"),
        (0.004, "limp"),
        (0.002, "locked"),
        (0.002, "limp"),
    ]


@pytest.mark.parametrize(
    ("kind", "options", "option"),
    [
        (StudyOptions, {"transfer": True, "hold": True}, "hold"),
        (StudyOptions, {"one_leg": True, "matrix": True}, "one_leg"),
        (StudyOptions, {"exact_sensors": True}, "exact_sensors"),
        (StudyOptions, {"hold": True, "seed": 3}, "seed"),
        (StudyOptions, {"recovery": True, "dask": "tcp://127.0.0.1:1"}, "dask"),
        (StudyOptions, {"duration_s": math.nan}, "duration_s"),
        (PriorOptions, {"pairs": ()}, "pairs"),
        (PriorOptions, {"repertoire": True, "hold": "line"}, "hold"),
    ],
)
def test_what_a_kind_does_not_take_is_refused(kind: type, options: dict[str, Any], option: str) -> None:
    with pytest.raises((InputError, WrongTypeError), match=f"^{option}\\b"):
        kind(**options)


def test_the_default_is_the_papers_study() -> None:
    default = PaperStudy(robot=shipped())
    default.check()
    assert planned_study(StudyOptions()).plan == default
    assert set(TAKEN_BY) <= {option.name for option in options_of(StudyOptions)}
    specs = default.specs()
    assert {(spec.leg, spec.self_rotation) for spec in specs} == {
        (leg, rotation) for leg in range(1, 7) for rotation in ("none", "rear")
    }
    assert {len(spec.codes) for spec in specs} == {120}
    assert {spec.duration_s for spec in specs} == {30.0}
    assert (default.runs, default.budget) == (30, 120)


def test_more_worlds_walk_one_leg_of_each_experiment() -> None:
    here, there = PaperStudy(robot=shipped(), worlds=2).specs_by_world()
    assert len(here) == 12
    assert [(spec.leg, spec.self_rotation) for spec in there] == [
        (1, "none"), (1, "rear"), (2, "none"), (3, "none"), (4, "none")
    ]  # fmt: skip
    assert there[0].world != here[0].world
    sparse = PaperStudy(robot=shipped(), by_symmetry=True, without_gaits=40).specs()
    assert [len(spec.codes) for spec in sparse] == [40, 120, 40, 40, 40]


def small_plan() -> PaperStudy:
    return PaperStudy(
        robot=shipped(), legs=(2,), optimizers=("pso", "random"), runs=2, budget=3, duration_s=0.2
    )


@pytest.mark.slow
def test_an_interrupted_study_keeps_its_gaits_and_leaves_no_empty_folder(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    cache = WalkCache(tmp_path / "cache")
    with pytest.raises(KeyboardInterrupt):
        small_plan().run(
            tmp_path / "out", Work(cache=cache, jobs=1, progress=Remembering(interrupt_after=40))
        )
    assert cache.count(small_plan().walked()) == (40, 240)
    assert not (tmp_path / "out").exists()
    assert capsys.readouterr() == ("", "")


@pytest.mark.slow
def test_a_folder_with_other_things_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match="holds other things"):
        small_plan().run(tmp_path, Work(cache=WalkCache(tmp_path / "cache")))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"legs": ()}, "legs"),
        ({"legs": (0,)}, "legs"),
        ({"legs": (1, 1)}, "legs"),
        ({"runs": 1000}, "runs"),
        ({"failure": "tired"}, "failure"),
        ({"failure": "unknown"}, "failure"),
        ({"self_rotation": "left"}, "self_rotation"),
        ({"worlds": 101}, "worlds"),
        ({"optimizers": ("pso", "genetic")}, "genetic"),
        ({"optimizers": ("pso", 5)}, "optimizer"),
        ({"robot": "ant"}, "robot"),
    ],
)
def test_what_is_not_allowed_is_refused(options: dict[str, Any], field: str) -> None:
    with pytest.raises((InputError, WrongTypeError), match=field):
        PaperStudy(**{"robot": shipped(), **options}).check()


HOSTILE = '<script>alert("a & b")</script>'


def test_every_text_is_escaped(tmp_path: Path) -> None:
    image = tmp_path / "a<b.svg"
    image.write_bytes(b"svg")
    blocks: list[Block] = [
        HOSTILE,
        Bullets([HOSTILE]),
        Table([HOSTILE], [[HOSTILE]]),
        Picture(image, HOSTILE, HOSTILE),
    ]
    text = render_page(HOSTILE, [Section(HOSTILE, blocks)])
    assert text.count("<script") == 1
    assert HOSTILE not in text
    assert text.count("&lt;script&gt;") >= 9
    assert "a<b" not in text


def test_a_path_has_the_colour_that_the_viewer_gives_its_deviation() -> None:
    pytest.importorskip("matplotlib", reason="figures need the study extra")
    signed_m = np.full(120, 0.5)
    signed_m[:6] = [0.001, -0.03, 0.1, -0.2, 0.9, 5.0]
    figure = trajectories_figure([made_up(5, "rear", signed_m, invalid=[20])], "paths")
    grey, lines = figure.axes[0].collections[:2]
    (invalid,) = np.asarray(grey.get_edgecolor())
    np.testing.assert_allclose(invalid[:3], np.array(INVALID_COLOR) / 255, atol=1e-3)
    lines.update_scalarmappable()
    deviations_m = np.asarray(lines.get_array())
    assert {0.001, 5.0} <= set(deviations_m.round(6).tolist())
    for deviation_m, drawn in zip(deviations_m, np.asarray(lines.get_edgecolor()), strict=True):
        color = np.array(deviation_color(float(deviation_m), valid=True)) / 255
        np.testing.assert_allclose(drawn[:3], color, atol=0.02)


@pytest.fixture(scope="module")
def findings() -> Findings:
    made = made_up_findings(
        spread_out(0.5), {2: 0.5, 6: 0.0}, legs=(2, 6), optimizers=("pso", "random"), runs=3, budget=25
    )
    return replace(made, claims=tuple(claims_of(made)))


@pytest.fixture(scope="module")
def folder(findings: Findings, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("study")
    assert isinstance(findings.plan, PaperStudy)
    findings.plan.write(findings, folder)
    return folder


@pytest.mark.slow
def test_the_page_asks_nobody_for_anything(folder: Path) -> None:
    text = re.sub(r'"data:[^"]*"', '""', (folder / "report.html").read_text(encoding="utf-8"))
    assert not re.search(
        r"https?:|//|<script [^>]*src|<link|<iframe|@import|url\(", text, flags=re.IGNORECASE
    )
    assert set(re.findall(r'src="([^"]*)"', text)) == {""}


@pytest.mark.slow
def test_tables_hold_every_gait_evaluation_and_run(findings: Findings, folder: Path) -> None:
    import pyarrow.parquet as pq

    gaits, curves, runs = (
        pq.read_table(folder / f"{name}.parquet").to_pydict()
        for name in ("landscapes", "convergence", "runs")
    )
    assert len(gaits["code"]) == 2 * 2 * 120
    assert len(curves["mean_m"]) == 2 * 2 * 25
    assert len(runs["best_m"]) == 2 * 2 * 3 * 25
    landscape = findings.without(2)
    assert gaits["signed_m"][:120] == landscape.number("signed_m").tolist()
    assert gaits["path_deviation_m"][7] == landscape.paths_m[7, :, 1].tolist()
    searches = where(findings.first_runs, leg=2, optimizer="pso")
    assert curves["mean_m"][:25] == curve_of(searches)["mean_m"].tolist()
    assert np.array_equal(np.reshape(runs["code"][: 3 * 25], (3, 25)), np.stack(searches["codes"]))
