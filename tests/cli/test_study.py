"""`hexctl study` as a user calls it, on walks of a moment."""

import json
from pathlib import Path

import pytest

from tests.cli.conftest import Call

pytestmark = pytest.mark.long

TINY = ["study", "--legs", "2", "--duration", "0.2", "--runs", "2", "--budget", "5", "--optimizers", "random"]


def test_a_study_from_end_to_end_and_again_from_the_cache(tmp_path: Path, call: Call) -> None:
    first = call(*TINY, "--out", "first", "--json")
    outcome = first.json
    assert outcome["legs"] == [2]
    assert len(outcome["claims"]) == 12
    assert Path(outcome["report"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    assert json.loads((tmp_path / "first" / "study.json").read_text()) == outcome
    again = call(*TINY)
    assert again.err.count("from the cache") == 2
    (report,) = Path("runs").glob("study-2*/report.html")
    assert f"report: {report}" in again.out
    assert "not judged" in again.out
    assert "holds" not in again.out


SHORT = ["study", "--hold", "--legs", "2", "--failure", "limp", "--worlds", "1", "--duration", "0.2"]


def test_holds_are_compared_from_end_to_end_and_again_from_the_cache(tmp_path: Path, call: Call) -> None:
    first = call(*SHORT, "--world", "transfer,real", "--jobs", "1", "--out", "first", "--json")
    outcome = first.json
    assert (outcome["families"], outcome["first_world"], outcome["walks"]) == (["transfer", "real"], 250, 12)
    assert outcome["sensors"]["lost_poses"] == 0.05
    assert json.loads((tmp_path / "first" / "holds.json").read_text()) == outcome
    assert "ant, transfer:250 (plain): 6 walks" in first.err

    again = call(*SHORT, "--holds", "none,line")
    assert "ant, transfer:250 (plain): from the cache" in again.err
    (report,) = Path("runs").glob("study-2*/holds.html")
    assert again.out.endswith(f"report: {report}\n")
    assert "| one leg failed | pose | 1 in 1 world |" in again.out


BROKEN = ["study", "--recovery", "--legs", "2,5", "--failure", "limp", "--worlds", "1", "--runs", "1"]


def test_recovery_is_measured_from_end_to_end_and_again_from_the_cache(tmp_path: Path, call: Call) -> None:
    short = [*BROKEN, "--duration", "12", "--world", "transfer"]
    first = call(*short, "--jobs", "1", "--out", "first", "--json")
    outcome = first.json
    assert (outcome["families"], outcome["first_world"], outcome["walks"]) == (["transfer"], 470, 10 + 9)
    assert outcome["sensors"]["lost_poses"] == 0.05
    assert json.loads((tmp_path / "first" / "recovery.json").read_text()) == outcome
    assert "ant, line, transfer:470" in first.err
    assert "ant, hexaheal, flat:0 (flat): 9 walks" in first.err

    again = call(*short, "--methods", "nothing,recover", "--protocols", "line")
    assert "from the cache" in again.err
    (report,) = Path("runs").glob("study-2*/recovery.html")
    assert again.out.endswith(f"report: {report}\n")
    assert "| limp | recover | 2 in 1 world |" in again.out
