"""Options of a study: what each kind takes, and what is refused."""

from typing import Any

import pytest

from hexctl.errors import InputError, WrongTypeError
from hexctl.options import options_of
from hexctl.study.study_options import TAKEN_BY, StudyOptions


@pytest.mark.parametrize("kind", ["transfer", "matrix", "hold", "recovery"])
def test_a_study_is_of_the_kind_that_is_asked_for(kind: str) -> None:
    asked: dict[str, Any] = {kind: True}
    assert StudyOptions(**asked).kind == kind
    assert StudyOptions().kind == "paper"


@pytest.mark.parametrize(
    ("options", "option"),
    [
        ({"transfer": True, "hold": True}, "hold"),
        ({"prior": "auto"}, "prior"),
        ({"one_leg": True, "matrix": True}, "one_leg"),
        ({"time_steps_ms": (2.0,)}, "time_steps_ms"),
        ({"exact_sensors": True}, "exact_sensors"),
        ({"hold": True, "seed": 3}, "seed"),
        ({"hold": True, "gaits": ("wave",)}, "gaits"),
        ({"recovery": True, "optimizers": ("pso",)}, "optimizers"),
        ({"recovery": True, "dask": "tcp://127.0.0.1:1"}, "dask"),
        ({"transfer": True, "self_rotation": "front"}, "self_rotation"),
        ({"self_rotation": "left"}, "self_rotation"),
        ({"runs": 1000}, "runs"),
        ({"jobs": 0}, "jobs"),
        ({"duration_s": float("nan")}, "duration_s"),
    ],
)
def test_what_a_kind_of_study_does_not_take_is_refused(options: dict[str, Any], option: str) -> None:
    with pytest.raises(InputError, match=f"^{option}: got "):
        StudyOptions(**options)


def test_a_wrong_type_is_refused_by_name() -> None:
    options: dict[str, Any] = {"worlds": "three"}
    with pytest.raises(WrongTypeError, match=r"^worlds: got 'three'"):
        StudyOptions(**options)


def test_the_table_of_kinds_names_options_that_there_are() -> None:
    assert set(TAKEN_BY) <= {option.name for option in options_of(StudyOptions)}
