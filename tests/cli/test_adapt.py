"""`hexctl adapt` and `hexctl sessions` as a user calls them."""

import contextlib
import csv
import io
import json
import os
import shutil
import signal
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt import search
from hexctl.adapt.runner import TrialRunner, WalkedTrial
from hexctl.adapt.sessions.store import list_sessions, load_session
from hexctl.cli.main import exit_code
from hexctl.robot.configs import config_root
from tests.adapt.walking import Landscape, result_of
from tests.cli.conftest import Call
from tests.cli.terminals import FULL_DISK, run_program

QUICK = ["adapt", "--failed-leg", "4", "--duration", "2", "--budget", "3", "--prior", "none"]
QUICK += ["--target", "1e-9"]


@pytest.fixture
def _on_a_landscape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Trials take no time."""
    monkeypatch.setattr(TrialRunner, "walk", lambda _, request: Landscape()(request))


on_a_landscape = pytest.mark.usefixtures("_on_a_landscape")
BEGUN = ["adapt", "--failed-leg", "5", "--optimizer", "random", "--no-record", "--no-baseline"]


@pytest.fixture(scope="module")
def searched(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Any]:
    """Folder of a search with recordings, and what it printed as JSON."""
    folder = tmp_path_factory.mktemp("searched")
    with contextlib.chdir(folder), contextlib.redirect_stdout(io.StringIO()) as printed:
        assert exit_code([*QUICK, "--optimizer", "pso", "--seed", "2", "--hold", "line", "--json"]) == 0
    return folder, json.loads(printed.getvalue())


def course(outcome: dict[str, Any]) -> list[Any]:
    """What two equal sessions have in common."""
    return [{key: value for key, value in trial.items() if key != "recording"} for trial in outcome["trials"]]


@on_a_landscape
def test_a_finished_session_goes_on_with_another_budget(call: Call) -> None:
    begun = ["adapt", "--failed-leg", "5", "--optimizer", "derand", "--no-record", "--budget"]
    whole, part = (call(*begun, budget, "--json").quiet_json for budget in ("15", "4"))
    go_on = ["adapt", "--resume", part["session"], "--no-record"]
    for budget in ("4", "1000000"):
        assert f"--budget: got {budget}" in call(*go_on, "--budget", budget, code=2).err
    assert load_session(part["session"]).spec.budget == 4, "what was refused has changed it"
    longer = call(*go_on, "--budget", "15", "--json").json
    assert (longer["budget"], longer["ended"]) == (15, "budget")
    assert course(longer) == course(whole)
    assert call(*go_on, "--json").json["trials"] == longer["trials"]


@on_a_landscape
def test_a_session_that_has_met_its_target_is_left_as_it_is(call: Call) -> None:
    words = ["adapt", "--failed-leg", "5", "--optimizer", "derand", "--no-record", "--target", "9"]
    met = call(*words, "--budget", "4", "--json").json
    assert met["ended"] == "target"
    assert call("adapt --resume", met["session"], "--no-record", "--budget", "15").err.endswith(
        "for another --target, begin a new session\n"
    )
    assert load_session(met["session"]).spec.budget == 4


def test_no_valid_trial_is_no_success(monkeypatch: pytest.MonkeyPatch, call: Call) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda *_: WalkedTrial(result=result_of(0.1, "fell")))
    words = ["adapt", "--failed-leg", "5", "--no-record", "--prior", "none", "--budget", "2"]
    outcome = call(*words, "--json", code=4).json
    assert (outcome["found"], outcome["best"], outcome["ended"]) == (False, None, "budget")
    assert "no valid trial: fell" in call(*words, code=4).out


@pytest.mark.slow
def test_a_session_is_not_continued_with_another_robot(call: Call) -> None:
    text = (config_root() / "robots" / "ant.yaml").read_text()
    Path("mine.yaml").write_text(text)
    outcome = call(*QUICK, "--robot", "./mine.yaml", "--no-record", "--json").json
    Path("mine.yaml").write_text(text.replace("mass_kg: 0.100", "mass_kg: 0.200"))
    refused = call("adapt --resume", outcome["session"], "--budget", "40", code=2)
    assert "robot ./mine.yaml" in refused.err
    assert load_session(outcome["session"]).spec.budget == outcome["budget"]
    Path("mine.yaml").write_text(text)
    again = call("adapt --resume", outcome["session"], "--no-record", "--json").json
    assert course(again) == course(outcome)


def test_ctrl_c_while_a_search_is_prepared_says_that_nothing_was_recorded(
    call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    prepare = search.new_spec

    def interrupted(**asked: Any) -> Any:
        os.kill(os.getpid(), signal.SIGINT)
        return prepare(**asked)

    monkeypatch.setattr(search, "new_spec", interrupted)
    printed = call(*QUICK, code=130)
    assert "nothing was recorded" in printed.err.splitlines()[-1]
    assert not Path("runs").exists()


def test_a_second_ctrl_c_says_how_to_resume(call: Call, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: object) -> WalkedTrial:
        for _again in range(2):
            os.kill(os.getpid(), signal.SIGINT)
        raise AssertionError("not interrupted")

    monkeypatch.setattr(TrialRunner, "walk", interrupted)
    err = call(*QUICK, code=130).err
    (session,) = list_sessions()
    assert err.endswith(f"hexctl adapt --resume {session.name}\n")


@pytest.mark.slow
def test_sessions_are_listed_shown_exported_and_deleted(
    searched: tuple[Path, Any], call: Call, tmp_path: Path
) -> None:
    import pyarrow.parquet as pq

    folder, outcome = searched
    shutil.copytree(folder / "runs", tmp_path / "runs")
    name = outcome["session"]
    (listed,) = call("sessions list --json").json
    assert (listed["session"], listed["ended"], listed["trials"]) == (name, "budget", 3)
    shown = call("sessions", "show", name, "--json").json["baseline"]
    assert max(map(len, call("sessions show", name).out.splitlines()[:10])) <= 80
    for ending in ("csv", "parquet"):
        call("export", name, "--output", f"out.{ending}")
    written = list(csv.DictReader(Path("out.csv").read_text().splitlines()))
    for rows in (written, pq.read_table("out.parquet").to_pylist()):
        assert len(rows) == 3
        for row in rows:
            for walk in shown:
                head = f"baseline_{walk['gait']}"
                assert float(row[f"{head}_score"]) == walk["score"]
                assert float(row[f"{head}_deviation_m"]) == walk["deviation_m"]["signed"]
                assert float(row[f"{head}_distance_m"]) == walk["distance_m"]
                assert row[f"{head}_status"] == walk["status"]
    call("export", name, "--output", "out.csv", code=2)
    call("sessions delete --yes", name)
    assert call("sessions list --json").json == []


@pytest.mark.slow
def test_the_trials_that_no_other_beats(
    searched: tuple[Path, Any], call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    folder, outcome = searched
    monkeypatch.chdir(folder)
    show = ["sessions", "show", outcome["session"], "--pareto"]
    shown = call(*show, "speed,cost", "--json").json
    pairs = [(2.0 / trial["distance_m"], trial["cost_of_transport"]) for trial in outcome["trials"]]
    best = [one for one in pairs if not any(a <= one[0] and b <= one[1] and (a, b) != one for a, b in pairs)]
    assert [trial["scores"] for trial in shown["trials"]] == [
        {"speed": pytest.approx(speed), "cost": pytest.approx(cost)} for speed, cost in sorted(best)
    ]
    assert len(call(*show, "speed,cost").out.splitlines()) == 2 + len(best) + 2
    assert "--pareto" in call(*show, "speed", code=2).err


@on_a_landscape
def test_quiet_prints_the_end_only_and_without_recordings_a_search_leaves_its_store_alone(call: Call) -> None:
    printed = call(*BEGUN, "--budget", "3", "--quiet")
    assert (len(printed.out.splitlines()) <= 6, printed.err) == (True, "")
    (session,) = list_sessions()
    for words in (["list"], ["show", session.name]):
        call("sessions", *words)
        assert [str(path) for path in Path("runs").rglob("*.*")] == [f"runs/{session.name}/session.jsonl"]


@pytest.mark.slow
@pytest.mark.parametrize("recorded", [True, False])
def test_a_full_disk_ends_in_one_line_and_loses_no_kept_trial(recorded: bool, call: Call) -> None:
    words = "adapt --failed-leg 5 --budget 60 --duration 2.5 --prior none --trim off --json"
    options = [] if recorded else ["--no-record"]
    done = run_program(FULL_DISK, "30000", *words.split(), *options)
    assert done.returncode == 3, done.stderr
    (session,) = list_sessions()
    assert done.stderr.endswith(f"continue with: hexctl adapt --resume {session.name}\n")
    if recorded:
        assert len(session.trials) == len(json.loads(done.stdout)["trials"])
        more = ["--budget", "1", "--no-record"]
        assert len(call("adapt --resume", session.name, *more, "--json").json["trials"]) == 1
    else:
        assert session.trials
