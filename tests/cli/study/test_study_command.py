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

TINY = [
    "study",
    "--legs",
    "2",
    "--duration",
    "0.2",
    "--runs",
    "2",
    "--budget",
    "5",
    "--optimizers",
    "pso,random",
]
CACHE = Path("runs") / "study-cache"


def test_a_study_from_end_to_end_and_again_from_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert exit_code([*TINY, "--out", "first", "--json"]) == 0
    first = capsys.readouterr()
    before_computing = first.err.partition("gaits valid")[0]
    assert "--duration" in before_computing
    assert "--budget" in before_computing
    outcome = json.loads(first.out)
    assert outcome["legs"] == [2]
    assert len(outcome["claims"]) == 12
    assert Path(outcome["report"]).read_text(encoding="utf-8").startswith("<!doctype html>")
    assert json.loads((tmp_path / "first" / "study.json").read_text()) == outcome
    assert "leg 2 without self-rotation: 120 of 120 gaits valid" in first.err

    assert exit_code(TINY) == 0
    again = capsys.readouterr()
    assert again.err.count("from the cache") == 2
    (report,) = Path("runs").glob("study-2*/report.html")
    assert f"report: {report}" in again.out
    assert "\nnot judged: walks of 0.2 s, needs at least 30 s\n" in again.out
    assert "holds" not in again.out
    assert "does not hold" not in again.out
    assert "bar " not in again.out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--legs", "0"], "--legs"),
        (["--legs", "1,7"], "--legs: got '1,7'; allowed: 1..6"),
        (["--legs", "one"], "--legs: got 'one'"),
        (["--runs", "0"], "--runs: got 0; allowed: 1..999"),
        (["--budget", "-1"], "--budget"),
        (["--jobs", "0"], "--jobs"),
        (["--duration", "nan"], "duration"),
        (["--seed", "-1"], "--seed"),
        (["--optimizers", "annealing"], "pso, psosp, dps"),
        (["--robot", "spot"], "allowed: ant"),
        (["--world", "moon"], "unknown world 'moon'; allowed: "),
        (["--failure", "tired"], "allowed: locked, limp"),
        (["--failure", "weak:2"], "--failure: got 'weak:2'; allowed: weak:FRACTION"),
        (["--self-rotation", "left"], "--self-rotation: got left; allowed: rear, front, none"),
        (["--worlds", "101"], "--worlds: got 101; allowed: 1..100"),
        (["--prior", "auto"], "--prior: got auto; allowed: with --transfer"),
        (["--one-leg"], "--one-leg: got it; allowed: with --transfer"),
        (["--out", "a-file"], "--out"),
        (["--out", "full"], "holds other things"),
        (["--dask", "nonsense"], "--dask"),
    ],
)
def test_bad_input_is_one_line_before_anything_runs(
    options: list[str],
    message: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "a-file").touch()
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "thesis.tex").touch()
    assert exit_code([*TINY, *options]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert message in printed.err
    assert not list(tmp_path.rglob("*.gz"))
    assert not list(tmp_path.rglob("report.html"))


def test_another_failure_turn_and_more_worlds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    options = ["--failure", "weak:0.5", "--self-rotation", "none", "--worlds", "2"]
    assert exit_code([*TINY, *options, "--json"]) == 0
    printed = capsys.readouterr()
    outcome = json.loads(printed.out)
    assert (outcome["failure"], outcome["self_rotation"], outcome["worlds"]) == ("weak:0.5", "none", 2)
    assert "leg 2 without self-rotation, world 2 of 2: " in printed.err
    assert [one["self_rotation"] for one in outcome["landscapes"]] == ["none"]
    (report,) = Path("runs").glob("study-2*/report.html")
    assert "each weak:0.5" in report.read_text(encoding="utf-8")


def test_a_matrix_of_settings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    settings = ["--failure", "locked,missing", "--world", "flat", "--robot", "ant", "--time-steps", "4"]
    assert exit_code([*TINY, "--matrix", *settings, "--worlds", "1", "--out", "out"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("| setting | worlds | left | right |")
    assert "| ant, flat, 4 ms, missing | 1 |" in printed.out
    assert printed.out.endswith(f"report: {Path('out') / 'matrix.html'}\n")


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--time-steps", "2"], "--time-steps: got 2; allowed: with --matrix"),
        (["--matrix", "--time-steps", "3"], "--time-steps: got 3; allowed: 20 ms divided"),
        (["--matrix", "--time-steps", "fast"], "--time-steps: got 'fast'"),
        (["--matrix", "--failure", "locked,tired"], "allowed: locked, limp"),
        (["--matrix", "--transfer"], "--matrix: got it with --transfer"),
    ],
)
def test_a_matrix_that_cannot_be_is_refused_in_one_line(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert exit_code([*TINY, *options]) == 2
    printed = capsys.readouterr()
    assert (printed.out, len(printed.err.splitlines())) == ("", 1)
    assert message in printed.err
    assert not list(tmp_path.rglob("*.gz"))


def test_the_transfer_benchmark_has_its_own_worlds_and_rotation(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["study", "--transfer", "--self-rotation", "front"]) == 2
    assert "--self-rotation: got front; allowed: without --transfer" in capsys.readouterr().err
    assert exit_code(["study", "--transfer", "--failure", "limp"]) == 2
    assert "prior: there is none for these trials" in capsys.readouterr().err
    assert exit_code(["study", "--transfer", "--world", "slippery"]) == 2
    err = capsys.readouterr().err
    assert "--world: got slippery (" in err
    assert "has no `ranges`; allowed: a family of worlds, such as transfer or real" in err


SHORT = ["study", "--hold", "--legs", "2", "--failure", "limp", "--worlds", "1", "--duration", "0.2"]


def test_holds_are_compared_from_end_to_end_and_again_from_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
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
    assert "\nnot judged: walks of 0.2 s, needs at least 30 s\n" in again.out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--transfer"], "--hold: got it with --transfer; allowed: one or the other"),
        (["--matrix"], "--hold: got it with --matrix; allowed: one or the other"),
        (["--time-steps", "2"], "--time-steps: got 2; allowed: with --matrix"),
        (["--optimizers", "pso"], "--optimizers: got pso; allowed: without --hold"),
        (["--budget", "3"], "--budget: got 3; allowed: without --hold"),
        (["--seed", "3"], "--seed: got 3; allowed: without --hold"),
        (["--dask", "tcp://127.0.0.1:1"], "--dask: got tcp://127.0.0.1:1; allowed: without --hold"),
        (["--prior", "auto"], "--prior: got auto; allowed: with --transfer"),
        (["--holds", "auto"], "--holds: got auto; allowed: one or more of none, heading, line, each once"),
        (["--failure", "tired"], "allowed: locked, limp"),
        (["--world", "slippery"], "has no `ranges`; allowed: a family of worlds"),
        (["--robot", "ant,spot"], "allowed: ant"),
        (["--robot", "ant,ant"], "--robot: got ant,ant; allowed: one or more, each once"),
        (["--worlds", "1001"], "--worlds: got 1001; allowed: 1..1000"),
        (["--legs", "0"], "--legs: got '0'"),
    ],
)
def test_a_comparison_of_holds_that_cannot_be_is_refused_in_one_line(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert exit_code([*SHORT, *options]) == 2
    printed = capsys.readouterr()
    assert (printed.out, len(printed.err.splitlines())) == ("", 1)
    assert message in printed.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    ("option", "message"),
    [
        (["--holds", "line"], "--holds: got line; allowed: with --hold"),
        (["--exact-sensors"], "--exact-sensors: got it; allowed: with --hold or --recovery"),
    ],
)
def test_options_of_holds_are_refused_elsewhere(
    option: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code([*TINY, *option]) == 2
    assert message in capsys.readouterr().err


def test_an_interrupted_comparison_of_holds_goes_on(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hexctl", "study", "--hold", "--duration", "3", "--jobs", "1"]
    study = subprocess.Popen(
        [*command, "--out", "out"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: list((tmp_path / CACHE).glob("hold-250-*.json.gz")), 120, "nothing was saved")
    study.send_signal(signal.SIGINT)
    out, err = study.communicate(timeout=60)
    assert (study.returncode, out) == (130, "")
    assert "of 930 walks are saved in" in err.splitlines()[-1]
    assert not (tmp_path / "out").exists()


BROKEN = ["study", "--recovery", "--legs", "2,5", "--failure", "limp", "--worlds", "1", "--runs", "1"]


def test_recovery_is_measured_from_end_to_end_and_again_from_the_cache(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
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
    assert "\nnot judged: walks of 12 s, needs at least 30 s\n" in again.out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--hold"], "--recovery: got it with --hold; allowed: one or the other"),
        (["--holds", "line"], "--holds: got line; allowed: with --hold"),
        (
            ["--optimizers", "pso"],
            "--optimizers: got pso; allowed: without --recovery",
        ),
        (["--budget", "3"], "--budget: got 3; allowed: without --recovery"),
        (["--dask", "tcp://127.0.0.1:1"], "allowed: without --recovery"),
        (["--self-rotation", "rear"], "--self-rotation: got rear; allowed: without --recovery"),
        (["--gaits", "gallop"], "--gaits: got gallop; allowed: one or more of demo"),
        (["--methods", "told"], "--methods: got told; allowed: nothing among them"),
        (["--methods", "nothing,hope"], "--methods: got hope; allowed: nothing, told, recover"),
        (
            ["--protocols", "ours"],
            "--protocols: got ours; allowed: one or more of line, hexaheal, second, each once",
        ),
        (["--failure", "tired"], "allowed: locked, limp"),
        (["--world", "slippery"], "has no `ranges`; allowed: a family of worlds"),
        (["--robot", "ant,ant"], "--robot: got ant,ant; allowed: one or more, each once"),
        (["--worlds", "1001"], "--worlds: got 1001; allowed: 1..1000"),
        (["--duration", "9"], "--duration: got 9; allowed: 11.1 to 86400 s"),
    ],
)
def test_a_recovery_benchmark_that_cannot_be_is_refused_in_one_line(
    options: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert exit_code([*BROKEN, *options]) == 2
    printed = capsys.readouterr()
    assert (printed.out, len(printed.err.splitlines())) == ("", 1)
    assert message in printed.err
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("option", [["--gaits", "wave"], ["--methods", "told"], ["--protocols", "line"]])
def test_options_of_recovery_are_refused_elsewhere(
    option: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code([*TINY, *option]) == 2
    assert "allowed: with --recovery" in capsys.readouterr().err


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_study_goes_on(number: signal.Signals, tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hexctl", "study", "--legs", "2", "--duration", "3", "--jobs", "1"]
    study = subprocess.Popen(
        [*command, "--out", "out"], cwd=tmp_path, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    )
    wait_for(lambda: list((tmp_path / CACHE).glob("leg*.json.gz")), 120, "nothing was saved")
    study.send_signal(number)
    out, err = study.communicate(timeout=60)
    assert (study.returncode, out) == (130, "")
    assert "of 240 gaits are saved" in err.splitlines()[-1]
    assert not (tmp_path / "out").exists()

    # What is saved is whole chunks of what an uninterrupted study has.
    cache = WalkCache(tmp_path / CACHE)
    done = list(cache.load(spec(2, "none", 3.0)))
    assert (len(done) > 0, len(done) % 40, cache.notes) == (True, 0, [])
    assert done == list(range(1, len(done) + 1))
