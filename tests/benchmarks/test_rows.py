"""Rows of the benchmarks: bars and verdicts."""

import pytest

from benchmarks.rows import Bar, Row


@pytest.mark.parametrize(
    ("bar", "text", "inside", "outside"),
    [
        (Bar(low=0.9), ">= 0.9", 0.9, 0.89),
        (Bar(high=1.25), "<= 1.25", 1.25, 1.26),
        (Bar(30, 70), "30..70", 70, 71),
    ],
)
def test_a_bar_is_shown_and_includes_its_ends(bar: Bar, text: str, inside: float, outside: float) -> None:
    assert str(bar) == text
    assert bar.holds(inside)
    assert not bar.holds(outside)


def test_a_row_without_a_bar_neither_holds_nor_fails() -> None:
    assert Row("x", 1.0, "s").as_json() == {
        "name": "x",
        "value": 1.0,
        "unit": "s",
        "bar": None,
        "holds": None,
        "note": "",
    }


def test_a_row_without_a_value_does_not_clear_its_bar() -> None:
    assert Row("x", None, "gaits", Bar(low=1)).as_json()["holds"] is False


def test_the_verdict_is_of_the_value_before_rounding() -> None:
    row = Row("x", 1.250004, "ratio", Bar(high=1.25))
    assert row.as_json()["value"] == 1.25
    assert row.holds is False
