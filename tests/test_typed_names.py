"""Names in any case and spelling, and proposals."""

import pytest

from hexctl.adapt.optimizers.optimizer_registry import make_optimizer
from hexctl.adapt.space import GaitSpace
from hexctl.backends.registry import BackendOptions, make_servos
from hexctl.backends.sim.world import load_world
from hexctl.errors import InputError
from hexctl.gait.gait import NAMED_SLOTS, make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.loader import load_robot
from hexctl.typed_names import known_name, nearest

WORLDS = ("flat", "randomised", "rough", "phantomx-ax")


@pytest.mark.parametrize(
    ("text", "name"),
    [("flat", "flat"), ("Flat", "flat"), (" ROUGH", "rough"), ("randomized", "randomised"),
     ("PhantomX_AX", "phantomx-ax"), ("fla", None), ("", None)],
)  # fmt: skip
def test_a_name_in_any_case_and_spelling(text: str, name: str | None) -> None:
    assert known_name(text, WORLDS) == name


def test_two_names_that_differ_in_case_alone_are_two() -> None:
    assert known_name("ant", ("Ant", "ant")) == "ant"
    assert known_name("ANT", ("Ant", "ant")) is None


def test_what_is_near_is_proposed_and_what_is_not_is_not() -> None:
    assert nearest("randomise", WORLDS) == "; did you mean 'randomised'?"
    assert nearest("x" * 100_000, WORLDS) == nearest("mars", WORLDS) == ""


def test_robots_worlds_failures_and_gaits_in_any_case_and_spelling() -> None:
    assert load_robot("PhantomX").name == "phantomx"
    assert load_world("Randomized:7") == load_world("randomised:7")
    assert parse_kind(5, "Limp:FEMUR") == Failure(leg=5, kind="limp", joint="femur")
    assert make_gait(load_robot("ant"), "Tripod").slots == NAMED_SLOTS["tripod"]


def test_robots_worlds_failures_gaits_backends_and_optimizers_are_proposed() -> None:
    robot = load_robot("ant")
    for call, name in (
        (lambda: load_robot("phantom"), "phantomx"),
        (lambda: load_world("slipery"), "slippery"),
        (lambda: parse_kind(5, "mising"), "missing"),
        (lambda: make_gait(robot, "tripot"), "tripod"),
        (lambda: make_gait(robot, "aut", besides=("auto",)), "auto"),
        (lambda: make_servos("dynamixl", BackendOptions(robot=robot)), "dynamixel"),
        (lambda: make_optimizer("randon", GaitSpace((5,)), 0), "random"),
    ):
        with pytest.raises(InputError, match=f"; did you mean '{name}'\\?$"):
            call()
