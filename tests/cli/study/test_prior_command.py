"""`hexctl prior` and sessions that believe one, as a user calls them; one small prior is really built."""

import json
import shutil
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.adapt.prior.prior import ScorePrior, load_prior, load_score_prior, open_prior, save_prior
from hexctl.adapt.prior.prior_files import shipped_priors
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.sessions.store import SessionStore, load_session
from hexctl.cli.main import exit_code
from hexctl.control.assessment.static_stability import STAND_UP
from hexctl.robot.failure import Failure
from hexctl.study.priors.prior_building import PriorPlan
from hexctl.study.repertoire_walks import CandidateWalk, RepertoireCase, RepertoirePlace
from tests.adapt.priors import MadeUpModel, MadeUpWorld, key_of, made_up_prior, made_up_score_prior
from tests.robots import shipped

pytestmark = pytest.mark.long

DURATION = "6"
BUILD = ["prior", "build", "--duration", DURATION, "--worlds", "2", "--legs", "5"]
ADAPT = ["adapt", "--failed-leg", "5", "--duration", DURATION, "--no-record"]
#: What is said of a prior that could be made, before its options.
ADVICE = "; this makes one: hexctl prior build"


@pytest.fixture(scope="module")
def built(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[str, Any]]:
    """Build the one prior of these tests: 2 worlds of 120 gaits of 6 seconds."""
    folder = tmp_path_factory.mktemp("built")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        printed: list[str] = []
        patch.setattr("hexctl.cli.study.prior_command.print_result", printed.append)
        assert exit_code([*BUILD, "--out", "mine/x.npz", "--json"]) == 0
    return folder / "mine" / "x.npz", json.loads(printed[0])


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def prior(built: tuple[Path, dict[str, Any]], tmp_path: Path) -> str:
    """A copy of the built prior as a user names it."""
    shutil.copy(built[0], tmp_path / "x.npz")
    return "x.npz"


def run(
    capsys: pytest.CaptureFixture[str], *arguments: str, codes: tuple[int, ...] = (0,)
) -> tuple[Any, str]:
    """The JSON of a command and what it said on stderr."""
    capsys.readouterr()
    assert exit_code([*arguments, "--json"]) in codes
    printed = capsys.readouterr()
    return json.loads(printed.out), printed.err


