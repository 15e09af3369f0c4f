"""`python -m benchmarks` at a tiny size, where nothing is asserted of its time, and the ledger of reality."""

import json
from collections.abc import Iterator
from typing import Any

import pytest

from benchmarks import __main__ as command
from benchmarks.__main__ import BENCHMARKS, main
from benchmarks.reality import ITEMS, TABLE
from benchmarks.results import results
from benchmarks.rows import Row
from benchmarks.scale import Scale

pytestmark = pytest.mark.long

TINY = Scale(
    rounds=1,
    trial_rounds=1,
    codes=3,
    batch_walk_s=0.2,
    walk_s=0.2,
    ticks=20,
    clock_s=0.2,
    link_s=0.5,
    flood_s=0.5,
    twin_s=2.0,
    bus_s=1.0,
    memory_s=4.0,
    memory_link_s=3.0,
    starts=1,
    see_step_m=2.0,
    see_walks=1,
    see_walk_s=0.5,
    robots=1,
)


@pytest.fixture(autouse=True)
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "FULL", TINY)


def rows_of(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]


@pytest.mark.parametrize("name", BENCHMARKS)
def test_every_benchmark_prints_one_json_object_per_row(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["--json", "--only", name]) == 0
    rows = rows_of(capsys.readouterr().out)
    assert rows
    for row in rows:
        assert {"name", "value", "unit", "bar", "holds"} <= row.keys()
        assert row["name"].startswith(name + ".")
        assert (row["bar"] is None) == (row["holds"] is None)
    assert len({row["name"] for row in rows}) == len(rows)


def test_only_picks_single_rows_too(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--json", "--only", "tick.ahead.median"]) == 0
    assert [row["name"] for row in rows_of(capsys.readouterr().out)] == ["tick.ahead.median"]


def test_a_name_that_begins_no_row_is_refused_with_those_that_do(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--only", "nonsense"])
    assert caught.value.code == 2
    assert "nonsense" in capsys.readouterr().err


def test_list_names_all_and_runs_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--list"]) == 0
    assert capsys.readouterr().out.split() == list(BENCHMARKS)


def test_a_benchmark_that_crashes_fails_the_run_but_not_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def crash(_: Scale) -> Iterator[Row]:
        raise RuntimeError("boom")

    monkeypatch.setitem(command.BENCHMARKS, "startup", crash)
    assert main(["--json", "--only", "startup", "--only", "tick"]) == 1
    captured = capsys.readouterr()
    assert "boom" in captured.err
    assert rows_of(captured.out)


@pytest.mark.parametrize("key", ITEMS)
def test_an_item_of_the_ledger(key: str) -> None:
    try:
        value = ITEMS[key].value()
    except FileNotFoundError:
        pytest.skip("no folder of measured data")
    shown = results()[TABLE]["rows"][key]
    assert ITEMS[key].cells(value)["agrees"] == shown["agrees"]
    assert value == pytest.approx(float(shown["hexctl"].split("°")[0].split()[0]), rel=0.1)
