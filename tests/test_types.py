"""The vocabulary of every part: the order of the joints, and values with arrays that compare and copy."""

import ast
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import hexctl
from hexctl.errors import InputError, WrongTypeError
from hexctl.types import (
    JOINT_NAMES,
    N_JOINTS,
    ArrayFields,
    FloatArray,
    JointTargets,
    RobotState,
    ServoReadings,
    check_shape,
    leg_slice,
)


def test_a_leg_is_found_in_an_array_of_joints() -> None:
    for leg in range(1, 7):
        assert JOINT_NAMES[leg_slice(leg)] == tuple(f"leg{leg}_{kind}" for kind in ("coxa", "femur", "tibia"))


def a_state() -> RobotState:
    return RobotState(
        np.linspace(0, 1, N_JOINTS),
        stamp_s=1.5,
        measured=True,
        base_position_world=np.array([0.1, np.nan, 0.3]),
        foot_contacts=np.array([True, False] * 3),
    )


CHANGES: list[dict[str, Any]] = [
    {"joint_positions_rad": np.zeros(N_JOINTS)},
    {"joint_positions_rad": np.zeros((2, N_JOINTS))},
    {"base_position_world": None},
    {"base_quaternion_world": np.array([1.0, 0, 0, 0])},
    {"foot_contacts": np.array([False, True] * 3)},
    {"stamp_s": 2.0},
    {"measured": False},
    {"joint_torques_nm": np.zeros(N_JOINTS)},
]


def test_states_and_targets_are_equal_exactly_if_all_they_hold_is() -> None:
    assert a_state() == a_state()
    assert JointTargets(np.zeros(N_JOINTS), 1.0) == JointTargets(np.zeros(N_JOINTS), 1.0)
    assert JointTargets(np.zeros(N_JOINTS), 1.0) != JointTargets(np.ones(N_JOINTS), 1.0)
    assert JointTargets(np.zeros(N_JOINTS), float("nan")) == JointTargets(np.zeros(N_JOINTS), float("nan"))
    assert a_state() != JointTargets(np.zeros(N_JOINTS), 1.5)
    assert a_state() != None  # noqa: E711  the comparison itself must not raise
    for change in CHANGES:
        assert a_state() != replace(a_state(), **change), change
    with pytest.raises(TypeError, match="unhashable"):
        hash(a_state())


def test_arrays_within_containers_are_compared_too() -> None:
    @dataclass(frozen=True, eq=False)
    class Paths(ArrayFields):
        by_name: dict[str, tuple[FloatArray, ...]]

    def paths(end: float) -> Paths:
        return Paths({"first": (np.zeros(2), np.array([0.0, end]))})

    assert paths(1.0) == paths(1.0)
    assert paths(1.0) != paths(2.0)
    assert paths(1.0) != Paths({"second": paths(1.0).by_name["first"]})
    assert paths(1.0) != Paths({"first": (np.zeros(2),)})


def test_a_copy_of_a_state_is_equal_and_has_arrays_of_its_own() -> None:
    state = a_state()
    copy = state.copy()
    assert copy == state
    copy.joint_positions_rad[0] = 9
    assert state == a_state()
    assert copy != state


def _readings() -> ServoReadings:
    return ServoReadings(
        ages_s=np.array([0.25] * 17 + [np.inf]),
        efforts=np.linspace(-1, 1, 18).round(3),
        currents_a=np.full(18, np.nan),
        voltages_v=np.full(18, 11.9),
        temperatures_c=np.array([40.0] * 4 + [61.5] + [np.nan] * 13),
        errors=("overload",) + ("",) * 17,
    )


def test_readings_of_servos_come_back_from_json() -> None:
    text = json.dumps(_readings().to_json(), allow_nan=False)
    readings = ServoReadings.from_json(json.loads(text))
    assert readings == _readings()
    assert readings.hottest_joint == 4
    assert replace(readings, temperatures_c=np.full(18, np.nan)).hottest_joint is None


@pytest.mark.parametrize("broken", [{"ages_s": [1.0] * 17}, {"errors": []}, {"voltages_v": ["a"] * 18}])
def test_readings_of_other_servos_are_refused(broken: dict[str, Any]) -> None:
    with pytest.raises((KeyError, TypeError, ValueError)):
        ServoReadings.from_json({**_readings().to_json(), **broken})
    with pytest.raises(KeyError):
        ServoReadings.from_json({})


def test_a_wrong_array_is_refused_with_its_shape() -> None:
    check_shape(np.zeros((6, 3)), (6, 3), "feet")
    with pytest.raises(InputError, match=r"feet: got an array of shape \(3,\); allowed: shape \(6, 3\)"):
        check_shape(np.zeros(3), (6, 3), "feet")
    with pytest.raises(
        WrongTypeError, match=r"feet: got \[1, 2\] \(list\); allowed: an array of shape \(6, 3\)"
    ):
        check_shape([1, 2], (6, 3), "feet")


def frozen_classes_with_arrays(folder: Path) -> list[tuple[Path, ast.ClassDef]]:
    """Frozen dataclasses of a folder that have an array among their fields."""
    return [
        (path, node)
        for path in sorted(folder.rglob("*.py"))
        if "Array" in (text := path.read_text(encoding="utf-8")) and "frozen=True" in text
        for node in ast.walk(ast.parse(text))
        if isinstance(node, ast.ClassDef)
        and any("frozen=True" in ast.unparse(decorator) for decorator in node.decorator_list)
        and any(isinstance(line, ast.AnnAssign) and "Array" in ast.unparse(line) for line in node.body)
    ]


@pytest.mark.parametrize(
    "part", ["adapt", "backends", "control", "ik", "recording", "robot", "study", "wire"]
)
def test_no_frozen_value_with_arrays_has_an_equality_that_raises(part: str) -> None:
    found = frozen_classes_with_arrays(Path(hexctl.__file__).parent / part)
    assert found
    for path, node in found:
        decorators = " ".join(map(ast.unparse, node.decorator_list))
        assert "eq=False" in decorators, f"{path}: {node.name} needs eq=False and the base ArrayFields"
