"""`hexctl prior` and sessions that believe one, as a user calls them; one small prior is really built."""

import json
import shutil
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import load_prior, load_score_prior, save_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.cli.main import exit_code
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.study.priors.prior_building import PriorPlan
from tests.adapt.priors import MadeUpModel, MadeUpWorld, made_up_prior, made_up_score_prior
from tests.cli.conftest import Call

pytestmark = pytest.mark.slow

ADAPT = ["adapt", "--failed-leg", "5", "--no-record", "--no-baseline", "--trim", "off"]
STEERED = [*ADAPT, "--objective", "speed"]


@pytest.fixture(autouse=True)
def made_up_world(monkeypatch: pytest.MonkeyPatch) -> MadeUpWorld:
    """Walks take no time."""
    world = MadeUpWorld(MadeUpModel(3).worlds(1, 0)[0])
    monkeypatch.setattr(TrialRunner, "walk", lambda _, request: world(request))
    return world


@pytest.fixture
def prior() -> str:
    """A made-up prior that knows how robots stand, as a user names it."""
    model = MadeUpModel(3)
    made = made_up_prior(worlds=6, model=model)
    save_prior(replace(made, sag_rad=model.sags(6, 5)[np.newaxis]), Path("x.npz"))
    return "x.npz"


def run(capsys: pytest.CaptureFixture[str], call: Call, *arguments: str) -> tuple[Any, str]:
    """The JSON of a command and what it said on stderr."""
    capsys.readouterr()
    printed = call(*arguments, "--json")
    return json.loads(printed.out), printed.err


