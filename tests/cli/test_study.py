"""`hexctl prior`, sessions that believe one, and `hexctl study` on walks of a moment."""

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hexctl.adapt.prior.prior import load_prior, load_score_prior, save_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.control.planning.static_stability import STAND_UP
from hexctl.study.priors.prior_building import PriorPlan
from tests.adapt.priors import MadeUpModel, MadeUpWorld, made_up_prior, made_up_score_prior
from tests.cli.conftest import Call

pytestmark = pytest.mark.slow

ADAPT = ["adapt", "--failed-leg", "5", "--no-record", "--no-baseline", "--trim", "off"]
STEERED = [*ADAPT[3:], "--objective", "speed", "--prior", "s.npz", "--worth", "0"]


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


def test_show_lists_those_that_would_be_found_ones_own_first(prior: str, call: Call) -> None:
    (Path("runs") / "priors").mkdir(parents=True)
    shutil.move(prior, "runs/priors/x.npz")
    listed = call("prior show --json").json
    names = [Path(summary["prior"]).name for summary in listed]
    assert names == ["x.npz", *sorted(path.name for path in shipped_priors().glob("*.npz"))]


def test_a_session_believes_the_prior_that_it_is_given(prior: str, call: Call) -> None:
    asked = ("--prior", prior, "--budget", "3", "--target", "0.002", "--worth", "0")
    printed = call(*ADAPT, *asked, "--json")
    outcome = printed.json
    assert printed.err == ""
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


@pytest.mark.parametrize(
    ("options", "believed"),
    [
        ("", ("bayes", "runs/priors/x.npz")),
        ("--prior auto --optimizer bayes", ("bayes", "runs/priors/x.npz")),
        ("--prior none", ("random", None)),
        ("--optimizer pso", ("pso", None)),
    ],
)
def test_a_prior_in_its_place_is_found_by_itself(
    options: str, believed: tuple[str, str | None], prior: str, call: Call
) -> None:
    (Path("runs") / "priors").mkdir(parents=True)
    (Path("runs") / "priors" / "a.npz").write_text("my diary")
    shutil.move(prior, "runs/priors/x.npz")
    printed = call(*ADAPT, "--budget", "1", *options.split(), "--json")
    assert (printed.json["optimizer"], printed.json["prior"], printed.err) == (*believed, "")


@pytest.mark.parametrize("named", [[], ["--prior", "ant-locked-rear-30s"]])
def test_the_shipped_prior_is_believed_by_default_and_by_name(
    named: list[str], made_up_world: MadeUpWorld, call: Call
) -> None:
    outcome = call(*ADAPT, "--budget", "3", *named, "--json").json
    assert Path(outcome["prior"]).name == "ant-locked-rear-30s.npz"
    *trials, confirmed = made_up_world.walked
    assert trials == [trial["code"] for trial in outcome["trials"]]
    assert [walk["code"] for walk in outcome["confirmations"]] == [confirmed]


def interrupted_after(count: int, call: Call, *words: str) -> str:
    """Begin a session, and let it be as if it had been cut off after some trials; return its name."""
    name = str(call(*words, "--budget", str(count), "--json").json["session"])
    session = load_session(name)
    session.spec, session.ended = replace(session.spec, budget=count + 1), None
    SessionStore(Path("runs")).keep(session)
    return name


