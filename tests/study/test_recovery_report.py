"""The report of the recovery benchmark: statistics of the episodes, and bars."""

import math
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.study.paper.evidence import clustered_error
from hexctl.study.recovery import recovery_report as module
from hexctl.study.recovery.episodes import Episode, RecoveryPlace
from hexctl.study.recovery.recovery_plan import HEXAHEAL, SECOND
from tests.robots import shipped
from tests.study.made_up_recovery import (
    DELAY_S,
    PACE_HZ,
    Found,
    alarm,
    bars_of,
    changed,
    findings,
    on_line,
    plan,
)


@pytest.mark.slow
def test_the_report_is_one_page_with_a_figure_and_all_walks_beside_it(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    made = findings()
    assert made.plan.write(made.rows, tmp_path) == tmp_path / "recovery.html"
    assert {path.name for path in tmp_path.iterdir()} == {"recovery.html", "recovery.parquet", "recovery.svg"}
    text = (tmp_path / "recovery.html").read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == 1
    for words in ("worlds 200 to 201 of transfer and real", "Gaits tripod", "1 cm and 0.5 degrees", "By leg",
                  "16 in 4 worlds", "HexaHeal", "2 and 5", "not judged: 8 episodes, needs 1000"):  # fmt: skip
        assert words in text, words
    rows = pq.read_table(tmp_path / "recovery.parquet").to_pylist()
    assert len(rows) == len(made.episodes)
    row = next(row for row in rows if row["method"] == "recover" and row["failure"] == "stuck:tibia")
    assert (row["robot"], row["protocol"], row["family"], row["world"], row["gait"]) == (
        "ant", "line", "transfer", 200, "tripod")  # fmt: skip
    assert (row["legs"], row["noticed_leg"], row["noticed_kind"], row["noticed_joint"]) == (
        [2], 2, "stuck", "tibia")  # fmt: skip
    assert (row["right_kind"], row["matters"], row["fell"], row["early_alarms"]) == (True, True, False, 0)
    assert [one["leg"] for one in row["alarms"]] == [2]
    (intact, *_) = [row for row in rows if row["failure"] == "intact"]
    assert (intact["matters"], intact["noticed_leg"], intact["delay_s"]) == (None, None, None)


def test_bars_are_judged_by_enough_episodes_of_30_s(monkeypatch: pytest.MonkeyPatch) -> None:
    made = findings()
    bars = bars_of(made)
    assert len(bars) == 9
    few = {name for name, bar in bars.items() if bar.verdict.startswith("not judged: ")}
    assert few == {"right_leg", "right_joint", "falls"}
    assert {bar.verdict for name, bar in bars.items() if name not in few} == {"holds"}
    monkeypatch.setattr(module, "ENOUGH", 5)
    monkeypatch.setattr(module, "ENOUGH_JOINTS", 5)
    assert {bar.verdict for bar in bars_of(made).values()} == {"holds"}
    assert bars["pairs"].measured == "1 of 1; 2 of 2 walks"
    short = bars_of(Found(plan(duration_s=20.0), made.walks))
    assert short.pop("pairs").verdict == "holds"
    assert {bar.verdict for bar in short.values()} == {"not judged: walks of 20 s, needs at least 30 s"}


def test_bars_are_missed_by_what_they_forbid(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "ENOUGH", 5)
    monkeypatch.setattr(module, "ENOUGH_JOINTS", 5)
    made = findings()

    def missed(which: Any, **changes: Any) -> set[str]:
        return {name for name, bar in bars_of(changed(made, which, **changes)).items() if not bar.holds}

    recover = on_line("recover")
    case = next(one.case for place, one in made.episodes if recover(place, one))
    assert missed(recover, alarms=()) == {"right_leg", "right_joint", "delay"}
    late = (alarm(case, at_s=12.0),)
    of_case = (case.legs, case.failure)
    assert missed(lambda _, one: (one.case.legs, one.case.failure) == of_case, alarms=late) == {"delay"}
    assert missed(on_line("nothing", legs=False), alarms=late) == {"false_alarms"}
    assert missed(recover, settled_s=2.6) == missed(recover, settled_s=math.nan) == {"settled"}
    assert bars_of(changed(made, recover, settled_s=math.nan))["settled"].measured == "never"
    assert bars_of(changed(made, recover, after_m_s=math.nan))["kept"].measured.startswith("mean -, ")
    assert missed(recover, signed_m=0.009) == {"deviation"}
    assert missed(recover, after_m_s=0.1) == {"kept"}
    assert missed(lambda place, _: place.protocol == HEXAHEAL, last_m_s=0.0) == {"pairs"}


def test_a_second_leg_is_judged_among_the_pairs_that_recover_when_told() -> None:
    made = findings(legs=(2, 4, 5), protocols=(SECOND,), runs=4)
    numbers = made.plan.numbers(made.rows)
    sets = [one["legs"] for one in numbers["second_sets"] if one["method"] == "told"]
    assert (sets, numbers["hexaheal_sets"]) == ([[2, 4], [2, 5], [4, 5]], [])

    def of(method: str, legs: tuple[int, int]) -> Callable[[RecoveryPlace, Episode], bool]:
        return lambda _, one: one.case.method == method and tuple(sorted(one.case.legs)) == legs

    unable = changed(made, of("told", (2, 4)), last_m_s=0.0)
    assert bars_of(unable).keys() == {"second"}
    assert bars_of(unable)["second"].holds
    fails = changed(unable, of("recover", (2, 5)), status="fell")
    assert not bars_of(fails)["second"].holds
    assert "1 of 2 (of 3 pairs)" in bars_of(fails)["second"].measured
    two = findings(robots=(shipped(), shipped("pexod")), legs=(2, 4, 5), protocols=(SECOND,), runs=4)

    def by_pexod(place: RecoveryPlace, one: Episode) -> bool:
        return place.robot.name == "pexod" and one.case.method == "recover"

    one_fails = changed(two, by_pexod, status="fell")
    assert "3 of 6 (of 6 pairs)" in bars_of(one_fails)["second"].measured
    nobody = changed(made, lambda _, one: one.case.method == "told", last_m_s=0.0)
    assert bars_of(nobody)["second"].holds is None


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