def test_show_lists_those_that_would_be_found_ones_own_first(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (Path("runs") / "priors").mkdir(parents=True)
    shutil.move(prior, "runs/priors/x.npz")
    listed, _ = run(capsys, "prior", "show")
    names = [Path(summary["prior"]).name for summary in listed]
    assert names == ["x.npz", *sorted(path.name for path in shipped_priors().glob("*.npz"))]


def test_a_session_believes_the_prior_that_it_is_given(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ("--prior", prior, "--budget", "3", "--target", "0.002", "--worth", "0")
    outcome, err = run(capsys, *ADAPT, *asked)
    assert err == ""
    assert (outcome["optimizer"], outcome["prior"]) == ("bayes", prior)
    assert outcome["prior_digest"] == load_prior(Path(prior)).digest
    assert 1 <= len(outcome["trials"]) <= 3
    for trial in outcome["trials"]:
        expected = trial["expected"]
        assert expected["low_m"] < expected["signed_m"] < expected["high_m"]
        assert 0 <= expected["chance"] <= 1
        assert expected["target_m"] == 0.002
    walks = outcome["baseline"] + outcome["trials"] + outcome["confirmations"]
    assert outcome["walked_s"] == sum(walk["walked_s"] for walk in walks)
    assert outcome["ended"] in ("budget", "confirmed")
    assert 0 <= outcome["settled_on"]["chance"] <= 1


def test_a_prior_in_its_place_is_found_by_itself(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    (Path("runs") / "priors").mkdir(parents=True)
    (Path("runs") / "priors" / "a.npz").write_text("my diary")
    shutil.move(prior, "runs/priors/x.npz")
    outcome, err = run(capsys, *ADAPT, "--budget", "1")
    assert (outcome["optimizer"], outcome["prior"], err) == ("bayes", "runs/priors/x.npz", "")
    named, _ = run(capsys, *ADAPT, "--budget", "1", "--prior", "auto", "--optimizer", "bayes")
    assert named["prior"] == "runs/priors/x.npz"
    unbelieving, err = run(capsys, *ADAPT, "--budget", "1", "--prior", "none")
    assert (unbelieving["optimizer"], unbelieving["prior"], err) == ("random", None, "")
    asked, err = run(capsys, *ADAPT, "--budget", "1", "--optimizer", "pso")
    assert (asked["optimizer"], asked["prior"], err) == ("pso", None, "")


@pytest.mark.parametrize("named", [[], ["--prior", "ant-locked-rear-30s"]])
def test_the_shipped_prior_is_believed_by_default_and_by_name(
    named: list[str], made_up_world: MadeUpWorld, capsys: pytest.CaptureFixture[str]
) -> None:
    outcome, err = run(capsys, *ADAPT, "--budget", "3", *named)
    assert (outcome["optimizer"], err) == ("bayes", "")
    assert Path(outcome["prior"]).name == "ant-locked-rear-30s.npz"
    *trials, confirmed = made_up_world.walked
    assert trials == [trial["code"] for trial in outcome["trials"]]
    assert [walk["code"] for walk in outcome["confirmations"]] == [confirmed]


def interrupted_after(count: int, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Begin a session, and let it be as if it had been cut off after some trials; return its name."""
    outcome, _ = run(capsys, *words, "--budget", str(count))
    session = load_session(outcome["session"])
    session.spec, session.ended = replace(session.spec, budget=count + 1), None
    SessionStore(Path("runs")).keep(session)
    return str(outcome["session"])


def test_how_the_robot_stood_is_kept_with_the_session_and_told_again(
    prior: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut off before its first trial: it continues with what it measured first and does not measure again."""
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--budget", "2"]
    whole, _ = run(capsys, *words)
    assert len(whole["sag_rad"]) == 18
    with monkeypatch.context() as patch:
        patch.setattr("hexctl.adapt.trial_loop.AdaptLoop.run", lambda _: "interrupted")
        assert exit_code([*words, "--json"]) == 130
    cut = json.loads(capsys.readouterr().out)
    assert (cut["trials"], cut["sag_rad"]) == ([], whole["sag_rad"])
    monkeypatch.setattr("hexctl.adapt.stance.simulated_deflection_rad", None)
    resumed, _ = run(capsys, "adapt", "--resume", cut["session"], "--no-record")
    assert resumed["trials"] == whole["trials"]


def test_a_robot_that_stands_otherwise_is_believed_otherwise(
    prior: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--budget", "1"]
    seen = run(capsys, *words)[0]["trials"][0]["expected"]
    monkeypatch.setattr("hexctl.adapt.stance.simulated_deflection_rad", lambda *_: None)
    blind, err = run(capsys, *words)
    assert blind["sag_rad"] is None
    assert err
    assert blind["trials"][0]["expected"] != seen


def test_a_session_does_not_go_on_with_another_prior(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--worth", "0"]
    name = interrupted_after(1, capsys, *words)
    original = Path(prior).read_bytes()
    resume = ["adapt", "--resume", name]

    save_prior(made_up_prior(legs=(5,)), Path("other.npz"))
    for content in (Path("other.npz").read_bytes(), original[:-50]):
        Path(prior).write_bytes(content)
        assert exit_code(resume) == 2
    Path(prior).write_bytes(original)
    assert len(run(capsys, *resume)[0]["trials"]) == 2
    Path(prior).unlink()
    assert exit_code([*resume, "--budget", "3"]) == 2


def test_a_prior_under_a_hold_is_built_with_the_trials_of_its_sessions(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], call: Call
) -> None:
    plans: list[PriorPlan] = []

    def built_at_once(plan: PriorPlan, path: Path, _work: object) -> None:
        plans.append(plan)
        save_prior(made_up_score_prior(plan.key, plan.legs, plan.worlds), path)

    monkeypatch.setattr("hexctl.study.priors.planned_prior.build_prior", built_at_once)
    for hold in ("line", "heading"):
        assert exit_code(["prior", "build", "--hold", hold, "--legs", "2", "--worlds", "2"]) == 0
    found = [(plan.hold, plan.self_rotation, plan.key.posture) for plan in plans]
    assert found == [("line", "none", "auto"), ("heading", "rear", "auto")]
    capsys.readouterr()
    assert "hold line" in call("prior show ant-locked-none-30s-line-leg2").out


@pytest.mark.parametrize(("leg", "raised"), [(5, STAND_UP), (4, 0.0)])
def test_a_search_of_steered_walks_believes_a_prior_of_their_scores(
    leg: int, raised: float, capsys: pytest.CaptureFixture[str]
) -> None:
    save_prior(made_up_score_prior(legs=(3, 4, 5)), Path("s.npz"))
    words = [*STEERED, "--prior", "s.npz"]
    words[words.index("--failed-leg") + 1] = str(leg)
    outcome, err = run(capsys, *words, "--budget", "2", "--worth", "0")
    assert err == ""
    assert (outcome["optimizer"], outcome["prior"], outcome["hold"]) == ("bayes", "s.npz", "auto")
    assert (outcome["self_rotation"], outcome["body_raise"]) == ("none", raised)
    assert outcome["prior_digest"] == load_score_prior("s.npz").digest
    assert (outcome["target_m"], outcome["ended"]) == (None, "budget")
    assert len({trial["code"] for trial in outcome["trials"]}) == 2
    name = interrupted_after(1, capsys, *words, "--worth", "0")
    assert run(capsys, "adapt", "--resume", name, "--no-record")[0]["trials"] == outcome["trials"]


@pytest.mark.parametrize(
    ("words", "reason", "advice"),
    [
        ("--failed-leg 5 --duration 8", "duration", "--duration 8"),
        ("--failed-leg 5 --duration 2.5", "duration", None),
        ("--failure 5:weak:0.5 --duration 6", "weak", "--failure weak:0.5 --duration 6"),
        ("--failure 5:limp --robot pexod --duration 6", "limp", "--robot pexod --failure limp --duration 6"),
        ("--failed-leg 5 --duration 6 --objective mean", "mean", None),
        (
            "--failure 5:limp --objective speed --prior auto --duration 6 --no-baseline",
            "prior",
            "--failure limp --hold line --duration 6",
        ),
    ],
)
def test_without_a_prior_that_fits_it_says_so_and_searches_at_random(
    words: str, reason: str, advice: str | None, capsys: pytest.CaptureFixture[str]
) -> None:
    plain = [] if "speed" in words else ["--trim", "off"]
    outcome, err = run(capsys, "adapt", "--no-record", "--budget", "1", *plain, *words.split())
    assert (outcome["optimizer"], outcome["prior"], outcome["settled_on"]) == ("random", None, None)
    (line,) = err.splitlines()
    assert reason in line
    assert line.partition("hexctl prior build ")[2] == (advice or "")


@pytest.mark.parametrize(("folder", "option"), [("priors", ()), ("repertoires", ("--repertoire",))])
def test_a_damaged_file_is_named_with_an_exit_code_of_its_own(
    folder: str, option: tuple[str, ...], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    monkeypatch.chdir(tmp_path)
    path = Path("runs", folder, "bad.npz")
    path.parent.mkdir(parents=True)
    path.write_bytes(b"broken")
    shown = call("prior show", *option, code=3)
    assert str(path) in shown.err
    assert "ant" in shown.out
    assert exit_code(["prior", "show", *option, str(path)]) == 2
