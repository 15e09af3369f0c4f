"""The report of the recovery benchmark: statistics of the episodes."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.study.paper.evidence import clustered_error
from tests.study.made_up_recovery import DELAY_S, PACE_HZ, changed, findings, on_line


@pytest.mark.slow
def test_the_report_is_one_page_with_all_walks_beside_it(tmp_path: Path) -> None:
    import pyarrow.parquet as pq

    made = findings()
    assert made.plan.write(made.rows, tmp_path) == tmp_path / "recovery.html"
    assert {path.name for path in tmp_path.iterdir()} == {"recovery.html", "recovery.parquet"}
    text = (tmp_path / "recovery.html").read_text(encoding="utf-8")
    for words in ("worlds 200 to 201 of transfer and real", "Gaits tripod", "1 cm and 0.5 degrees", "By leg",
                  "16 in 4 worlds", "HexaHeal"):  # fmt: skip
        assert words in text, words
    rows = pq.read_table(tmp_path / "recovery.parquet").to_pylist()
    assert len(rows) == len(made.episodes)
    row = next(row for row in rows if row["method"] == "recover" and row["failure"] == "stuck:tibia")
    assert (row["robot"], row["protocol"], row["family"], row["world"], row["gait"]) == (
        "ant", "line", "transfer", 200, "tripod")  # fmt: skip
    assert (row["right_kind"], row["matters"], row["fell"], row["early_alarms"]) == (True, True, False, 0)
    assert [(one["leg"], one["kind"], one["joint"]) for one in row["alarms"]] == [(2, "stuck", "tibia")]
    (intact, *_) = [row for row in rows if row["failure"] == "intact"]
    assert (intact["matters"], intact["delay_s"]) == (None, None)


def test_statistics_are_those_of_the_episodes() -> None:
    made = findings()
    assert int(made.rows["judged"].sum()) == 3 * 2 * 2 * 4
    found = made.statistics("recover")
    recover = on_line("recover")
    some = [(f"{place.family}:{place.number}", one) for place, one in made.episodes if recover(place, one)]
    final_m, worlds = np.array([one.final_m for _, one in some]), np.array([world for world, _ in some])
    assert (found["episodes"], found["worlds"], found["matter"]) == (16, 4, 16)
    assert [found[name] for name in ("right_leg", "right_kind", "early")] == [16, 16, 0]
    assert found["delay_median"] == pytest.approx(DELAY_S * PACE_HZ)
    assert found["mean_m"] == pytest.approx(final_m.mean())
    assert found["mean_error_m"] == pytest.approx(float(clustered_error(final_m, worlds)))
    assert found["max_m"] == final_m.max()
    assert found["way_p99_m"] == pytest.approx(0.06)
    assert (found["kept"], found["kept_worst"]) == pytest.approx((0.9, 0.9))
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
