"""Statistics of the compared walks, and bars."""

from dataclasses import replace

import numpy as np
import pytest

from hexctl.study.holds.hold_conditions import HoldCase
from hexctl.study.holds.hold_findings import HoldFindings, hold_bars
from hexctl.study.verdicts.claim_evidence import clustered_error
from tests.robots import shipped
from tests.study.holds.made_up import findings, plan, walk

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


def test_statistics_are_those_of_the_walks() -> None:
    made = findings()
    division, name, damaged = next(made.groups())
    assert (division, name) == ("all", "one leg failed")
    found = made.statistics("line", damaged)
    walks = [one for _, one in made.walks if one.case.hold == "line" and one.case.leg]
    worlds = np.array([f"{place.family}{place.number}" for place, one in made.walks
                       if one.case.hold == "line" and one.case.leg])  # fmt: skip
    final_m = np.array([one.final_m for one in walks])
    assert (found.walks, found.worlds) == (6 * 2 * 2, 6)
    assert found.mean_m == pytest.approx(final_m.mean())
    assert found.mean_error_m == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found.p90_m == pytest.approx(np.percentile(final_m, 90))
    assert found.max_m == final_m.max()
    assert found.way_p90_m == pytest.approx(2 * found.p90_m)
    assert (found.no_progress, found.fell, found.others) == (0, 0, 0)
    assert found.over_ideal == pytest.approx(0.9)
    assert found.over_open == pytest.approx(0.9 / 0.8)


def test_groups_divide_all_walks_of_a_failed_leg() -> None:
    made = findings(robots=(shipped(), shipped("pexod")))
    groups: dict[str, dict[str, int]] = {}
    for division, name, which in made.groups():
        groups.setdefault(division, {})[name] = int(which.sum())
    assert list(groups) == ["all", "failure", "robot", "family", "leg", "kind of world", "floor"]
    assert groups["failure"] == {"intact": 12, "locked": 24, "limp": 24}
    for division in ("robot", "family", "leg", "kind of world", "floor"):
        assert sum(groups[division].values()) == groups["all"]["one leg failed"] == 48
    assert set(groups["floor"]) == {"even", "rough"}


def test_walks_without_progress_count_and_fallen_ones_are_counted_apart() -> None:
    made = plan(families=dict(list(plan().families.items())[:1]), worlds=1, legs=(2,))
    (place,) = made.conditions()
    status = {("locked", "line"): "no_progress", ("limp", "line"): "fell", ("limp", "heading"): "aborted"}
    walks = [
        (place, walk(case, 0.5, status=status.get((case.failure, case.hold), "ok"), speed=0.3))
        for case in made.cases()
    ]
    found = HoldFindings(plan=made, walks=walks)
    _, _, damaged = next(found.groups())
    line, heading = found.statistics("line", damaged), found.statistics("heading", damaged)
    assert (line.mean_m, line.no_progress, line.fell, line.others) == (0.5, 1, 1, 0)
    assert (heading.mean_m, heading.no_progress, heading.fell, heading.others) == (0.5, 0, 0, 1)
    assert line.over_open == pytest.approx(1.0)
    assert np.isnan(line.mean_error_m)  # a single world
    bars = {bar.name: bar for bar in hold_bars(found)}
    assert bars["line_no_progress"].measured == "1 of 2, 50.0%"
    assert not bars["line_no_progress"].holds
    assert bars["line_falls"].measured == "1 fell, 0 diverged or were stopped"
    assert not bars["line_falls"].holds


def test_where_nothing_ended_there_is_no_number_and_no_bar_holds() -> None:
    made = plan(worlds=1)
    walks = [(place, walk(case, 0.1, status="fell")) for place in made.conditions() for case in made.cases()]
    found = HoldFindings(plan=made, walks=walks)
    _, _, damaged = next(found.groups())
    assert np.isnan(found.statistics("line", damaged).mean_m)
    assert {bar.holds for bar in hold_bars(found) if bar.name != "line_no_progress"} == {False}


def test_bars_are_judged_by_their_numbers_and_on_walks_of_30_s_only() -> None:
    made = findings()
    bars = {bar.name: bar for bar in hold_bars(made)}
    assert set(bars) == EVERY_BAR
    assert {bar.verdict for bar in bars.values()} == {"holds"}
    assert bars["line_rough"].asked.endswith("at most 1.2 cm (stretch: 0.8 cm)")
    far = [(place, replace(one, signed_m=20 * one.signed_m)) for place, one in made.walks]
    missed = {bar.name for bar in hold_bars(replace(made, walks=far)) if not bar.holds}
    assert missed == {"line_mean", "line_p90", "line_max", "line_rough", "heading_mean", "heading_p90",
                      "intact_mean", "intact_max"}  # fmt: skip
    short = replace(made, plan=replace(made.plan, duration_s=10.0))
    assert {bar.verdict for bar in hold_bars(short)} == {"not judged: walks of 10 s, needs at least 30 s"}


def test_bars_are_those_of_what_was_walked() -> None:
    assert {bar.name for bar in hold_bars(findings(holds=("none", "heading")))} == {
        "heading_mean",
        "heading_p90",
    }
    line = {bar.name for bar in hold_bars(findings(holds=("line",)))}
    assert line == EVERY_BAR - {"heading_mean", "heading_p90", "line_over_open"}


def test_a_case_without_a_leg_has_no_failure() -> None:
    assert HoldCase(leg=0, failure="intact", hold="line").leg_failure is None
