"""The benchmarks: rows and bars, gains of trials, leg signatures, and the command at a tiny size."""

import json
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from benchmarks import __main__ as command
from benchmarks import build_signatures
from benchmarks.__main__ import BENCHMARKS, main
from benchmarks.build_signatures import Examples, learned, mirrored, to_legs
from benchmarks.reality import ITEMS, TABLE
from benchmarks.results import results
from benchmarks.rows import Bar, Row
from benchmarks.scale import Scale
from benchmarks.search_gain import OPEN_LOOP, OPEN_LOOP_PRIOR, OpenLoop, open_loop_lines
from hexctl.adapt.prior.prior import load_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.prior.samples import drift_samples_of
from hexctl.backends.sim.world import World
from hexctl.control.monitor.leg_signatures import SENSORS
from hexctl.control.trial_result import Deviation
from hexctl.gait.gait import make_gait
from tests.adapt.walking import result_of
from tests.robots import shipped


def test_an_open_loop_search_counts_every_walk_until_one_is_confirmed() -> None:
    known = drift_samples_of(load_prior(shipped_priors() / OPEN_LOOP_PRIOR), shipped(), 5)
    one = OpenLoop(number=1, world=World(), leg=5, search=OPEN_LOOP["trim"](known, range(1, 121)))
    trims = []
    for off_m in (0.3, 0.01, 0.03, 0.02, 0.02):
        plan = one.trial().plan
        trims.append(plan.trim_rad)
        walk = replace(result_of(off_m), trim_rad=plan.trim_rad, turn_trim_rad_s=plan.turn_trim_rad_s)
        one.take(replace(walk, true_deviation=Deviation(off_m + 0.01, 0.1, 0.1, off_m)))
    assert (trims[1], trims[3]) == (trims[2], trims[4])
    assert one.confirmed == 5
    assert [one.best_m(walks) for walks in (1, 2)] == pytest.approx([0.31, 0.02])
    assert open_loop_lines([one])[-1] == "confirmed: 100%, after 5 walks (median)"


def test_a_verdict_needs_a_value_and_is_made_before_rounding() -> None:
    assert Row("x", None, "gaits", Bar(low=1)).as_json()["holds"] is False
    row = Row("x", 1.250004, "ratio", Bar(high=1.25))
    assert row.as_json()["value"] == 1.25
    assert row.holds is False


@pytest.mark.parametrize("seen", SENSORS)
def test_frames_of_legs_and_mirror_images_keep_sizes(seen: str) -> None:
    turns = to_legs(shipped(), make_gait(shipped(), "ripple"), seen)
    assert turns @ np.swapaxes(turns, 1, 2) == pytest.approx(np.stack([np.eye(turns.shape[-1])] * 6))
    some = np.random.default_rng(0).standard_normal((6, turns.shape[-1] + 3))
    assert (mirrored(mirrored(some, seen), seen) == some).all()
    assert (mirrored(some, seen) != some).any()


def test_it_learns_which_leg_leans(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"NETWORKS": 1, "PASSES": 60, "UNITS": 4}.items():
        monkeypatch.setattr(build_signatures, name, value)
    random = np.random.default_rng(0)
    legs = random.integers(0, 7, 2000)
    features = 0.3 * random.standard_normal((2000, 6, 27)).astype(np.float32)
    features[legs > 0, legs[legs > 0] - 1, :12] += 1.0
    found = learned(Examples(features, legs), "lean")
    weights = np.concatenate([found.patterns.reshape(len(found.biases), -1), found.sizes], axis=1)
    odds = np.tanh(features @ weights.T + found.biases) @ found.outputs[:-1] + found.outputs[-1]
    said = np.where(odds.max(axis=1) > 0, odds.argmax(axis=1) + 1, 0)
    assert (said == legs).mean() > 0.95


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


@pytest.fixture
def tiny(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(command, "FULL", TINY)


def rows_of(output: str) -> list[dict[str, Any]]:
    return [json.loads(line) for line in output.splitlines()]


@pytest.mark.long
@pytest.mark.usefixtures("tiny")
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


def test_a_name_that_begins_no_row_is_refused_and_a_list_runs_nothing(
    capsys: pytest.CaptureFixture[str],
) -> None:
    with pytest.raises(SystemExit) as caught:
        main(["--only", "nonsense"])
    assert caught.value.code == 2
    assert "nonsense" in capsys.readouterr().err
    assert main(["--list"]) == 0
    assert capsys.readouterr().out.split() == list(BENCHMARKS)


@pytest.mark.long
@pytest.mark.usefixtures("tiny")
def test_a_benchmark_that_crashes_fails_the_run_but_not_the_others(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def crash(_: Scale) -> Iterator[Row]:
        raise RuntimeError("boom")

    monkeypatch.setitem(command.BENCHMARKS, "startup", crash)
    assert main(["--json", "--only", "startup", "--only", "tick.ahead.median"]) == 1
    captured = capsys.readouterr()
    assert "boom" in captured.err
    assert [row["name"] for row in rows_of(captured.out)] == ["tick.ahead.median"]


@pytest.mark.long
@pytest.mark.parametrize("key", ITEMS)
def test_an_item_of_the_ledger(key: str) -> None:
    try:
        value = ITEMS[key].value()
    except FileNotFoundError:
        pytest.skip("no folder of measured data")
    shown = results()[TABLE]["rows"][key]
    assert ITEMS[key].cells(value)["agrees"] == shown["agrees"]
    assert value == pytest.approx(float(shown["hexctl"].split("°")[0].split()[0]), rel=0.1)