def test_how_the_robot_stood_is_kept_with_the_session_and_told_again(
    prior: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Cut off before its first trial: it continues with what it measured first and does not measure again."""
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--budget", "2"]
    whole = call(*words, "--json").json
    assert len(whole["sag_rad"]) == 18
    with monkeypatch.context() as patch:
        patch.setattr("hexctl.adapt.trial_loop.AdaptLoop.run", lambda _: "interrupted")
        cut = call(*words, "--json", code=130).json
    assert (cut["trials"], cut["sag_rad"]) == ([], whole["sag_rad"])
    monkeypatch.setattr("hexctl.adapt.stance.simulated_deflection_rad", None)
    resumed = call("adapt --no-record --json --resume", cut["session"]).json
    assert resumed["trials"] == whole["trials"]


def test_a_robot_that_stands_otherwise_is_believed_otherwise(
    prior: str, call: Call, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--budget", "1"]
    seen = call(*words, "--json").json["trials"][0]["expected"]
    monkeypatch.setattr("hexctl.adapt.stance.simulated_deflection_rad", lambda *_: None)
    printed = call(*words, "--json")
    blind = printed.json
    assert blind["sag_rad"] is None
    assert printed.err
    assert blind["trials"][0]["expected"] != seen


def test_a_session_does_not_go_on_with_another_prior(prior: str, call: Call) -> None:
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--worth", "0"]
    name = interrupted_after(1, call, *words)
    original = Path(prior).read_bytes()
    resume = ["adapt", "--resume", name]

    save_prior(made_up_prior(legs=(5,)), Path("other.npz"))
    for content in (Path("other.npz").read_bytes(), original[:-50]):
        Path(prior).write_bytes(content)
        call(*resume, code=2)
    Path(prior).write_bytes(original)
    assert len(call(*resume, "--json").json["trials"]) == 2
    Path(prior).unlink()
    call(*resume, "--budget", "3", code=2)


def test_a_prior_under_a_hold_is_built_with_the_trials_of_its_sessions(
    monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    plans: list[PriorPlan] = []

    def built_at_once(plan: PriorPlan, path: Path, _work: object) -> None:
        plans.append(plan)
        save_prior(made_up_score_prior(plan.key, plan.legs, plan.worlds), path)

    monkeypatch.setattr("hexctl.study.priors.planned_prior.build_prior", built_at_once)
    for hold in ("line", "heading"):
        call("prior build --legs 2 --worlds 2 --hold", hold)
    found = [(plan.hold, plan.self_rotation, plan.key.posture) for plan in plans]
    assert found == [("line", "none", "auto"), ("heading", "rear", "auto")]
    assert "hold line" in call("prior show ant-locked-none-30s-line-leg2").out


@pytest.mark.parametrize(("leg", "raised"), [(5, STAND_UP), (4, 0.0)])
def test_a_search_of_steered_walks_believes_a_prior_of_their_scores(
    leg: int, raised: float, call: Call
) -> None:
    save_prior(made_up_score_prior(legs=(3, 4, 5)), Path("s.npz"))
    words = ["adapt", "--failed-leg", str(leg), *STEERED]
    printed = call(*words, "--budget", "2", "--json")
    outcome = printed.json
    assert (outcome["optimizer"], outcome["prior"], outcome["hold"], printed.err) == (
        "bayes",
        "s.npz",
        "auto",
        "",
    )
    assert (outcome["self_rotation"], outcome["body_raise"]) == ("none", raised)
    assert outcome["prior_digest"] == load_score_prior("s.npz").digest
    assert (outcome["target_m"], outcome["ended"]) == (None, "budget")
    assert len({trial["code"] for trial in outcome["trials"]}) == 2
    name = interrupted_after(1, call, *words)
    assert call("adapt --no-record --json --resume", name).json["trials"] == outcome["trials"]


@pytest.mark.parametrize(
    ("words", "reason", "advice"),
    [
        ("--failed-leg 5 --duration 8", "duration", "--duration 8"),
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
    words: str, reason: str, advice: str | None, call: Call
) -> None:
    plain = [] if "speed" in words else ["--trim", "off"]
    printed = call("adapt --no-record --budget 1 --json", *plain, *words.split())
    outcome = printed.json
    assert (outcome["optimizer"], outcome["prior"], outcome["settled_on"]) == ("random", None, None)
    assert reason in printed.line
    assert printed.line.partition("hexctl prior build ")[2] == (advice or "")


@pytest.mark.parametrize(("folder", "option"), [("priors", ()), ("repertoires", ("--repertoire",))])
def test_a_damaged_file_is_named_with_an_exit_code_of_its_own(
    folder: str, option: tuple[str, ...], call: Call
) -> None:
    path = Path("runs", folder, "bad.npz")
    path.parent.mkdir(parents=True)
    path.write_bytes(b"broken")
    shown = call("prior show", *option, code=3)
    assert str(path) in shown.err
    assert "ant" in shown.out
    call("prior show", *option, str(path), code=2)


TINY = ["study", "--legs", "2", "--duration", "0.2", "--runs", "2", "--budget", "5", "--optimizers", "random"]


@pytest.mark.long
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


@pytest.mark.long
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


@pytest.mark.long
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
