"""`hexctl adapt` and `hexctl sessions` as a user calls them."""

import csv
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pyarrow.parquet as pq
import pytest

from hexctl.adapt import search
from hexctl.adapt.runner import TrialRunner, WalkedTrial
from hexctl.adapt.sessions.store import SessionStore, list_sessions, load_session
from hexctl.cli.main import exit_code
from hexctl.recording.recording import Recording
from hexctl.robot.configs import config_root
from tests.adapt.walking import Landscape, result_of

PATIENCE_S = 90.0
QUICK = ["adapt", "--failed-leg", "4", "--duration", "3", "--budget", "3", "--prior", "none"]


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


FINISHED = (
    "hexctl: the session is finished, its budget is spent: nothing to walk; a greater --budget walks more\n"
)


def run_json(capsys: pytest.CaptureFixture[str], *arguments: str, code: int = 0, said: str = "") -> Any:
    capsys.readouterr()
    assert exit_code([*arguments, "--json"]) == code
    printed = capsys.readouterr()
    assert printed.err == said
    return json.loads(printed.out)


def course(outcome: dict[str, Any]) -> list[Any]:
    """What two equal sessions have in common."""
    return [{key: value for key, value in trial.items() if key != "recording"} for trial in outcome["trials"]]


@pytest.mark.slow
def test_every_trial_is_walked_kept_and_recorded(capsys: pytest.CaptureFixture[str]) -> None:
    outcome = run_json(capsys, *QUICK, "--optimizer", "pso", "--seed", "2")
    assert [trial["index"] for trial in outcome["trials"]] == [1, 2, 3]
    assert (outcome["optimizer"], outcome["failed_leg"], outcome["budget"], outcome["seed"]) == (
        "pso",
        4,
        3,
        2,
    )
    for trial in outcome["trials"]:
        assert len(set(trial["slots"])) == 6
        assert trial["slots"][3] == 4
        assert Path(trial["recording"]).stat().st_size > 10_000
        assert set(trial["deviation_m"]) == {"final", "mean", "max", "signed"}
    assert outcome["best"] in outcome["trials"]
    assert outcome["best"]["score"] == min(trial["score"] for trial in outcome["trials"])
    assert {"trials_to_0.10_m", "trials_to_0.025_m", "wall_s"} <= set(outcome)
    assert (Path("runs") / outcome["session"] / "overview.rrd").exists()


@pytest.mark.slow
def test_the_same_seed_gives_the_same_session(capsys: pytest.CaptureFixture[str]) -> None:
    first = run_json(capsys, *QUICK, "--no-record", "--seed", "5")
    again = run_json(capsys, *QUICK, "--no-record", "--seed", "5")
    other = run_json(capsys, *QUICK, "--no-record", "--seed", "6")
    assert course(first) == course(again)
    assert course(first) != course(other)
    assert first["session"] != again["session"]


@pytest.mark.slow
def test_the_gaits_it_would_use_anyway_are_walked_first_and_are_no_trials(
    capsys: pytest.CaptureFixture[str],
) -> None:
    outcome = run_json(capsys, *QUICK)
    assert [walk["gait"] for walk in outcome["baseline"]] == ["auto", "demo", "tripod"]
    for walk in outcome["baseline"]:
        assert Path(walk["recording"]).name == f"baseline-{walk['gait']}.rrd"
        assert walk["status"] == "ok"
    assert [trial["index"] for trial in outcome["trials"]] == [1, 2, 3]
    without = run_json(capsys, *QUICK, "--no-baseline")
    assert without["baseline"] == []
    assert course(without) == course(outcome)
    name = outcome["session"]
    longer = run_json(capsys, "adapt", "--resume", name, "--budget", "4")
    assert longer["baseline"] == outcome["baseline"]
    assert len(longer["trials"]) == 4
    assert exit_code(["sessions", "delete", name, "--yes"]) == 0


