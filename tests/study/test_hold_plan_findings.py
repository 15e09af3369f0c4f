"""Statistics of the compared walks, and bars."""

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.study.held_out import INTACT
from hexctl.study.hold_plan import HoldPlan, statistics
from hexctl.study.hold_walks import HoldCase
from hexctl.study.paper.evidence import clustered_error
from tests.robots import shipped
from tests.study.made_up_holds import made_up_walks, plan, rows, rows_of, walk

EVERY_BAR = {
    "line_mean",
    "line_p90",
    "line_max",
    "line_way",
    "line_rough",
    "line_no_progress",
    "line_falls",
    "line_over_open",
    "line_over_ideal",
    "heading_mean",
    "heading_p90",
    "intact_mean",
    "intact_max",
}


def of_failed_legs(made: Any, hold: str) -> dict[str, Any]:
    return statistics(made[(made["hold"] == hold) & (made["failure"] != INTACT)])


def bars_of(made: Any, **options: Any) -> dict[str, Any]:
    return {bar.name: bar for bar in plan(**options).bars(made)}


def test_statistics_are_those_of_the_walks() -> None:
    found = of_failed_legs(rows(), "line")
    walks = [
        (f"{place.family}{place.number}", one)
        for (place, _), some in zip(plan().walked(), made_up_walks(plan()), strict=True)
        for one in some
        if one.case.hold == "line" and one.case.leg
    ]
    worlds, final_m = (
        np.array([world for world, _ in walks]),
        np.array([abs(one.signed_m) for _, one in walks]),
    )
    assert (found["walks"], found["worlds"]) == (6 * 2 * 2, 6)
    assert found["mean_m"] == pytest.approx(final_m.mean())
    assert found["mean_error_m"] == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found["p90_m"] == pytest.approx(np.percentile(final_m, 90))
    assert found["max_m"] == final_m.max()
    assert found["way_p90_m"] == pytest.approx(2 * found["p90_m"])
    assert (found["no_progress"], found["fell"], found["others"]) == (0, 0, 0)
    assert found["over_ideal"] == pytest.approx(0.9)
    assert found["over_open"] == pytest.approx(0.9 / 0.8)


def test_groups_divide_all_walks_of_a_failed_leg() -> None:
    groups: dict[str, dict[str, int]] = {}
    for division, name, some in HoldPlan.divisions(
        rows(robots=(shipped(), shipped("pexod")), holds=("line",))
    ):
        groups.setdefault(division, {})[name] = len(some)
    assert list(groups) == ["all", "failure", "robot", "family", "leg", "kind of world", "floor"]
    assert groups["failure"] == {"intact": 12, "locked": 24, "limp": 24}
    for division in ("robot", "family", "leg", "kind of world", "floor"):
        assert sum(groups[division].values()) == groups["all"]["one leg failed"] == 48
    assert set(groups["floor"]) == {"even", "rough"}


def test_walks_without_progress_count_and_fallen_ones_are_counted_apart() -> None:
    one_world = {"families": {"transfer": plan().families["transfer"]}, "worlds": 1, "legs": (2,)}
    made = plan(**one_world)
    status = {("locked", "line"): "no_progress", ("limp", "line"): "fell", ("limp", "heading"): "aborted"}
    walks = [
        walk(case, 0.5, status=status.get((case.failure, case.hold), "ok"), speed=0.3)
        for case in made.cases()
    ]
    found = rows_of(made, [walks])
    line, heading = of_failed_legs(found, "line"), of_failed_legs(found, "heading")
    names = ("mean_m", "no_progress", "fell", "others")
    assert [line[name] for name in names] == [0.5, 1, 1, 0]
    assert [heading[name] for name in names] == [0.5, 0, 0, 1]
    assert line["over_open"] == pytest.approx(1.0)
    assert np.isnan(line["mean_error_m"])  # a single world
    bars = bars_of(found, **one_world)
    assert bars["line_no_progress"].measured == "1 of 2, 50.0%"
    assert not bars["line_no_progress"].holds
    assert bars["line_falls"].measured == "1 fell, 0 diverged or were stopped"
    assert not bars["line_falls"].holds


def test_where_nothing_ended_there_is_no_number_and_no_bar_holds() -> None:
    made = plan(worlds=1)
    walks = [[walk(case, 0.1, status="fell") for case in cases] for _, cases in made.walked()]
    found = rows_of(made, walks)
    assert np.isnan(of_failed_legs(found, "line")["mean_m"])
    assert {bar.holds for name, bar in bars_of(found).items() if name != "line_no_progress"} == {False}


def test_bars_are_judged_by_their_numbers_and_on_walks_of_30_s_only() -> None:
    bars = bars_of(rows())
    assert set(bars) == EVERY_BAR
    assert {bar.verdict for bar in bars.values()} == {"holds"}
    assert bars["line_rough"].asked.endswith("at most 1.2 cm (stretch: 0.8 cm)")
    walks = [[replace(one, signed_m=20 * one.signed_m) for one in some] for some in made_up_walks(plan())]
    missed = {name for name, bar in bars_of(rows_of(plan(), walks)).items() if not bar.holds}
    assert missed == {"line_mean", "line_p90", "line_max", "line_rough", "heading_mean", "heading_p90",
                      "intact_mean", "intact_max"}  # fmt: skip
    short = bars_of(rows(), duration_s=10.0)
    assert {bar.verdict for bar in short.values()} == {"not judged: walks of 10 s, needs at least 30 s"}


def test_bars_are_those_of_what_was_walked() -> None:
    assert set(bars_of(rows(holds=("none", "heading")))) == {"heading_mean", "heading_p90"}
    line = set(bars_of(rows(holds=("line",))))
    assert line == EVERY_BAR - {"heading_mean", "heading_p90", "line_over_open"}


def test_a_case_without_a_leg_has_no_failure() -> None:
    assert HoldCase(leg=0, failure="intact", hold="line").leg_failure is None