def refused(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    """The one line with which a command is refused before anything has happened."""
    capsys.readouterr()
    assert exit_code([*arguments]) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    assert len(printed.err.splitlines()) == 1
    assert not list(Path("runs").glob("*-leg*"))
    return printed.err


def test_building_says_what_was_built(built: tuple[Path, dict[str, Any]]) -> None:
    path, outcome = built
    assert outcome["prior"] == "mine/x.npz"
    assert (outcome["robot"], outcome["failure"], outcome["self_rotation"]) == ("ant", "locked", "rear")
    assert (outcome["legs"], outcome["worlds"], outcome["duration_s"]) == ([5], 2, 6.0)
    assert outcome["bytes"] == path.stat().st_size < 100_000
    prior = load_prior(path)
    assert prior.key == key_of(duration_s=6.0)
    # Robots walk forward, a good part of half a metre; and no two worlds are the same.
    assert 0.2 < np.nanmedian(prior.progress_m[..., -1]) < 1.0
    assert not np.array_equal(prior.signed_m[0, 0], prior.signed_m[0, 1])
    assert [entry.name for entry in path.parent.iterdir()] == ["x.npz"]


def test_a_prior_that_was_built_before_comes_from_the_cache(
    built: tuple[Path, dict[str, Any]], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(built[0].parents[1])
    assert exit_code([*BUILD, "--out", "again.npz"]) == 0
    printed = capsys.readouterr()
    assert printed.out.startswith("prior: again.npz (")
    assert printed.err.count("from the cache") == 2
    assert Path("again.npz").read_bytes() == built[0].read_bytes()
    Path("again.npz").unlink()


def test_show_says_what_a_prior_is_for(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    (summary,), err = run(capsys, "prior", "show", prior)
    assert err == ""
    assert summary["prior"] == prior
    assert (summary["robot"], summary["legs"], summary["worlds"]) == ("ant", [5], 2)
    assert exit_code(["prior", "show", prior]) == 0
    assert capsys.readouterr().out == ("x.npz: ant, legs 5 locked, self-rotation rear, 6 s, 2 worlds a leg\n")


def test_show_lists_those_that_would_be_found_ones_own_first(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (Path("runs") / "priors").mkdir(parents=True)
    shutil.move(prior, "runs/priors/x.npz")
    listed, _ = run(capsys, "prior", "show")
    names = [Path(summary["prior"]).name for summary in listed]
    assert names == ["x.npz", *sorted(path.name for path in shipped_priors().glob("*.npz"))]


@pytest.mark.parametrize("name", ["ant-locked-rear-30s", "ant-locked-rear-30s.npz"])
def test_show_and_adapt_know_shipped_priors_by_name(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    (summary,), _ = run(capsys, "prior", "show", name)
    assert (summary["robot"], summary["stances"]) == ("ant", True)
    words = ["adapt", "--failed-leg", "5", "--no-record", "--budget", "1", "--prior", name]
    outcome, _ = run(capsys, *words)
    assert Path(outcome["prior"]).name == "ant-locked-rear-30s.npz"


def test_show_refuses_what_is_no_prior(capsys: pytest.CaptureFixture[str]) -> None:
    Path("diary.npz").write_text("my diary")
    assert "diary.npz: it is not a prior" in refused(capsys, "prior", "show", "diary.npz")
    assert "no file at 'nowhere.npz'" in refused(capsys, "prior", "show", "nowhere.npz")


def test_a_session_believes_the_prior_that_it_is_given(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    asked = ("--prior", prior, "--budget", "3", "--target", "0.002", "--worth", "0")
    outcome, err = run(capsys, *ADAPT, *asked)
    assert err == ""
    assert (outcome["optimizer"], outcome["prior"]) == ("bayes", prior)
    assert outcome["prior_digest"] == load_prior(Path(prior)).digest()
    assert 1 <= len(outcome["trials"]) <= 3
    for trial in outcome["trials"]:
        expected = trial["expected"]
        assert expected["low_m"] < expected["signed_m"] < expected["high_m"]
        assert 0 <= expected["chance"] <= 1
        assert expected["target_m"] == 0.002
        assert trial["walked_s"] == 6.0
    assert outcome["walked_s"] == 6.0 * len(outcome["trials"])
    assert outcome["ended"] in ("budget", "confirmed")
    assert 0 <= outcome["settled_on"]["chance"] <= 1


def test_the_seed_of_a_session_that_believes_changes_nothing(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*ADAPT, "--prior", prior, "--budget", "2", "--target", "0.001"]
    first, other = (run(capsys, *words, "--seed", seed)[0] for seed in ("0", "7"))
    assert [trial["code"] for trial in first["trials"]] == [trial["code"] for trial in other["trials"]]


def test_the_table_says_what_is_believed_and_how_sure_it_ended(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert exit_code([*ADAPT, "--prior", prior, "--budget", "4", "--target", "0.1"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert "bayes with the prior x.npz" in lines[1]
    assert any("s walked" in line for line in lines)
    assert any(line.endswith("it is sure of a gait") for line in lines)
    (sure,) = [line for line in lines if line.startswith("chance: ")]
    assert "ends within 10.0 cm" in sure
    assert int(sure.split()[1]) >= 90


def test_another_leg_of_a_round_robot_is_served_too(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = ["adapt", "--failed-leg", "2", "--duration", DURATION, "--no-record", "--budget", "1"]
    assert run(capsys, *words, "--prior", prior)[0]["optimizer"] == "bayes"


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


@pytest.mark.parametrize(("words", "reason", "advice"), [
    (["--duration", "8"], "duration 30 s, not 8 s", f"{ADVICE} --duration 8"),
    (["--duration", "8", "--prior", "auto"], "duration 30 s, not 8 s", f"{ADVICE} --duration 8"),
    (["--duration", "2.5"], "duration 30 s, not 2.5 s", ""),
    (["--failure", "5:weak:0.5", "--duration", "6"], "weak",
     f"{ADVICE} --failure weak:0.5 --duration 6"),
    (["--failure", "5:limp", "--robot", "pexod", "--duration", "6"], "limp",
     f"{ADVICE} --robot pexod --failure limp --duration 6"),
    (["--duration", "6", "--objective", "mean"], "priors are for the objective final, not mean", ""),
], ids=str)  # fmt: skip
def test_without_a_prior_that_fits_it_says_so_and_searches_at_random(
    words: list[str], reason: str, advice: str, capsys: pytest.CaptureFixture[str]
) -> None:
    leg = () if "--failure" in words else ("--failed-leg", "5")
    asked = ["adapt", *leg, "--no-record", "--budget", "1", *words]
    outcome, err = run(capsys, *asked, codes=(0, 4))  # one walk, valid or not
    assert (outcome["optimizer"], outcome["prior"], outcome["settled_on"]) == ("random", None, None)
    assert len(err.splitlines()) == 1
    assert err.startswith("hexctl: no prior for these trials (")
    assert reason in err
    assert err.rstrip().endswith(f"searching with random instead{advice}")


def test_the_papers_count_goes_without_a_prior_and_without_words(capsys: pytest.CaptureFixture[str]) -> None:
    words = ["adapt", "--failed-leg", "5", "--duration", "2.5", "--no-record", "--budget", "1"]
    outcome, err = run(capsys, *words, "--count-repeats")
    assert (outcome["optimizer"], err) == ("random", "")


@pytest.mark.parametrize("path", sorted(shipped_priors().glob("*.npz")), ids=lambda path: path.stem)
def test_shipped_priors_are_small_and_know_how_robots_stand(path: Path) -> None:
    prior = open_prior(path)
    key = prior.key
    assert path.stat().st_size < 500_000
    assert key.robot_fingerprint == shipped(key.robot).fingerprint
    steered = isinstance(prior, ScorePrior)
    assert path.stem == f"{key.robot}-{key.failure}-{'none' if steered else 'rear'}-30s{'-line' * steered}"
    if not isinstance(prior, ScorePrior):
        assert prior.sag_rad is not None
        assert np.isfinite(prior.sag_rad).all()


def test_the_shipped_prior_is_believed_by_default(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    world = MadeUpWorld(MadeUpModel(3).worlds(1, 0)[0])
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: world(*trial))
    outcome, err = run(capsys, "adapt", "--failed-leg", "5", "--no-record", "--no-baseline", "--budget", "3")
    assert (outcome["optimizer"], err) == ("bayes", "")
    assert Path(outcome["prior"]).name == "ant-locked-rear-30s.npz"
    *trials, confirmed = world.walked
    assert trials == [trial["code"] for trial in outcome["trials"]]
    assert [walk["code"] for walk in outcome["confirmations"]] == [confirmed]


def save(name: str, **options: Any) -> str:
    robot = options.pop("robot", shipped())
    legs = options.pop("legs", (5,))
    save_prior(made_up_prior(key_of(robot, **{"duration_s": 6.0, **options}), legs=legs), Path(name))
    return name


@pytest.mark.parametrize(("options", "words"), [
    ({"duration_s": 8.0}, "is for duration 8 s, not 6 s"),
    ({"robot": shipped("phantomx")}, "is for robot phantomx, not ant"),
    ({"self_rotation": "front"}, "is for self-rotation front, not rear"),
    ({"failure": Failure(leg=5, kind="limp")}, "is for failure limp, not locked"),
], ids=lambda value: value if isinstance(value, str) else "-")  # fmt: skip
def test_a_prior_for_something_else_is_refused(
    options: dict[str, Any], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in refused(capsys, *ADAPT, "--prior", save("other.npz", **options))


def test_without_self_rotation_a_prior_is_for_one_heading(capsys: pytest.CaptureFixture[str]) -> None:
    name = save("none.npz", self_rotation="none")
    words = [*ADAPT, "--prior", name, "--self-rotation", "none", "--heading", "90"]
    assert "heading 0 deg, not 90 deg" in refused(capsys, *words)


def test_a_prior_of_a_robot_that_was_changed_is_refused(
    prior: str, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (shipped_priors().parent / "robots" / "ant.yaml").read_text(encoding="utf-8")
    Path("ant.yaml").write_text(text.replace("mass_kg: 0.100", "mass_kg: 0.200"), encoding="utf-8")
    message = refused(capsys, *ADAPT, "--robot", "./ant.yaml", "--prior", prior)
    assert "is for another description of ant" in message


def test_a_prior_that_knows_nothing_of_the_leg_is_refused_or_passed_over(
    capsys: pytest.CaptureFixture[str],
) -> None:
    words = ["adapt", "--robot", "pexod", "--failed-leg", "2", "--duration", DURATION, "--no-record"]
    name = save("legs.npz", robot=shipped("pexod"), legs=(1,))
    assert "is for failed leg 1" in refused(capsys, *words, "--prior", name)
    (Path("runs") / "priors").mkdir(parents=True, exist_ok=True)
    shutil.move(name, "runs/priors/legs.npz")
    outcome, err = run(capsys, *words, "--budget", "1")
    assert outcome["optimizer"] == "random"
    assert "legs.npz is for failed leg 1" in err


def test_a_file_that_is_no_whole_prior_is_refused(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    content = Path(prior).read_bytes()
    altered = bytearray(content)
    altered[len(altered) // 2] ^= 0xFF
    for name, bad in (("cut.npz", content[:-100]), ("altered.npz", altered), ("text.npz", b"my diary")):
        Path(name).write_bytes(bad)
        assert f"prior {name}: it is" in refused(capsys, *ADAPT, "--prior", name)
    assert "no file at 'nowhere.npz'" in refused(capsys, *ADAPT, "--prior", "nowhere.npz")


@pytest.mark.parametrize(("words", "message"), [
    (["--prior", "x.npz", "--optimizer", "pso"], "--prior: got x.npz with --optimizer pso; allowed"),
    (["--prior", "auto", "--optimizer", "random"], "--prior: got auto with --optimizer random; allowed"),
    (["--early-stop", "--optimizer", "random"], "--early-stop: got it without a prior; allowed"),
    (["--early-stop", "--prior", "none"], "--early-stop: got it without a prior; allowed"),
    (["--early-stop", "--duration", "2.5"], "prior: there is none for these trials"),
    (["--prior", "none", "--optimizer", "bayes"], "--prior: got none with --optimizer bayes; allowed"),
    (["--objective", "mean", "--optimizer", "bayes"], "priors are for the objective final, not mean"),
    (["--objective", "max", "--prior", "x.npz"], "priors are for the objective final, not max"),
    (["--count-repeats", "--optimizer", "bayes"], "--count-repeats: got it with bayes; allowed"),
    (["--optimizer", "bayes", "--duration", "2.5"], "prior: there is none for these trials"),
    (["--world", "randomised"], "world 'randomised' is a family; allowed: one of it"),
    (["--world", "randomised:-1"], "randomised:-1"),
    (["--world", "randomised:x"], "randomised:x"),
    (["--world", "nobody:3"], "nobody"),
], ids=lambda value: " ".join(value) if isinstance(value, list) else "-")  # fmt: skip
@pytest.mark.usefixtures("prior")
def test_what_contradicts_itself_is_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, *ADAPT, *words)


def test_a_member_of_a_family_is_a_world(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*ADAPT, "--budget", "1", "--prior", prior]
    third, _ = run(capsys, *words, "--world", "randomised:3")
    flat, _ = run(capsys, *words)
    assert third["world"] == "randomised:3"
    assert third["sag_rad"] != flat["sag_rad"]
    assert third["trials"][0]["deviation_m"] != flat["trials"][0]["deviation_m"]
    assert (
        run(capsys, *words, "--world", "randomised:3")[0]["trials"][0]["deviation_m"]
        == (third["trials"][0]["deviation_m"])
    )


def interrupted_after(count: int, capsys: pytest.CaptureFixture[str], *words: str) -> str:
    """Begin a session, and let it be as if it had been cut off after some trials; return its name."""
    outcome, _ = run(capsys, *words, "--budget", str(count))
    session = load_session(outcome["session"])
    session.spec, session.ended = replace(session.spec, budget=count + 1), None
    SessionStore(Path("runs")).keep(session)
    return str(outcome["session"])


def test_a_session_that_believes_goes_on_where_it_was(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--worth", "0"]
    whole, _ = run(capsys, *words, "--budget", "3")
    assert len(whole["trials"]) == 3
    name = interrupted_after(2, capsys, *words)
    resumed, err = run(capsys, "adapt", "--resume", name, "--no-record")
    assert err == ""
    assert resumed["trials"] == whole["trials"]
    assert resumed["settled_on"] == whole["settled_on"]


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
    assert "how the robot stands is not known" in err
    assert blind["trials"][0]["expected"] != seen


def test_a_prior_that_knows_no_stances_does_not_look(
    prior: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    save_prior(replace(load_prior(Path(prior)), sag_rad=None), Path(prior))
    monkeypatch.setattr("hexctl.adapt.stance.simulated_deflection_rad", None)
    outcome, err = run(capsys, *ADAPT, "--prior", prior, "--budget", "1")
    assert (outcome["optimizer"], outcome["sag_rad"], err) == ("bayes", None, "")


def test_a_session_does_not_go_on_with_another_prior(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = [*ADAPT, "--prior", prior, "--target", "0.001", "--worth", "0"]
    name = interrupted_after(1, capsys, *words)
    original = Path(prior).read_bytes()
    resume = ["adapt", "--resume", name]

    def resumed_with(content: bytes | None) -> str:
        Path(prior).unlink()
        if content is not None:
            Path(prior).write_bytes(content)
        else:
            save(prior)
        capsys.readouterr()
        assert exit_code(resume) == 2
        (line,) = capsys.readouterr().err.splitlines()
        return line

    assert "is not the one the session began with; allowed: the same file, or a new session" in (
        resumed_with(None)
    )
    assert "cut off" in resumed_with(original[:-50])
    Path(prior).write_bytes(original)
    assert len(run(capsys, *resume)[0]["trials"]) == 2
    Path(prior).unlink()
    assert exit_code([*resume, "--budget", "3"]) == 2
    assert "no file at 'x.npz'" in capsys.readouterr().err


def test_resume_takes_no_prior(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    message = refused(capsys, "adapt", "--resume", "some", "--prior", prior, "--early-stop")
    assert "--resume: got --prior, --early-stop too" in message


def test_walks_that_go_astray_end_early_where_that_is_asked(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    features = MadeUpModel(3).worlds(1, 0)[0]
    features[:, :10] = 6.0 * (np.arange(1, 11) / 10) ** 1.5
    world = MadeUpWorld(features)
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: world(*trial))
    words = ["adapt", "--failed-leg", "5", "--no-record", "--budget", "2", "--early-stop"]
    outcome, _ = run(capsys, *words, codes=(4,))
    assert [trial["status"] for trial in outcome["trials"]] == ["cut_short"] * 2
    assert outcome["best"] is None
    assert outcome["walked_s"] < 60.0
    assert outcome["early_stop"] is True


@pytest.mark.parametrize(("words", "message"), [
    (["--worlds", "1"], "--worlds: got 1; allowed: 2..1024"),
    (["--legs", "0"], "--legs"),
    (["--legs", ""], "--legs"),
    (["--legs", "5,5"], "--legs: got 5,5; allowed: one or more, each once"),
    (["--legs", "five"], "--legs: got 'five'"),
    (["--duration", "5"], "--duration: got 5; allowed: 6 s or more"),
    (["--duration", "7"], "--duration: got 7; allowed"),
    (["--failure", "tired"], "tired"),
    (["--self-rotation", "left"], "left"),
    (["--family", "flat"], "ranges"),
    (["--family", "nobody"], "nobody"),
    (["--robot", "bob"], "bob"),
    (["--jobs", "0"], "--jobs"),
    (["--out", "x.zip"], "--out: got x.zip; allowed: a file whose name ends in .npz"),
    (["--out", "folder.npz"], "--out: got folder.npz"),
    (["--dask", "nonsense"], "--dask"),
], ids=lambda value: " ".join(value) if isinstance(value, list) else "-")  # fmt: skip
def test_a_prior_that_cannot_be_built_is_refused_before_anything_runs(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    Path("folder.npz").mkdir()
    assert message in refused(capsys, *BUILD, *words)
    assert not list(Path("runs").rglob("*.npz"))


@pytest.mark.parametrize("duration", ["nan", "inf"])
def test_a_duration_that_is_no_number_is_refused(duration: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert f"got {duration}" in refused(capsys, *BUILD, "--duration", duration)


def test_a_place_that_cannot_be_written_is_said_before_anything_runs(
    capsys: pytest.CaptureFixture[str],
) -> None:
    Path("a-file").touch()
    assert exit_code([*BUILD, "--out", "a-file/x.npz"]) != 0
    printed = capsys.readouterr()
    assert len(printed.err.splitlines()) == 1
    assert "a-file/x.npz cannot be written" in printed.err
    assert not list(Path("runs").rglob("leg*.npz"))


def test_a_prior_under_a_hold_is_built_with_the_trials_of_its_sessions(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    plans: list[PriorPlan] = []

    def built_at_once(plan: PriorPlan, path: Path, **_options: object) -> None:
        plans.append(plan)
        save_prior(made_up_score_prior(plan.key, plan.legs, plan.worlds), path)

    monkeypatch.setattr("hexctl.study.priors.planned_prior.build_prior", built_at_once)
    for hold in ("line", "heading"):
        assert exit_code(["prior", "build", "--hold", hold, "--legs", "2", "--worlds", "2"]) == 0
    found = [(plan.hold, plan.self_rotation, plan.posture) for plan in plans]
    assert found == [("line", "none", "auto"), ("heading", "rear", "auto")]
    capsys.readouterr()
    assert exit_code(["prior", "show", "ant-locked-none-30s-line-leg2"]) == 0
    assert capsys.readouterr().out.endswith("2 worlds a leg, hold line: speed, cost, tilt, steadiness\n")


STEERED = ["adapt", "--objective", "speed", "--duration", DURATION, "--no-record", "--no-baseline"]


def saved_scores(name: str = "s.npz", **changes: Any) -> str:
    """A prior of steered walks of these sessions, written to a file."""
    asked = key_of(hold="line", self_rotation="none", duration_s=6.0)
    key = replace(asked, **{"posture": "auto", **changes})
    save_prior(made_up_score_prior(key, legs=(3, 4, 5)), Path(name))
    return name


@pytest.mark.parametrize(("leg", "raised"), [(5, STAND_UP), (4, 0.0)])
def test_a_search_of_steered_walks_believes_a_prior_of_their_scores(
    leg: int, raised: float, capsys: pytest.CaptureFixture[str]
) -> None:
    words = [*STEERED, "--failed-leg", str(leg), "--prior", saved_scores()]
    outcome, err = run(capsys, *words, "--budget", "2", "--worth", "0")
    assert err == ""
    assert (outcome["optimizer"], outcome["prior"], outcome["hold"]) == ("bayes", "s.npz", "auto")
    assert (outcome["self_rotation"], outcome["body_raise"]) == ("none", raised)
    assert outcome["prior_digest"] == load_score_prior("s.npz").digest()
    assert (outcome["target_m"], outcome["ended"]) == (None, "budget")
    assert len({trial["code"] for trial in outcome["trials"]}) == 2
    name = interrupted_after(1, capsys, *words, "--worth", "0")
    assert run(capsys, "adapt", "--resume", name, "--no-record")[0]["trials"] == outcome["trials"]


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"hold": "heading"}, "is for hold heading, not line"),
        ({"posture": "stance"}, "is for posture stance, not auto"),
        ({"failure": "limp"}, "is for failure limp, not locked"),
        ({"self_rotation": "rear"}, "is for self-rotation rear, not none"),
    ],
    ids=str,
)
def test_a_score_prior_of_other_trials_is_refused_by_name(
    changes: dict[str, str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert words in refused(capsys, *STEERED, "--failed-leg", "5", "--prior", saved_scores(**changes))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (["--early-stop"], "--early-stop: got it with --objective speed; allowed: with final"),
        (["--worth", "0.1"], "--worth: got 0.1 m with --objective speed; allowed: 0, to spend the budget"),
        (["--objective", "final", "--hold", "line"], "priors of steered walks are for speed, cost, tilt, st"),
        (["--hold", "none"], "priors are for the objective final, not speed, with hold none; those of"),
    ],
    ids=str,
)
def test_what_a_search_of_steered_walks_cannot_do_is_refused(
    options: list[str], words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    prior = saved_scores()
    assert words in refused(capsys, *STEERED, "--failed-leg", "5", "--prior", prior, *options)


def test_without_a_prior_of_steered_walks_the_command_that_builds_one_is_told(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, err = run(capsys, *STEERED, "--failure", "5:limp", "--budget", "1")
    assert "no prior for these trials" in err
    assert err.rstrip().endswith(f"{ADVICE} --failure limp --hold line --duration 6")


REPERTOIRE = ["prior", "build", "--repertoire", "--worlds", "2", "--directions", "1", "--codes", "0"]


def test_a_repertoire_is_built_continued_and_shown(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    def walk(
        _place: RepertoirePlace, cases: Sequence[RepertoireCase], _threads: int = 1
    ) -> list[CandidateWalk]:
        if Path("cut").exists():
            raise KeyboardInterrupt
        Path("cut").touch()
        speeds = [0.9 if case.candidate.name == "walk-on" else 0.6 for case in cases]
        return [
            CandidateWalk(case=case, status="ok", speed=speed, cost=0.3)
            for case, speed in zip(cases, speeds, strict=True)
        ]

    monkeypatch.setattr(RepertoirePlace, "walk", walk)
    words = [*REPERTOIRE, "--family", "transfer", "--pairs", "limp", "--jobs", "1"]
    assert exit_code(words) == 130
    assert "walks are saved in runs/study-cache; the same command continues" in capsys.readouterr().err
    made: dict[str, Any] = {}
    for _ in range(20):
        Path("cut").unlink()
        if exit_code([*words, "--json"]) == 0:
            made = json.loads(capsys.readouterr().out)
            break
    assert made["repertoire"] == "runs/repertoires/ant.npz"
    assert (made["robot"], made["directions"], made["walks"], made["pairs"]) == ("ant", 1, 2, ["limp"])
    assert made["others"] == made["situations"]
    (shown,), _ = run(capsys, "prior", "show", "--repertoire", "runs/repertoires/ant.npz")
    assert shown == made
    assert exit_code(["prior", "show", "--repertoire", "ant"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("runs/repertoires/ant.npz: ant, legs locked, limp, missing, stuck:coxa")
    assert "1 directions" not in said
    assert f"another than the safest is best in all {made['situations']} situations" in said


@pytest.mark.parametrize(("words", "message"), [
    (["--repertoire", "--failure", "limp"], "--failure: got limp; allowed: without --repertoire"),
    (["--repertoire", "--hold", "line"], "--hold: got line; allowed: without --repertoire"),
    (["--repertoire", "--directions", "5"], "--directions: got 5; allowed: 1, 2, 4, 6, 8, 12"),
    (["--repertoire", "--worlds", "17"], "--worlds: got 17; allowed: 1..16"),
    (["--repertoire", "--codes", "12"], "--codes"),
    (["--repertoire", "--pairs", "tired"], "tired"),
    (["--repertoire", "--family", "nobody"], "nobody"),
    (["--repertoire", "--family", "failing"], "--family: got failing; allowed: a family without"),
    (["--repertoire", "--out", "x.zip"], "--out: got x.zip; allowed: a file whose name ends in .npz"),
    (["--directions", "4"], "--directions: got 4; allowed: with --repertoire"),
    (["--pairs", "none"], "--pairs: got none; allowed: with --repertoire"),
], ids=lambda value: " ".join(value) if isinstance(value, list) else "-")  # fmt: skip
def test_a_repertoire_that_cannot_be_built_is_refused(
    words: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert message in refused(capsys, "prior", "build", *words)


def test_a_repertoire_goes_without_settings_of_priors(capsys: pytest.CaptureFixture[str]) -> None:
    Path("hexctl.toml").write_text("[prior.build]\nfailure = 'limp'\nduration = 8\n")
    assert exit_code(["prior", "build", "--repertoire", "--worlds", "17"]) == 2
    assert capsys.readouterr().err.endswith("--worlds: got 17; allowed: 1..16\n")


def test_a_file_that_is_no_repertoire_is_refused(prior: str, capsys: pytest.CaptureFixture[str]) -> None:
    said = f"repertoire {prior}: it is not a repertoire"
    assert said in refused(capsys, "prior", "show", "--repertoire", prior)
    assert "no file at 'nowhere.npz'" in refused(capsys, "prior", "show", "--repertoire", "nowhere.npz")
