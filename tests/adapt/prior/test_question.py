"""What a prior is an answer to, and in which words another question differs."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.robot.failure import Failure, parse_failure
from hexctl.robot.loader import load_robot
from tests.adapt.priors import question_of
from tests.robots import edited_file, put, shipped


def test_the_same_question_differs_in_nothing() -> None:
    assert question_of().differences(question_of()) == []


@pytest.mark.parametrize("options", [{"failure": Failure(leg=2)}, {"heading_rad": 1.0}])
def test_neither_leg_nor_heading_makes_another_question(options: dict[str, Any]) -> None:
    # The failed leg points to the rear of wherever the robot goes.
    assert question_of().differences(question_of(**options)) == []


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"duration_s": 12.5}, "duration 30 s, not 12.5 s"),
        ({"self_rotation": "front"}, "self-rotation rear, not front"),
        ({"failure": Failure(leg=5, kind="limp")}, "failure locked, not limp"),
        ({"failure": parse_failure(5, "weak:0.5")}, "failure locked, not weak:0.5"),
    ],
)
def test_another_trial_is_named_with_both_values(options: dict[str, Any], words: str) -> None:
    assert question_of().differences(question_of(**options)) == [words]


def test_without_self_rotation_the_heading_makes_another_question() -> None:
    """The body does not turn to where it goes: it walks forward, or to its side."""
    forward, left = (
        question_of(self_rotation="none", heading_rad=heading_rad) for heading_rad in (0.0, math.pi / 2)
    )
    assert forward.differences(left) == ["heading 0 deg, not 90 deg"]


def test_a_failure_in_another_degree_is_another_question() -> None:
    weak, weaker = (question_of(failure=parse_failure(5, f"weak:{share}")) for share in (0.5, 0.25))
    assert weak.differences(weaker) == ["failure weak:0.5, not weak:0.25"]


def test_another_gait_is_another_question() -> None:
    question = question_of()
    assert question.differences(replace(question, pace_hz=0.75)) == ["pace 0.9 Hz, not 0.75 Hz"]
    assert question.differences(replace(question, amplitude=0.05)) == ["amplitude 0.11, not 0.05"]
    assert question.differences(replace(question, height=0.03)) == ["height 0.02, not 0.03"]


def test_another_robot_is_named_once() -> None:
    differences = question_of().differences(question_of(shipped("phantomx")))
    assert "robot ant, not phantomx" in differences
    assert not any("description" in words or "fingerprint" in words for words in differences)


def test_the_same_robot_with_another_description_is_another_question(tmp_path: Path) -> None:
    heavier = load_robot(str(edited_file(tmp_path, put("body", "mass_kg", 3.0))))
    assert question_of().differences(question_of(heavier)) == ["another description of ant"]


def test_all_differences_are_named() -> None:
    other = question_of(duration_s=5.0, self_rotation="none", failure=Failure(leg=1, kind="missing"))
    assert question_of().differences(other) == [
        "failure locked, not missing",
        "self-rotation rear, not none",
        "duration 30 s, not 5 s",
    ]
