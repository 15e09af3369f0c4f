"""The report of a comparison of holds."""

import json
import re
from pathlib import Path

import pyarrow.parquet as pq

from hexctl.study.holds.hold_report import FIGURES, REPORT, TABLE, holds_json, holds_lines, write_hold_report
from tests.study.holds.made_up import findings


def test_the_report_is_one_page_with_figures_and_all_walks_beside_it(tmp_path: Path) -> None:
    made = findings()
    assert write_hold_report(made, tmp_path) == tmp_path / REPORT
    names = {path.name for path in tmp_path.iterdir()}
    assert names == {REPORT, TABLE, *(f"{name}.svg" for name in FIGURES)}
    text = (tmp_path / REPORT).read_text(encoding="utf-8")
    assert text.count("data:image/svg+xml;base64,") == 2
    for words in ("worlds 250 to 252 of transfer and real", "open loop", "yaw alone", "1 cm and 0.5 degrees",
                  "By kind of world", "24 in 6 worlds", "holds"):  # fmt: skip
        assert words in text, words
    table = pq.read_table(tmp_path / TABLE)
    assert table.num_rows == len(made.walks)
    row = table.to_pylist()[-1]
    place, walk = made.walks[-1]
    assert (row["robot"], row["family"], row["world"], row["kind"]) == (
        "ant", "real", 252, place.kind)  # fmt: skip
    assert (row["leg"], row["failure"], row["hold"]) == (5, "limp", "line")
    assert (row["final_m"], row["status"], row["slots"]) == (walk.final_m, "ok", [1, 2, 3, 4, 5, 6])


def test_the_json_has_every_number_of_the_tables() -> None:
    made = findings(exact_sensors=True)
    values = json.loads(json.dumps(holds_json(made), allow_nan=False))
    assert values["sensors"] is None
    assert values["walks"] == len(made.walks)
    divisions = [(division, name) for division, name, _ in made.groups()]
    assert [(one["division"], one["group"], one["hold"]) for one in values["statistics"]] == [
        (*group, hold) for group in divisions for hold in ("none", "heading", "line")
    ]
    first = values["statistics"][0]
    _, _, damaged = next(made.groups())
    assert first["mean_m"] == made.statistics("none", damaged).mean_m
    assert {bar["holds"] for bar in values["bars"]} == {True}


def test_the_summary_is_a_table_with_a_row_for_each_hold() -> None:
    lines = holds_lines(findings())
    assert len(lines) == 5
    assert len({line.count("|") for line in lines}) == 1
    assert re.match(r"\| one leg failed \| pose \| 24 in 6 worlds \| 0\.\d\d cm ± 0\.\d\d cm \|", lines[-1])


def test_a_single_world_has_no_standard_error() -> None:
    assert (
        "±"
        not in holds_lines(findings(worlds=1, families={"transfer": findings().plan.families["transfer"]}))[
            -1
        ]
    )
