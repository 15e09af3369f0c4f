"""`hexctl study` as a user calls it, on walks of a moment."""

import json
import signal
import subprocess
import sys
from pathlib import Path

import pytest

from hexctl.cli.main import exit_code
from hexctl.study.walk_cache import WalkCache
from hexctl.waiting import wait_for
from tests.study.made_up import spec

pytestmark = pytest.mark.long

TINY = ["study", "--legs", "2", "--duration", "0.2", "--runs", "2", "--budget", "5", "--optimizers", "random"]
CACHE = Path("runs") / "study-cache"


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


def test_a_study_from_end_to_end_and_again_from_the_cache(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code([*TINY, "--out", "first", "--json"]) == 0
    first = capsys.readouterr()
    outcome = json.loads(first.out)
    assert outcome["legs"] == [2]
    assert len(outcome["claims"]) == 12
    assert Path(outcome["report"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    assert json.loads((tmp_path / "first" / "study.json").read_text()) == outcome
    assert exit_code(TINY) == 0
    again = capsys.readouterr()
    assert again.err.count("from the cache") == 2
    (report,) = Path("runs").glob("study-2*/report.html")
    assert f"report: {report}" in again.out
    assert "not judged" in again.out
    assert "holds" not in again.out


def test_another_failure_turn_and_more_worlds(capsys: pytest.CaptureFixture[str]) -> None:
    options = ["--failure", "weak:0.5", "--self-rotation", "none", "--worlds", "2"]
    assert exit_code([*TINY, *options, "--json"]) == 0
    printed = capsys.readouterr()
    outcome = json.loads(printed.out)
    assert (outcome["failure"], outcome["self_rotation"], outcome["worlds"]) == ("weak:0.5", "none", 2)
    assert [one["self_rotation"] for one in outcome["landscapes"]] == ["none"]
    (report,) = Path("runs").glob("study-2*/report.html")
    assert "each weak:0.5" in report.read_text(encoding="utf-8")


def test_a_matrix_of_settings(capsys: pytest.CaptureFixture[str]) -> None:
    settings = ["--failure", "locked,missing", "--world", "flat", "--robot", "ant", "--time-steps", "4"]
    assert exit_code([*TINY, "--matrix", *settings, "--worlds", "1", "--out", "out"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("| setting | worlds | left | right |")
    assert "| ant, flat, 4 ms, missing | 1 |" in printed.out
    assert printed.out.endswith(f"report: {Path('out') / 'matrix.html'}\n")


SHORT = ["study", "--hold", "--legs", "2", "--failure", "limp", "--worlds", "1", "--duration", "0.2"]


def test_holds_are_compared_from_end_to_end_and_again_from_the_cache(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code([*SHORT, "--world", "transfer,real", "--jobs", "1", "--out", "first", "--json"]) == 0
    first = capsys.readouterr()
    outcome = json.loads(first.out)
    assert (outcome["families"], outcome["first_world"], outcome["walks"]) == (["transfer", "real"], 250, 12)
    assert outcome["sensors"]["lost_poses"] == 0.05
    assert json.loads((tmp_path / "first" / "holds.json").read_text()) == outcome
    assert "ant, transfer:250 (plain): 6 walks" in first.err

    assert exit_code([*SHORT, "--holds", "none,line"]) == 0
    again = capsys.readouterr()
    assert "ant, transfer:250 (plain): from the cache" in again.err
    (report,) = Path("runs").glob("study-2*/holds.html")
    assert again.out.endswith(f"report: {report}\n")
    assert "| one leg failed | pose | 1 in 1 world |" in again.out
    assert "not judged" in again.out


BROKEN = ["study", "--recovery", "--legs", "2,5", "--failure", "limp", "--worlds", "1", "--runs", "1"]


def test_recovery_is_measured_from_end_to_end_and_again_from_the_cache(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    short = [*BROKEN, "--duration", "12", "--world", "transfer"]
    assert exit_code([*short, "--jobs", "1", "--out", "first", "--json"]) == 0
    first = capsys.readouterr()
    outcome = json.loads(first.out)
    assert (outcome["families"], outcome["first_world"], outcome["walks"]) == (["transfer"], 470, 10 + 9)
    assert outcome["sensors"]["lost_poses"] == 0.05
    assert json.loads((tmp_path / "first" / "recovery.json").read_text()) == outcome
    assert "ant, line, transfer:470" in first.err
    assert "ant, hexaheal, flat:0 (flat): 9 walks" in first.err

    assert exit_code([*short, "--methods", "nothing,recover", "--protocols", "line"]) == 0
    again = capsys.readouterr()
    assert "from the cache" in again.err
    (report,) = Path("runs").glob("study-2*/recovery.html")
    assert again.out.endswith(f"report: {report}\n")
    assert "| limp | recover | 2 in 1 world |" in again.out
    assert "not judged" in again.out


def test_an_interrupted_study_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hexctl", "study", "--legs", "2", "--duration", "3", "--jobs", "1"]
    study = subprocess.Popen(
        [*command, "--out", "out"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: list((tmp_path / CACHE).glob("leg*.json.gz")), 120, "nothing was saved")
    study.send_signal(signal.SIGINT)
    out, err = study.communicate(timeout=60)
    assert (study.returncode, out) == (130, "")
    assert "of 240 gaits are saved" in err.splitlines()[-1]
    assert not (tmp_path / "out").exists()

    # What is saved is whole chunks of what an uninterrupted study has.
    cache = WalkCache(tmp_path / CACHE)
    done = list(cache.load(spec(2, "none", 3.0)))
    assert (len(done) > 0, len(done) % 40, cache.notes) == (True, 0, [])
    assert done == list(range(1, len(done) + 1))