@pytest.mark.slow
def test_quiet_prints_the_end_only(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    words = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record", "--budget", "3", "--quiet"]
    assert exit_code(words) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("found: ")
    assert len(printed.out.splitlines()) <= 6
    assert printed.err == ""


@pytest.mark.slow
def test_without_recordings_a_search_leaves_its_store_alone(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    assert exit_code([*QUICK, "--no-record", "--quiet"]) == 0
    (session,) = list_sessions()
    assert [str(path) for path in Path("runs").rglob("*.*")] == [f"runs/{session.name}/session.jsonl"]
    for command in ("list", "show"):
        assert exit_code(["sessions", command, *[session.name] * (command == "show")]) == 0
        assert [str(path) for path in Path("runs").rglob("*.*")] == [f"runs/{session.name}/session.jsonl"]


@pytest.mark.slow
def test_the_table_and_the_sessions(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code([*QUICK, "--no-record"]) == 0
    printed = capsys.readouterr().out
    assert len([line for line in printed.splitlines() if line.endswith(" ok")]) == 6
    assert max(map(len, printed.splitlines()[:10])) <= 80
    gaits = ("auto", "demo", "tripod")
    assert [line.split()[:2] for line in printed.splitlines()[4:7]] == [["0", gait] for gait in gaits]
    assert [line for line in printed.splitlines() if line.startswith("without a search: auto ")]
    assert "--gait tripod" in printed
    (listed,) = run_json(capsys, "sessions", "list")
    name = listed["session"]
    assert name in printed
    assert exit_code(["sessions", "show", name]) == 0
    shown = capsys.readouterr().out
    assert "found: gait tripod, which needs no search, ends" in shown
    assert "ended after 3 trials" in shown
    assert (listed["ended"], listed["trials"]) == ("budget", 3)
    assert exit_code(["sessions", "list"]) == 0
    assert capsys.readouterr().out.splitlines()[1].split()[-1] == "budget"
    for ending in ("csv", "parquet"):
        assert exit_code(["sessions", "export", name, f"out.{ending}"]) == 0
        assert Path(f"out.{ending}").stat().st_size > 100
    assert len(Path("out.csv").read_text().splitlines()) == 4
    tables = [
        list(csv.DictReader(Path("out.csv").read_text().splitlines())),
        pq.read_table("out.parquet").to_pylist(),
    ]
    shown = run_json(capsys, "sessions", "show", name)["baseline"]
    assert [walk["gait"] for walk in shown] == ["auto", "demo", "tripod"]
    for rows in tables:
        for row in rows:
            for walk in shown:
                head = f"baseline_{walk['gait']}"
                assert float(row[f"{head}_score"]) == walk["score"]
                assert float(row[f"{head}_deviation_m"]) == walk["deviation_m"]["signed"]
                assert float(row[f"{head}_distance_m"]) == walk["distance_m"]
                assert row[f"{head}_status"] == walk["status"]
    assert exit_code(["sessions", "export", name, "out.csv"]) == 2
    assert exit_code(["sessions", "delete", name, "--yes"]) == 0
    assert run_json(capsys, "sessions", "list") == []


REFUSED = [
    (["adapt"], ["--failed-leg", "1..6"]),
    (["adapt", "--failed-leg", "7"], ["--failed-leg", "7", "1..6"]),
    (["adapt", "--failed-leg", "0"], ["--failed-leg", "0", "1..6"]),
    (["adapt", "--failed-leg", "5", "--budget", "-1"], ["--budget", "-1", "1.."]),
    (["adapt", "--resume", "some", "--seed", "30"], ["--resume", "--seed", "--budget"]),
    (["adapt", "--resume", "some", "--budget", "30"], ["some"]),
    (["adapt", "--failed-leg", "5", "--budget", "0"], ["--budget", "0", "1.."]),
    (["adapt", "--failed-leg", "5", "--worth", "0.1", "--optimizer", "pso"], ["--worth", "0.1", "bayes"]),
    (["adapt", "--failed-leg", "5", "--optimizer", "magic"], ["magic", "pso"]),
    (["adapt", "--failed-leg", "5", "--objective", "haste"], ["haste", "final, mean, max, progress"]),
    (["adapt", "--failed-leg", "5", "--target", "-1"], ["--target", "-1"]),
    (["adapt", "--failed-leg", "5", "--confirm", "20"], ["--confirm", "20"]),
    (["adapt", "--failed-leg", "5", "--duration", "nan"], ["duration", "nan"]),
    (["adapt", "--failed-leg", "5", "--world", "mars"], ["mars", "flat"]),
    (["adapt", "--failed-leg", "5", "--robot", "bob"], ["bob", "ant"]),
    (["adapt", "--failed-leg", "5", "--seed", "-3"], ["--seed", "-3"]),
    (["adapt", "--resume", "nobody"], ["nobody"]),
    (["sessions", "show", "nobody"], ["nobody"]),
]


@pytest.mark.slow
@pytest.mark.parametrize(("arguments", "words"), REFUSED, ids=lambda value: " ".join(value)[:45])
def test_bad_input_is_refused_in_one_line(
    arguments: list[str], words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code(arguments) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    for word in words:
        assert word in printed.err


@pytest.mark.slow
def test_a_robot_without_a_position_cannot_be_scored(capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["adapt", "--failed-leg", "5", "--backend", "mock", "--duration", "0.1", "--no-record"]
    assert exit_code([*arguments, "--prior", "none"]) == 3
    err = capsys.readouterr().err
    assert "knows no position" in err
    assert len(err.splitlines()) == 1, "without advice on a session that there will not be"


@pytest.mark.long
def test_a_session_cut_off_goes_on_to_the_same_end(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Ctrl-C and kill -9 in mid-session, then --resume."""
    options = "--failed-leg 2 --duration 6 --budget 6 --optimizer debest --no-record"
    whole = run_json(capsys, "adapt", *options.split())
    for number in (signal.SIGINT, signal.SIGKILL):
        (folder := tmp_path / number.name).mkdir()
        assert cut_off(folder, options, number) == (130 if number == signal.SIGINT else -signal.SIGKILL)
        os.chdir(folder)
        (listed,) = run_json(capsys, "sessions", "list")
        assert 2 <= listed["trials"] < 6
        assert exit_code(["sessions", "show", listed["session"]]) == 0
        assert f"continue with: hexctl adapt --resume {listed['session']}" in capsys.readouterr().out
        resumed = run_json(capsys, "adapt", "--resume", listed["session"], "--no-record")
        assert course(resumed) == course(whole)
        assert resumed["best"]["code"] == whole["best"]["code"]


def cut_off(folder: Path, options: str, number: int) -> int:
    """Begin a session in a process of its own, signal it after its second trial, return its exit code."""
    command = [sys.executable, "-m", "hexctl", "adapt", *options.split()]
    process = subprocess.Popen(command, cwd=folder, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        assert process.stdout is not None
        deadline_s = time.monotonic() + PATIENCE_S
        while "   2  " not in process.stdout.readline():
            assert time.monotonic() < deadline_s
        os.kill(process.pid, number)
        process.communicate(timeout=PATIENCE_S)
    finally:
        process.kill()
        process.wait()
    return process.returncode


@pytest.mark.slow
def test_a_budget_beyond_the_space_ends_when_every_gait_was_tried(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    words = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record"]
    said = "hexctl: of the budget of 500 trials at most 120 are walked: there are 120 gaits\n"
    outcome = run_json(capsys, *words, "--budget", "500", said=said)
    assert outcome["ended"] == "exhausted"
    assert len(outcome["trials"]) == 120
    assert exit_code([*words, "--budget", "121"]) == 0
    assert "ended after 120 trials" in capsys.readouterr().out


@pytest.mark.slow
def test_a_finished_session_goes_on_with_another_budget(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    begun = ["adapt", "--failed-leg", "5", "--optimizer", "derand", "--no-record", "--budget"]
    whole, part = run_json(capsys, *begun, "15"), run_json(capsys, *begun, "4")
    go_on = ["adapt", "--resume", part["session"], "--no-record"]
    for budget in ("4", "0", "1000000"):
        assert exit_code([*go_on, "--budget", budget]) == 2
        assert f"--budget: got {budget}" in capsys.readouterr().err
    store = SessionStore(Path("runs"))
    assert load_session(part["session"], store.folder).spec.budget == 4, "what was refused has changed it"
    longer = run_json(capsys, *go_on, "--budget", "15")
    assert (longer["budget"], longer["ended"]) == (15, "budget")
    assert course(longer) == course(whole)
    assert run_json(capsys, *go_on, said=FINISHED)["trials"] == longer["trials"]


@pytest.mark.slow
def test_a_session_at_its_target_has_nothing_to_walk(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    begun = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record", "--target", "9"]
    outcome = run_json(capsys, *begun, "--budget", "5")
    assert (outcome["ended"], len(outcome["trials"])) == ("target", 1)
    assert exit_code(["adapt", "--resume", outcome["session"], "--no-record", "--budget", "8"]) == 0
    printed = capsys.readouterr()
    assert "ended after 1 trial," in printed.out
    said = (
        "the session is finished, its target is reached: nothing to walk; another target takes a new session"
    )
    assert said in printed.err


@pytest.mark.slow
def test_a_finished_session_that_is_resumed_says_so(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    begun = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record", "--budget", "1"]
    session = run_json(capsys, *begun)["session"]
    assert exit_code(["adapt", "--resume", session, "--no-record"]) == 0
    assert capsys.readouterr().err == FINISHED


@pytest.mark.slow
def test_a_budget_beyond_the_number_of_gaits_is_told(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    begun = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record", "--no-baseline"]
    assert exit_code([*begun, "--budget", "121", "--target", "9"]) == 0
    said = "of the budget of 121 trials at most 120 are walked: there are 120 gaits"
    assert said in capsys.readouterr().err
    for enough in (["--budget", "120"], ["--budget", "121", "--count-repeats"]):
        assert exit_code([*begun, *enough, "--target", "9"]) == 0
        assert "at most" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_target_has_the_unit_of_its_objective(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    begun = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record", "--no-baseline"]
    begun += ["--objective", "speed", "--budget", "1"]
    assert exit_code([*begun, "--target", "9"]) == 0
    assert "best by the objective speed, target 9 s/m\n" in capsys.readouterr().out
    assert exit_code([*begun, "--target", "0"]) == 2
    assert "--target: got 0" in capsys.readouterr().err
    assert exit_code([*begun, "--target", "1%"]) == 2
    assert "allowed: a number, in s/m" in capsys.readouterr().err


@pytest.mark.slow
def test_another_objective_is_named(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    assert (
        exit_code(["adapt", "--failed-leg", "5", "--no-record", "--budget", "1", "--objective", "max"]) == 0
    )
    assert "best by the objective max" in capsys.readouterr().out


@pytest.mark.slow
def test_no_valid_trial_is_no_success(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda *_: WalkedTrial(result=result_of(0.1, "fell")))
    words = ["adapt", "--failed-leg", "5", "--no-record", "--prior", "none", "--budget", "2"]
    outcome = run_json(capsys, *words, code=4)
    assert (outcome["found"], outcome["best"], outcome["ended"]) == (False, None, "budget")
    assert exit_code(words) == 4
    assert "no valid trial: fell" in capsys.readouterr().out


@pytest.mark.slow
def test_an_objective_of_ones_own_is_found_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("hexctl_test_scores.py").write_text(
        'def sideways(result):\n    """Distance to the left."""\n    return result.deviation.signed\n'
    )
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    mine = ["--objective", "hexctl_test_scores:sideways", "--optimizer", "random"]
    begun = run_json(capsys, "adapt", "--failed-leg", "5", "--no-record", "--budget", "3", *mine)
    assert (begun["objective"], begun["objective_label"]) == (mine[1], "Distance to the left")
    more = ["--no-record", "--trust", "--budget", "6"]
    resumed = run_json(capsys, "adapt", "--resume", begun["session"], *more)
    scores = [trial["score"] for trial in resumed["trials"] if trial["score"] is not None]
    assert resumed["best"]["score"] == min(scores) < 0
    assert exit_code(["sessions", "show", begun["session"]]) == 0
    assert "best by the objective hexctl_test_scores:sideways" in capsys.readouterr().out


@pytest.mark.slow
def test_a_recording_that_fails_costs_no_trial_and_is_said(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def no_room(*_: Any) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Recording, "write_block", no_room)
        assert exit_code([*QUICK, "--no-baseline"]) == 3
    printed = capsys.readouterr()
    assert "trial 1 is done, its recording is not whole" in printed.err
    assert "continue with: hexctl adapt --resume" in printed.err
    (listed,) = run_json(capsys, "sessions", "list")
    assert listed["trials"] == 1
    assert len(run_json(capsys, "adapt", "--resume", listed["session"])["trials"]) == 3


@pytest.mark.slow
def test_a_session_is_not_continued_with_another_robot(capsys: pytest.CaptureFixture[str]) -> None:
    text = (config_root() / "robots" / "ant.yaml").read_text()
    Path("mine.yaml").write_text(text)
    outcome = run_json(capsys, *QUICK, "--robot", "./mine.yaml", "--no-record")
    Path("mine.yaml").write_text(text.replace("mass_kg: 0.100", "mass_kg: 0.200"))
    assert exit_code(["adapt", "--resume", outcome["session"], "--budget", "40"]) == 2
    store = SessionStore(Path("runs"))
    assert load_session(outcome["session"], store.folder).spec.budget == outcome["budget"]
    assert "robot ./mine.yaml" in capsys.readouterr().err
    Path("mine.yaml").write_text(text)
    again = run_json(capsys, "adapt", "--resume", outcome["session"], "--no-record", said=FINISHED)
    assert course(again) == course(outcome)


FULL_DISK = """
import resource, signal, sys
from hexctl.cli.main import exit_code
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (30_000, 30_000))
words = "adapt --failed-leg 5 --budget 60 --duration 2.5 --prior none"
sys.exit(exit_code([*words.split(), *sys.argv[1:]]))
"""


@pytest.mark.slow
def test_a_full_disk_ends_in_one_line_and_loses_no_kept_trial(capsys: pytest.CaptureFixture[str]) -> None:
    done = _adapt_on_a_small_disk("--no-record")
    assert done.returncode == 3, done.stderr
    assert len(done.stderr.splitlines()) == 1
    assert "cannot be stored" in done.stderr
    (session,) = list_sessions()
    assert done.stderr.endswith(f"continue with: hexctl adapt --resume {session.name}\n")
    walked = [line for line in done.stdout.splitlines() if line.endswith("  ok") or "no_progress" in line]
    shown = [line for line in walked if not line.startswith("   0 ")]
    (listed,) = run_json(capsys, "sessions", "list")
    assert listed["trials"] == len(shown) > 0


def _adapt_on_a_small_disk(*options: str) -> "subprocess.CompletedProcess[str]":
    return subprocess.run(
        [sys.executable, "-c", FULL_DISK, *options],
        capture_output=True,
        text=True,
        timeout=PATIENCE_S,
        check=False,
    )


@pytest.mark.slow
def test_a_disk_without_room_for_a_recording_says_how_to_go_on(capsys: pytest.CaptureFixture[str]) -> None:
    done = _adapt_on_a_small_disk("--json")
    assert done.returncode == 3, done.stderr
    assert "--record" not in done.stderr.replace("--no-record", "")
    name = json.loads(done.stdout)["session"]
    assert done.stderr.endswith(f"continue with: hexctl adapt --resume {name}\n")
    goes_on = run_json(capsys, "adapt", "--resume", name, "--budget", "1", "--no-record")
    assert len(goes_on["trials"]) == 1


@pytest.mark.slow
def test_the_trials_that_no_other_beats(capsys: pytest.CaptureFixture[str]) -> None:
    outcome = run_json(capsys, *QUICK, "--no-baseline", "--no-record", "--hold", "line")
    assert [trial["hold"] for trial in outcome["trials"]] == ["line"] * 3
    name = outcome["session"]
    shown = run_json(capsys, "sessions", "show", name, "--pareto", "speed,cost")
    pairs = [(3.0 / trial["distance_m"], trial["cost_of_transport"]) for trial in outcome["trials"]]
    best = [one for one in pairs if not any(a <= one[0] and b <= one[1] and (a, b) != one for a, b in pairs)]
    assert [trial["scores"] for trial in shown["trials"]] == [
        {"speed": pytest.approx(speed), "cost": pytest.approx(cost)} for speed, cost in sorted(best)
    ]
    assert exit_code(["sessions", "show", name, "--pareto", "speed,cost"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].endswith("of 3 trials that no other beats in speed and cost")
    assert len(lines) == 2 + len(best) + 2
    assert exit_code(["sessions", "show", name, "--pareto", "speed"]) == 2
    assert "--pareto: got 'speed'; allowed: two or more of final" in capsys.readouterr().err


@pytest.mark.slow
def test_ctrl_c_while_a_search_is_prepared_says_that_nothing_was_recorded(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare = search.new_spec

    def interrupted(**asked: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return prepare(**asked)

    monkeypatch.setattr(search, "new_spec", interrupted)
    assert exit_code(QUICK) == 130
    printed = capsys.readouterr()
    assert printed.err.splitlines()[-1] == (
        "hexctl: interrupted before a session began: nothing was recorded, begin again"
    )
    assert not Path("runs").exists()


@pytest.mark.slow
def test_a_second_ctrl_c_says_how_to_resume(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*_: object) -> WalkedTrial:
        for _again in range(2):
            os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("not interrupted")

    monkeypatch.setattr(TrialRunner, "walk", interrupted)
    assert exit_code(QUICK) == 130
    (session,) = list_sessions()
    said = f"hexctl: interrupted without a soft stop; continue with: hexctl adapt --resume {session.name}"
    assert capsys.readouterr().err.splitlines()[-1] == said
