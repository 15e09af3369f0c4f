"""Settings of a comparison of holds."""

from typing import Any

import pytest

from hexctl.errors import InputError
from hexctl.study.hold_plan import FIRST_WORLD
from hexctl.study.transfer.transfer_settings import FIRST_WORLD as FIRST_TRANSFER_WORLD
from hexctl.study.transfer.transfer_settings import MAX_WORLDS
from tests.robots import shipped
from tests.study.made_up_holds import plan


@pytest.mark.slow
def test_every_robot_walks_every_case_in_every_world() -> None:
    made = plan(robots=(shipped(), shipped("pexod")), worlds=2)
    places = [place for place, _ in made.walked()]
    assert [(one.robot.name, one.family, one.number) for one in places] == [
        (robot, family, number)
        for robot in ("ant", "pexod")
        for family in ("transfer", "real")
        for number in (FIRST_WORLD, FIRST_WORLD + 1)
    ]
    cases = made.cases()
    assert [case.hold for case in cases[:3]] == ["none", "heading", "line"]
    assert (len(cases), len(set(cases))) == (3 * (1 + 2 * 2), 3 * (1 + 2 * 2))
    assert {case.failure for case in cases if case.leg == 0} == {"intact"}
    made.check()


def test_the_worlds_are_none_of_the_transfer_benchmark_as_it_is_by_default() -> None:
    assert FIRST_WORLD >= FIRST_TRANSFER_WORLD + 30
    assert MAX_WORLDS > 0


def test_sensors_can_be_left_as_the_worlds_have_them() -> None:
    exact = plan(exact_sensors=True)
    family = exact.families["transfer"]
    assert exact.walked()[0][0].world == family.members(FIRST_WORLD, 1)[0]
    assert plan().walked()[0][0].world.lost_poses == 0.05


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"robots": ()}, "robot: got none; allowed: one or more, each once"),
        ({"robots": (shipped(), shipped())}, "robot: got ant,ant"),
        ({"families": {}}, "world: got none"),
        ({"worlds": 0}, r"worlds: got 0; allowed: 1\.\.1000"),
        ({"legs": (7,)}, "legs: got 7; allowed: one or more of 1..6, each once"),
        ({"legs": ()}, "legs: got none"),
        ({"failures": ("tired",)}, "failure: got 'tired'; allowed: locked, limp"),
        ({"failures": ()}, "failure: got none"),
        ({"holds": ("line", "line")}, "holds: got line,line; allowed: one or more of none, heading, line"),
        ({"holds": ("auto",)}, "holds: got auto"),
        ({"self_rotation": "left"}, "self_rotation: got left; allowed: auto, rear, front, none"),
        ({"duration_s": 0.0}, "duration_s: got 0; allowed: above 0"),
        ({"legs": [2]}, r"legs: got \[2\]"),
    ],
)
def test_what_cannot_be_is_refused_before_anything_runs(options: dict[str, Any], message: str) -> None:
    with pytest.raises(InputError, match=message):
        plan(**options).check()
