"""Statistics of the episodes, and bars."""

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hexctl.study.paper.evidence import clustered_error
from hexctl.study.recovery.recovery_plan import HEXAHEAL, SECOND
from hexctl.study.recovery.recovery_report import divisions
from tests.robots import shipped
from tests.study.recovery.made_up import DELAY_S, PACE_HZ, alarm, bars_of, changed, findings, on_line


def test_statistics_are_those_of_the_episodes() -> None:
    made = findings()
    assert int(made.rows["judged"].sum()) == 3 * 2 * 2 * 4
    found = made.statistics("recover")
    recover = on_line("recover")
    some = [(f"{place.family}:{place.number}", one) for place, one in made.episodes if recover(place, one)]
    final_m, worlds = np.array([one.final_m for _, one in some]), np.array([world for world, _ in some])
    assert (found["episodes"], found["worlds"], found["matter"]) == (16, 4, 16)
    assert [found[name] for name in ("right_leg", "right_kind", "early", "again")] == [16, 16, 0, 0]
    assert found["delay_median"] == pytest.approx(DELAY_S * PACE_HZ)
    assert found["mean_m"] == pytest.approx(final_m.mean())
    assert found["mean_error_m"] == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found["max_m"] == final_m.max()
    assert found["way_p99_m"] == pytest.approx(0.06)
    assert (found["kept"], found["kept_worst"]) == pytest.approx((0.9, 0.9))
    assert found["settled_median_s"] == 1.2
    assert [found[name] for name in ("fell", "others", "no_progress")] == [0, 0, 0]


def test_groups_divide_all_episodes() -> None:
    made = findings(robots=(shipped(), shipped("pexod")), gaits=("tripod", "wave"))
    groups: dict[str, dict[str, int]] = {}
    for division, name, some in divisions(made.rows):
        groups.setdefault(division, {})[name] = len(some)
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
        assert set(made.rows[made.rows["judged"]]["matters"]) == {matters}, changes


def test_robots_that_make_no_progress_while_intact_are_counted_apart() -> None:
    made = changed(
        findings(),
        lambda place, one: not one.case.legs and place.number == 201 and place.family == "real",
        status="no_progress",
    )
    aside = made.rows[made.rows["set_aside"]]
    assert set(zip(aside["family"], aside["world"], strict=True)) == {("real", 201)}
    assert (int(made.rows["judged"].sum()), len(aside)) == (36, 12)
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
    found = fallen.statistics("recover")
    assert (found["fell"], found["episodes"], found["kept_worst"]) == (4, 16, 0.0)
    assert found["kept"] == pytest.approx(0.9)
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
    names = ("recovered", "walks", "fell", "sets", "of_sets")
    assert [some.share("told", 1)[name] for name in names] == [5, 8, 3, 1, 2]
    assert [some.share("told", 2)[name] for name in names] == [4, 4, 0, 1, 1]
    assert some.share("nothing", 2)["recovered"] == 0
    assert [some.share("told", legs)["recovered"] for legs in ([2], [5], [2, 5])] == [1, 4, 4]


def test_an_alarm_of_the_second_leg_before_it_fails_is_wrong() -> None:
    made = findings(protocols=(SECOND,), runs=1)
    one = next(one for _, one in made.episodes if one.case.method == "recover")
    second = one.case.legs[1]
    early, late = (alarm(one.case, at_s=at_s, leg=second) for at_s in (12.0, 20.0))
    assert not replace(one, alarms=(early,)).right_leg
    assert replace(one, alarms=(late,)).right_leg
