"""The options and plans of studies, priors and repertoires, and a study from Python."""

import json
import math
from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.sim.world import World, load_world
from hexctl.errors import InputError, WrongTypeError
from hexctl.options import options_of
from hexctl.study.hold_plan import HoldPlan
from hexctl.study.paper.study_plan import StudyPlan, nearby_worlds
from hexctl.study.planned_study import planned_study
from hexctl.study.priors.planned_prior import planned_prior
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.priors.prior_options import PriorOptions
from hexctl.study.study_options import TAKEN_BY, StudyOptions
from hexctl.study.walk_cache import WalkCache
from hexctl.study.walking import Work
from tests.robots import shipped
from tests.study.made_up import Remembering
from tests.study.made_up_transfer import plan as transfer_plan


def test_options_are_fields_of_the_plan() -> None:
    options = StudyOptions(
        robot="pexod", world="slippery", legs=[2, 5], failure="limp", optimizers=["pso"], runs=2, seed=7
    )
    plan = planned_study(options).plan
    assert (plan.robot.name, plan.world) == ("pexod", load_world("slippery"))
    assert (plan.legs, plan.failure, plan.optimizers) == ((2, 5), "limp", ("pso",))
    assert (plan.runs, plan.seed, plan.budget) == (2, 7, 120)


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


@pytest.mark.parametrize("kind", ["transfer", "hold", "recovery"])
def test_a_world_that_is_no_family_is_refused(kind: str) -> None:
    asked: dict[str, Any] = {kind: True, "world": "slippery"}
    with pytest.raises(InputError, match="world"):
        planned_study(StudyOptions(**asked))


def test_walks_that_hold_their_line_do_not_turn_before() -> None:
    plans = [planned_prior(PriorOptions(hold=hold)).plan for hold in ("none", "heading", "line")]
    assert [plan.self_rotation for plan in plans] == ["rear", "rear", "none"]
    assert all(isinstance(plan, PriorPlan) and plan.worlds == 16 for plan in plans)


def test_the_options_of_the_paper_are_those_of_the_plan_by_default() -> None:
    assert planned_study(StudyOptions()).plan == StudyPlan(robot=shipped())
    assert set(TAKEN_BY) <= {option.name for option in options_of(StudyOptions)}


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


def plan_of_study(**options: Any) -> StudyPlan:
    return StudyPlan(robot=shipped(), **options)


def test_the_default_is_the_papers_study() -> None:
    default = plan_of_study()
    default.check()
    specs = default.specs()
    assert {(spec.leg, spec.self_rotation) for spec in specs} == {
        (leg, rotation) for leg in range(1, 7) for rotation in ("none", "rear")
    }
    assert {len(spec.codes) for spec in specs} == {120}
    assert {spec.duration_s for spec in specs} == {30.0}
    assert (default.runs, default.budget) == (30, 120)


def test_more_worlds_walk_one_leg_of_each_experiment() -> None:
    here, there = plan_of_study(worlds=2).specs_by_world()
    assert len(here) == 12
    assert [(spec.leg, spec.self_rotation) for spec in there] == [
        (1, "none"), (1, "rear"), (2, "none"), (3, "none"), (4, "none")
    ]  # fmt: skip
    assert there[0].world != here[0].world
    sparse = plan_of_study(by_symmetry=True, without_gaits=40).specs()
    assert [len(spec.codes) for spec in sparse] == [40, 120, 40, 40, 40]


def small_plan() -> StudyPlan:
    return StudyPlan(
        robot=shipped(), legs=(2,), optimizers=("pso", "random"), runs=2, budget=3, duration_s=0.2
    )


@pytest.mark.long
def test_a_study_from_python(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    folder, cache, progress = tmp_path / "out", WalkCache(tmp_path / "cache"), Remembering()
    result = small_plan().run(folder, Work(cache=cache, jobs=1, progress=progress))
    assert capsys.readouterr() == ("", "")
    assert result.report == folder / "report.html"
    assert result.found.plan.legs == (2,)
    assert json.loads((folder / "study.json").read_text()) == json.loads(json.dumps(result.to_json()))
    assert progress.walks == 240
    assert progress.steps == sum(steps for _, steps in progress.stages)
    assert cache.count(small_plan().walked()) == (240, 240)

    again = Remembering()
    small_plan().run(folder, Work(cache=cache, progress=again))
    assert again.walks == 0


@pytest.mark.slow
def test_an_interrupted_study_keeps_its_gaits_and_leaves_no_empty_folder(tmp_path: Path) -> None:
    cache = WalkCache(tmp_path / "cache")
    with pytest.raises(KeyboardInterrupt):
        small_plan().run(
            tmp_path / "out", Work(cache=cache, jobs=1, progress=Remembering(interrupt_after=40))
        )
    assert cache.count(small_plan().walked()) == (40, 240)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_a_folder_with_other_things_is_refused(tmp_path: Path) -> None:
    (tmp_path / "thesis.tex").touch()
    with pytest.raises(InputError, match="holds other things"):
        transfer_plan().run(tmp_path, Work(cache=WalkCache(tmp_path / "cache")))
    assert [path.name for path in tmp_path.iterdir()] == ["thesis.tex"]


def test_the_world_itself_is_the_first_and_more_continue_fewer() -> None:
    world = load_world("slippery")
    five = nearby_worlds(world, 5)
    assert five[0] == world
    assert nearby_worlds(world, 3) == five[:3]
    assert len(set(map(World.model_dump_json, five))) == 5


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
        ({"robot": "ant"}, "robot"),
        ({"optimizers": ("pso", 5)}, "optimizers"),
    ],
)
def test_what_is_not_allowed_is_refused(options: dict[str, Any], field: str) -> None:
    with pytest.raises((InputError, WrongTypeError), match=field):
        StudyPlan(**{"robot": shipped(), **options}).check()


@pytest.mark.parametrize("jobs", [0, 1025])
def test_impossible_numbers_of_jobs_are_refused_before_anything_runs(jobs: int, tmp_path: Path) -> None:
    with pytest.raises(InputError):
        small_plan().run(tmp_path / "out", Work(cache=WalkCache(tmp_path / "cache"), jobs=jobs))
    assert list(tmp_path.iterdir()) == []
