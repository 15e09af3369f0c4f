"""Plans of the studies that options ask for, and a study from Python in one call."""

from pathlib import Path
from typing import Any

import pytest

from hexctl.backends.sim.world import load_world
from hexctl.errors import InputError
from hexctl.study.hold_plan import HoldPlan
from hexctl.study.paper.study_plan import StudyPlan
from hexctl.study.planned_study import planned_study
from hexctl.study.recovery.recovery_plan import RecoveryPlan
from hexctl.study.study_options import StudyOptions
from hexctl.study.walk_cache import WalkCache
from tests.robots import shipped


def test_options_that_are_not_given_are_those_of_the_plan() -> None:
    assert planned_study(StudyOptions()).plan == StudyPlan(robot=shipped())


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
    assert (plan.failures, plan.self_rotation, plan.UNIT) == (("limp", "stuck:femur"), "auto", "walks")


def test_a_recovery_benchmark_has_the_options_of_its_plan() -> None:
    options = StudyOptions(recovery=True, gaits=("wave",), protocols=("line",), exact_sensors=True, runs=3)
    plan = planned_study(options).plan
    assert isinstance(plan, RecoveryPlan)
    assert (plan.gaits, plan.protocols, plan.exact_sensors, plan.runs) == (("wave",), ("line",), True, 3)


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
    with pytest.raises(InputError, match=r"^world: got slippery "):
        planned_study(StudyOptions(**asked))


@pytest.mark.slow
def test_a_study_is_planned_and_run_in_one_call(tmp_path: Path) -> None:
    options = StudyOptions(
        legs=(2,), duration_s=0.2, optimizers=("random",), runs=1, budget=2, jobs=1, out=tmp_path / "out"
    )
    planned = planned_study(options)
    cache = WalkCache(tmp_path / "cache")
    assert planned.saved(cache) == (0, 240)
    result = planned.run(cache=cache)
    assert planned.saved(cache) == (240, 240)
    assert result.report.is_file()
    assert any(line.startswith("not judged") for line in result.lines())
