from typing import Any

import pytest

from hexctl.backends.sim.world import load_randomization
from hexctl.errors import InputError, WrongTypeError
from hexctl.study.paper.study_plan import StudyPlan
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.transfer.transfer_plan import TransferPlan
from tests.robots import shipped


def plan(**options: Any) -> StudyPlan:
    return StudyPlan(robot=shipped(), **options)


def test_the_default_is_the_papers_study() -> None:
    default = plan()
    default.check()
    specs = default.specs()
    assert {(spec.leg, spec.self_rotation) for spec in specs} == {
        (leg, rotation) for leg in range(1, 7) for rotation in ("none", "rear")
    }
    assert {len(spec.codes) for spec in specs} == {120}
    assert {spec.duration_s for spec in specs} == {30.0}
    assert (default.runs, default.budget) == (30, 120)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"legs": ()}, "legs"),
        ({"legs": (0,)}, "legs: got 0; allowed: one or more of 1..6"),
        ({"legs": (1, 1)}, "each once"),
        ({"runs": 0}, "runs"),
        ({"runs": 1000}, "runs"),
        ({"budget": 0}, "budget"),
        ({"seed": -1}, "seed"),
        ({"duration_s": 0.0}, "duration"),
        ({"duration_s": float("nan")}, "duration"),
        ({"failure": "tired"}, "failure: got 'tired'; allowed: locked, limp"),
        ({"failure": "weak:half"}, "weak:half"),
        ({"failure": "unknown"}, "failure: got unknown; allowed: one that is the same"),
        ({"self_rotation": "left"}, "self_rotation: got left; allowed: rear, front, none"),
        ({"worlds": 0}, "worlds: got 0; allowed: 1..100"),
        ({"without_gaits": 121}, "without_gaits"),
        ({"optimizers": ()}, "optimizers"),
        ({"optimizers": ("pso", "genetic")}, "genetic.*pso, psosp"),
        ({"optimizers": ("pso", "pso")}, "each once"),
    ],
)
def test_what_is_not_allowed_is_said(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(**options).check()


def test_failure_and_self_rotation_are_those_of_every_landscape() -> None:
    specs = plan(failure="weak:0.5", self_rotation="front", legs=(2,)).specs()
    assert [(spec.self_rotation, str(spec.leg_failure)) for spec in specs] == [
        ("none", "weak:0.5"),
        ("front", "weak:0.5"),
    ]
    assert [spec.self_rotation for spec in plan(self_rotation="none", legs=(2,)).specs()] == ["none"]


def test_more_worlds_walk_one_leg_of_each_experiment() -> None:
    here, there = plan(worlds=2).specs_by_world()
    assert len(here) == 12
    assert [(spec.leg, spec.self_rotation) for spec in there] == [
        (1, "none"), (1, "rear"), (2, "none"), (3, "none"), (4, "none")
    ]  # fmt: skip
    assert there[0].world != here[0].world
    sparse = plan(by_symmetry=True, without_gaits=40).specs()
    assert [len(spec.codes) for spec in sparse] == [40, 120, 40, 40, 40]


def test_wrong_types_are_refused_at_once() -> None:
    with pytest.raises(WrongTypeError, match=r"^robot: got 'ant' \(str\)"):
        StudyPlan(robot="ant")  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"^world: got 'slippery' \(str\)"):
        plan(world="slippery")
    with pytest.raises(WrongTypeError, match=r"^family: got 'randomised' \(str\)"):
        PriorPlan(robot=shipped(), family="randomised")  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"^prior: got None"):
        TransferPlan(robot=shipped(), family=load_randomization("transfer"), prior=None)  # type: ignore[arg-type]
    with pytest.raises(WrongTypeError, match=r"^optimizers: got 5"):
        plan(optimizers=("pso", 5))
