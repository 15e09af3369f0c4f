"""hexctl's own errors travel between processes, as those of a study's workers do; wrong types are refused."""

import pickle
from pathlib import Path

import numpy as np
import pytest

from hexctl import errors
from hexctl.backends.sim.world import load_world
from hexctl.errors import (
    HexctlError,
    InputError,
    MissingExtraError,
    WrongTypeError,
    argument,
    check_callable,
    check_type,
    printable,
)
from hexctl.gait.gait import NAMED_SLOTS, make_gait
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.loader import load_robot
from hexctl.typed_names import known_name, nearest

ERRORS = [
    kind("one line")
    for kind in vars(errors).values()
    if isinstance(kind, type) and issubclass(kind, HexctlError) and kind is not MissingExtraError
]


@pytest.mark.parametrize("error", [*ERRORS, MissingExtraError("the simulation", "sim")], ids=repr)
def test_every_error_travels_with_its_text(error: HexctlError) -> None:
    there = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert type(there) is type(error)
    assert str(there) == str(error)
    assert "one line" in str(error) or "[sim]" in str(error)


def test_an_argument_in_a_message_is_shown_as_the_reader_gives_it() -> None:
    error = InputError(f"{argument('target_m')}: got 0 with {argument('ask')}; allowed: above 0 m")
    assert str(error) == "target_m: got 0 with ask; allowed: above 0 m"
    assert error.args == (str(error),)
    there = pickle.loads(pickle.dumps(error))  # noqa: S301
    assert there.worded(str.upper) == "TARGET_M: got 0 with ASK; allowed: above 0 m"


@pytest.mark.parametrize(
    ("value", "kind"),
    [
        (1, float),
        (np.float32(1.5), float),
        (np.int64(1), int),
        (Path("ant.yaml"), (str, Path)),
        (None, (str, type(None))),
    ],
)
def test_a_value_of_an_allowed_type_passes(value: object, kind: type) -> None:
    check_type(value, kind, "value")


@pytest.mark.parametrize(
    ("value", "kind", "message"),
    [
        ("5", int, "leg: got '5' (str); allowed: a whole number"),
        (1.5, int, "leg: got 1.5 (float); allowed: a whole number"),
        (True, float, "leg: got True (bool); allowed: a number"),
        (3, (str, type(None)), "leg: got 3 (int); allowed: text or None"),
        (np.zeros((2, 2)), str, "leg: got array([[0., 0.],        [0., 0.]]) (ndarray); allowed: text"),
    ],
)
def test_a_value_of_another_type_is_refused_in_one_line(value: object, kind: type, message: str) -> None:
    with pytest.raises(InputError) as refused:
        check_type(value, kind, "leg")
    assert str(refused.value) == message
    assert isinstance(refused.value, TypeError)


def test_a_value_however_large_is_shown_in_one_short_line() -> None:
    with pytest.raises(WrongTypeError, match=r"^plan: got .{,180}; allowed: a robot$"):
        check_type([["x" * 1000] * 1000] * 1000, str, "plan", "a robot")


def test_what_must_be_called_can_be() -> None:
    check_callable(len, "on_stored", "a function")
    check_callable(None, "on_stored", "a function")
    with pytest.raises(WrongTypeError, match=r"^on_stored: got 3 \(int\); allowed: a function$"):
        check_callable(3, "on_stored", "a function")


def test_a_message_is_one_printable_line_whatever_its_values_hold() -> None:
    error = InputError(f"{argument('robot')}: got a\nb\x1b[31m\udcff\x00é; allowed: none")
    assert str(error) == "robot: got a\\nb\\x1b[31m\\udcff\\x00é; allowed: none"
    assert error.worded(str.upper).startswith("ROBOT: got a")
    str(error).encode("utf-8")


@pytest.mark.parametrize("code", [0x1B, 0x61C, 0x202E, 0xD800])
def test_no_text_reorders_or_controls_a_terminal(code: int) -> None:
    assert printable(f"robot{chr(code)}cleared").isprintable()


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
