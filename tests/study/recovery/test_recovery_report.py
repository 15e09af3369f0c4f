"""The report of the recovery benchmark."""

import json
from pathlib import Path

import pyarrow.parquet as pq
import pytest

from hexctl.study.recovery.recovery_plan import HEXAHEAL, LINE
from tests.study.recovery.made_up import Found, changed, findings


def lines_of(found: Found) -> list[str]:
    return found.plan.lines(found.rows)


@pytest.mark.slow
def test_the_report_is_one_page_with_a_figure_and_all_walks_beside_it(tmp_path: Path) -> None:
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


def test_tables_of_other_plans_can_be_joined(tmp_path: Path) -> None:
    made, quiet = findings(), changed(findings(protocols=(HEXAHEAL,)), lambda *_: True, alarms=())
    tables = []
    for name, found in (("made", made), ("quiet", quiet)):
        (tmp_path / name).mkdir()
        found.plan.write(found.rows, tmp_path / name)
        tables.append(pq.read_table(tmp_path / name / "recovery.parquet"))
    assert tables[0].schema == tables[1].schema


def test_the_json_has_every_number_of_the_tables() -> None:
    made = changed(findings(exact_sensors=True), lambda _, one: one.case.failure == "locked", status="fell")
    values = json.loads(json.dumps(made.plan.numbers(made.rows), allow_nan=False))
    assert values["sensors"] is None
    assert (values["walks"], values["set_aside"], values["gaits"]) == (len(made.episodes), 0, ["tripod"])
    assert [one["method"] for one in values["statistics"][:3]] == ["nothing", "told", "recover"]
    assert len(values["statistics"]) == len(made.plan.statistics(made.rows)) > 30
    assert [(one["legs"], one["method"], one["walks"]) for one in values["hexaheal"]][:4] == [
        (1, "nothing", 4), (1, "told", 4), (1, "recover", 4), (2, "nothing", 2)]  # fmt: skip
    sets = [(one["legs"], one["method"]) for one in values["hexaheal_sets"]]
    assert sets[:4] == [([2], "nothing"), ([2], "told"), ([2], "recover"), ([5], "nothing")]
    assert {bar["name"]: bar["holds"] for bar in values["bars"]}["falls"] is False


def test_the_summary_is_a_table_with_a_row_for_each_kind_and_method() -> None:
    lines = lines_of(findings())
    assert [line.split(" | ")[:2] for line in lines[2:5]] == [
        ["| one leg or joint failed", method] for method in ("nothing", "told", "recover")
    ]
    assert "| whole legs | told | 8 in 4 worlds | - | - | - | - |" in "\n".join(lines)
    assert any(line.startswith("| two | recover | 2 of 2 (100%, ") for line in lines)
    assert not any("counted apart" in line for line in lines)


def test_what_was_not_walked_has_no_table() -> None:
    line = lines_of(findings(protocols=(LINE,)))
    assert not any("legs that fail" in text for text in line)
    pairs = lines_of(findings(protocols=(HEXAHEAL,)))
    assert "legs that fail" in pairs[1]


def test_conditions_without_progress_are_named(tmp_path: Path) -> None:
    made = changed(
        findings(), lambda place, one: not one.case.legs and place.number == 201, status="no_progress"
    )
    said = "counted apart: 24 walks in which the robot makes no progress with six good legs "
    assert f"{said}(ant in transfer:201, ant in real:201)" in lines_of(made)
    assert said in made.plan.write(made.rows, tmp_path).read_text(encoding="utf-8")


def test_a_report_of_hexaheals_protocol_alone_has_no_figure(tmp_path: Path) -> None:
    pairs = findings(protocols=(HEXAHEAL,))
    pairs.plan.write(pairs.rows, tmp_path)
    assert {path.name for path in tmp_path.iterdir()} == {"recovery.html", "recovery.parquet"}
