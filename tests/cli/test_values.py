"""Values of options: ranges, what was typed, and what has a value."""

import math
import re
from typing import Any

import pytest
import typer

from hexctl.cli.values import given
from hexctl.options import Range


@pytest.mark.parametrize(
    ("allowed", "text", "inside", "outside"),
    [
        (Range(low=0, whole=True), "0 or more", ["0", "12"], ["-1", "1.5", "x", "nan", ""]),
        (Range(low=1, high=6, whole=True), "1..6", ["1", "6"], ["0", "7"]),
        (Range(low=1, high=100_000, whole=True), "1..100000", ["100000"], ["100001"]),
        (Range(low=0, high=10, above=True), "above 0 up to 10", ["1e-9", "10"], ["0", "-0.0", "10.1", "nan"]),
        (Range(low=0, above=True), "above 0", ["1e9"], ["0", "inf"]),
        (Range(low=-360, high=360), "-360..360", ["-360", "0", "360"], ["361", "-inf"]),
        (Range(), "any finite number", ["-1e300"], ["nan", "inf", "one"]),
    ],
    ids=str,
)
def test_a_range_takes_what_it_says(allowed: Range, text: str, inside: list[str], outside: list[str]) -> None:
    assert str(allowed) == text
    assert [allowed.parse(number) for number in inside] == [float(number) for number in inside]
    for number in outside:
        with pytest.raises(ValueError, match=f"got '?{re.escape(number)}'?; allowed: "):
            allowed.parse(number)


def test_only_short_ranges_of_whole_numbers_are_offered_by_the_shell() -> None:
    assert Range(low=1, high=6, whole=True).complete("") == ["1", "2", "3", "4", "5", "6"]
    assert Range(low=1, high=6, whole=True).complete("4") == ["4"]
    for long in (Range(low=0, whole=True), Range(low=1, high=1000, whole=True), Range(low=0, high=1)):
        assert long.complete("") == []
    assert not math.isfinite(Range(low=0).high)


def test_what_was_typed_is_told_from_defaults() -> None:
    seen: dict[str, Any] = {}
    probe = typer.Typer()

    @probe.command()
    def command(context: typer.Context, robot: str = "ant", seed: int = 0) -> None:
        seen.update(given(context), values=(robot, seed))

    probe(["--seed", "0"], standalone_mode=False)
    assert seen == {"--seed": 0, "values": ("ant", 0)}
