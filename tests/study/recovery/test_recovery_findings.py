"""Statistics of the episodes, and bars."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.study.recovery.recovery_plan import HEXAHEAL, SECOND
from hexctl.study.verdicts.claim_evidence import clustered_error
from tests.robots import shipped
from tests.study.recovery.made_up import DELAY_S, PACE_HZ, alarm, bars_of, changed, findings, on_line


def test_statistics_are_those_of_the_episodes() -> None:
    made = findings()
    division, name, rows = next(made.groups())
    assert (division, name, len(rows)) == ("all", "one leg or joint failed", 3 * 2 * 2 * 4)
    found = made.statistics(rows, "recover")
    some = [row for row in rows if row.episode.case.method == "recover"]
    final_m = np.array([row.episode.final_m for row in some])
    worlds = np.array([row.world for row in some])
    assert (found.episodes, found.worlds, found.matter) == (16, 4, 16)
    assert (found.right_leg, found.right_kind, found.early, found.again) == (16, 16, 0, 0)
    assert found.delay_median == pytest.approx(DELAY_S * PACE_HZ)
    assert found.mean_m == pytest.approx(final_m.mean())
    assert found.mean_error_m == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found.max_m == final_m.max()
    assert found.way_p99_m == pytest.approx(0.06)
    assert (found.kept, found.kept_worst) == pytest.approx((0.9, 0.9))
    assert found.settled_median_s == 1.2
    assert (found.fell, found.others, found.no_progress) == (0, 0, 0)


def test_groups_divide_all_episodes() -> None:
    made = findings(robots=(shipped(), shipped("pexod")), gaits=("tripod", "wave"))
    groups: dict[str, dict[str, int]] = {}
    for division, name, rows in made.groups():
        groups.setdefault(division, {})[name] = len(rows)
    total = groups["all"]["one leg or joint failed"]
    assert groups["kind"] == {"whole legs": total // 2, "locked": total // 2, "stuck joint": total // 2}
    for division in ("failure", "robot", "gait", "family", "leg", "kind of world"):
        assert sum(groups[division].values()) == total
    assert list(groups["gait"]) == ["tripod", "wave"]


def test_a_failure_matters_that_changes_the_walk_in_which_nothing_is_done() -> None:
    harmless = changed(findings(), on_line("nothing"), signed_m=0.0, after_m_s=0.14)
    cases: list[tuple[dict[str, Any], bool]] = [
        ({}, False),
        ({"signed_m": -0.0191}, True),
        ({"signed_m": -0.018}, False),
        ({"after_m_s": 0.13}, True),
        ({"status": "fell", "after_m_s": math.nan}, True),
    ]
    for changes, matters in cases:
        made = changed(harmless, on_line("nothing"), **changes)
        assert {row.matters for row in made.judged} == {matters}, changes


def test_robots_that_make_no_progress_while_intact_are_counted_apart() -> None:
    made = changed(
        findings(),
        lambda place, one: not one.case.legs and place.number == 201 and place.family == "real",
        status="no_progress",
    )
    assert {row.world for row in made.set_aside} == {"real:201"}
    assert (len(made.judged), len(made.set_aside)) == (36, 12)
    assert "in 1 intact walk" not in bars_of(made)["deviation"].measured
    assert "0 in 4 intact walks without progress" in bars_of(made)["false_alarms"].measured


def test_walks_that_fell_have_no_end_and_no_speed() -> None:
    made = findings()
    fallen = changed(
        made,
        lambda place, one: (
            on_line("recover")(place, one) and one.case.legs == (2,) and one.case.failure == "locked"
        ),
        status="fell",
        signed_m=math.nan,
        after_m_s=math.nan,
    )
    _, _, rows = next(fallen.groups())
    found = fallen.statistics(rows, "recover")
    assert (found.fell, found.episodes, found.kept_worst) == (4, 16, 0.0)
    assert found.kept == pytest.approx(0.9)
    bars = bars_of(fallen)
    assert bars["falls"].holds is False
    assert bars["falls"].measured == "4 fell, 0 diverged or were stopped, of 16"
    assert bars["kept"].holds is False


def test_hexaheals_rule_counts_walks_and_sets_of_legs() -> None:
    made = findings(runs=4)
    some = changed(
        made,
        lambda place, one: place.protocol == HEXAHEAL and one.case.legs == (2,) and place.number > 0,
        status="fell",
    )
    one, two = some.rule_share("told", 1), some.rule_share("told", 2)
    assert (one.recovered, one.walks, one.fell, one.sets, one.of_sets) == (5, 8, 3, 1, 2)
    assert (two.recovered, two.walks, two.fell, two.sets, two.of_sets) == (4, 4, 0, 1, 1)
    assert some.rule_share("nothing", 2).recovered == 0
    assert some.leg_sets() == [(2,), (5,), (2, 5)]
    assert [some.rule_share("told", legs).recovered for legs in some.leg_sets()] == [1, 4, 4]


def test_an_alarm_of_the_second_leg_before_it_fails_is_wrong() -> None:
    made = findings(protocols=(SECOND,), runs=1)
    one = next(one for _, one in made.episodes if one.case.method == "recover")
    second = one.case.legs[1]
    early, late = (alarm(one.case, at_s=at_s, leg=second) for at_s in (12.0, 20.0))
    assert not replace(one, alarms=(early,)).right_leg
    assert replace(one, alarms=(late,)).right_leg


def test_groups_keep_the_order_of_the_plan_where_some_are_counted_apart() -> None:
    made = findings(failures=("locked", "limp", "missing"))
    some = changed(made, lambda _, one: not one.case.legs and one.case.heading_deg != 0, status="no_progress")
    kinds = [name for division, name, _ in some.groups() if division == "kind"]
    assert kinds == [name for name in ("whole legs", "locked", "limp", "missing") if name in kinds]
    assert all(rows for _, _, rows in some.groups())
