"""The report of a comparison of holds."""

import json
import re
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from tests.study.made_up_holds import plan, rows


@pytest.mark.slow
def test_the_report_is_one_page_with_figures_and_all_walks_beside_it(tmp_path: Path) -> None:
    made = rows()
    assert plan().write(made, tmp_path) == tmp_path / "holds.html"
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {"holds.html", "holds.parquet", "holds.svg", "holds_by_failure.svg"}
    text = (tmp_path / "holds.html").read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == 2
    for words in ("worlds 250 to 252 of transfer and real", "open loop", "yaw alone", "1 cm and 0.5 degrees",
                  "By kind of world", "24 in 6 worlds", "holds"):  # fmt: skip
        assert words in text, words
    table = pq.read_table(tmp_path / "holds.parquet")
    assert table.num_rows == len(made)
    row, last = table.to_pylist()[-1], made.iloc[-1]
    assert (row["robot"], row["family"], row["world"], row["kind"]) == (
        "ant", "real", 252, last["kind_of_world"])  # fmt: skip
    assert (row["leg"], row["failure"], row["hold"]) == (5, "limp", "line")
    assert (row["final_m"], row["status"], row["slots"]) == (last["final_m"], "ok", [1, 2, 3, 4, 5, 6])


def test_the_json_has_every_number_of_the_tables() -> None:
    made, asked = rows(exact_sensors=True), plan(exact_sensors=True)
    values = json.loads(json.dumps(asked.numbers(made), allow_nan=False))
    assert values["sensors"] is None
    assert values["walks"] == len(made)
    records = asked.statistics(made)
    assert [one["hold"] for one in values["statistics"][:3]] == ["none", "heading", "line"]
    assert len(values["statistics"]) == len(records) > 30
    assert values["statistics"][0]["mean_m"] == records[0]["mean_m"]
    assert {bar["holds"] for bar in values["bars"]} == {True}


def test_the_summary_is_a_table_with_a_row_for_each_hold_and_the_verdicts() -> None:
    lines = plan().lines(rows())
    assert len({line.count("|") for line in lines[:5]}) == 1
    assert re.match(r"\| one leg failed \| pose \| 24 in 6 worlds \| 0\.\d\d cm ± 0\.\d\d cm \|", lines[4])
    assert lines[5].startswith("holds ")


def test_a_single_world_has_no_standard_error() -> None:
    one = {"worlds": 1, "families": {"transfer": plan().families["transfer"]}}
    assert "±" not in plan(**one).lines(rows(**one))[4]
