"""`hexctl.adapt` and `Adaptation`: what the command line does, in Python, without a word printed."""

import math
import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any
from unittest import mock

import matplotlib
import pytest

import hexctl
from hexctl.adapt.adaptation import Adaptation, adapt
from hexctl.adapt.measurement import Answer
from hexctl.adapt.objectives import make_objective
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.prior.prior import Prior
from hexctl.adapt.runner import (
    LegFailedError,
    NotBegunError,
    RobotStoppedError,
    TrialRunner,
    WalkedTrial,
)
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_tables import export_session
from hexctl.adapt.sessions.store import StoreError, delete_session, list_sessions, load_session, stored_names
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.backends.sim.world import load_world
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, RecordingError, RobotFaultError, WrongTypeError
from tests.adapt.walking import Landscape, result_of
from tests.cli.adaptkits import Blind, EStopped
from tests.cli.kits import Kit
from tests.robots import shipped

LIGHT = """
import sys
import hexctl
from hexctl.adapt.space import GaitSpace
assert callable(hexctl.adapt) and GaitSpace((5,)).size == 120
heavy = {"mujoco", "dm_control", "rerun", "zenoh", "typer", "hexctl.adapt.adaptation"} & set(sys.modules)
assert not heavy, heavy
"""

#: A robot's own computer adapts over a link, without a simulation.
WITHOUT_SIMULATION = """
import sys
import hexctl.adapt.adaptation
heavy = {"mujoco", "dm_control"} & set(sys.modules)
assert not heavy, heavy
"""


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(Kit, "made", [])


@pytest.fixture
def landscape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Walks by a formula instead of a simulation."""
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))


class Backwards(RandomSearch):
    """A search of one's own."""

    name = "backwards"


def to_the_left(result: TrialResult) -> float:
    """Distance to the left."""
    return result.deviation.signed if result.deviation is not None else 0.0


@pytest.mark.slow
@pytest.mark.usefixtures("landscape")
def test_a_plot_shows_the_path_of_every_trial() -> None:
    matplotlib.use("Agg")
    result = hexctl.adapt(failed_leg=5, budget=3, optimizer="random", record=False)
    ax = result.plot()
    labels = [line.get_label() for line in ax.get_lines() if line.get_label().startswith("code")]
    assert labels == [f"code {trial.code}: {trial.score:g}" for trial in result.trials]
    assert result.plot(ax) is ax


def test_the_package_is_callable_and_light() -> None:
    subprocess.run([sys.executable, "-c", LIGHT], check=True)


@pytest.mark.slow
def test_adapting_over_a_link_loads_no_simulation() -> None:
    subprocess.run([sys.executable, "-c", WITHOUT_SIMULATION], check=True)


@pytest.mark.slow
def test_one_call_searches_in_simulation(capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[int] = []
    result = hexctl.adapt(
        failed_leg=4,
        budget=2,
        duration_s=3.0,
        prior="none",
        seed=2,
        on_trial=lambda _, trial: seen.append(trial.index),
    )
    assert seen == [1, 2]
    assert (result.ended, result.trouble, result.walked) == ("budget", None, 2)
    assert result.best is not None
    assert result.best in result.trials
    assert result.to_dict()["best"]["code"] == result.best.code
    assert result.overview is not None
    assert all(Path(trial.recording or "").stat().st_size > 10_000 for trial in result.trials)
    assert f"best code {result.best.code}" in repr(result)
    for walk in (result.best, *result.baseline, *result.trials):
        assert "\n" not in str(walk)
        assert len(str(walk)) < 160
        assert ",".join(map(str, walk.slots)) in str(walk)
    assert f"code {result.best.code}" in str(result.best)
    assert f"trial {result.best.index}" in str(result.best)
    assert "".join(capsys.readouterr()) == ""


def test_what_an_unknown_failure_breaks_is_noted_and_not_told() -> None:
    notes: list[str] = []
    result = adapt(
        failure="5:unknown",
        seed=1,
        budget=1,
        duration_s=1.0,
        prior="none",
        baseline=False,
        note=notes.append,
        record=False,
    )
    assert result.session.spec.broken.kind == "unknown"
    assert "the simulation breaks leg 5 limp; the controller is told leg 5 unknown" in notes


@pytest.mark.usefixtures("landscape")
def test_a_session_is_continued_with_more_budget() -> None:
    whole = adapt(5, budget=9, optimizer="pso", record=False, folder="whole")
    part = adapt(5, budget=4, optimizer="pso", record=False)
    with pytest.raises(InputError, match="budget: got 4, of which 4 are walked"):
        Adaptation.resume(part.session.name, budget=4, record=False)
    resumed = Adaptation.resume(part.session.name, budget=9, record=False).run()
    assert (resumed.walked, resumed.trials) == (5, whole.trials)


@pytest.mark.usefixtures("landscape")
def test_a_finished_session_is_continued_without_writing(monkeypatch: pytest.MonkeyPatch) -> None:
    whole = adapt(5, budget=2, world="Randomized:07", optimizer="random", record=False)
    assert whole.session.spec.world == "randomised:7"

    def opened(_: Path) -> None:
        raise AssertionError("a store that is opened is written")

    begun: list[str] = []
    monkeypatch.setattr("hexctl.adapt.adaptation.SessionStore", opened)
    again = Adaptation.resume(whole.session.name, record=False).run(
        on_begin=lambda session: begun.append(session.name)
    )
    assert (again.walked, again.ended, again.trials) == (0, "budget", whole.trials)
    assert begun == [whole.session.name]


@pytest.mark.usefixtures("landscape")
def test_no_other_process_can_delete_a_session_from_its_first_moment_on(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def sync_among_others(_file: int) -> None:
        for name in stored_names(Path("runs")):
            with pytest.raises(InputError, match="another process"):
                delete_session(name)

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", sync_among_others)
        result = adapt(5, budget=2, optimizer="random", record=False)
    assert load_session(result.session.name) == result.session
    assert len(result.trials) == 2


@pytest.mark.usefixtures("landscape")
def test_a_session_is_loaded_when_it_is_resumed_and_when_it_is_held(monkeypatch: pytest.MonkeyPatch) -> None:
    name = adapt(5, budget=2, optimizer="random", record=False).session.name
    loads: list[str] = []

    def counted(named: str, folder: Path | str) -> Session:
        loads.append(named)
        return load_session(named, folder)

    monkeypatch.setattr("hexctl.adapt.adaptation.load_session", counted)
    assert Adaptation.resume(name, budget=3, record=False).run().walked == 1
    assert loads == [name] * 2
    finished = load_session(name)
    del loads[:]
    assert Adaptation.resume(finished, record=False).run().session is finished
    assert not loads


@pytest.mark.usefixtures("landscape")
def test_trials_that_were_added_since_a_session_was_loaded_are_kept() -> None:
    whole = adapt(5, budget=9, optimizer="pso", record=False, folder="whole")
    part = adapt(5, budget=4, optimizer="pso", record=False)
    later = Adaptation.resume(part.session, budget=9, record=False)
    Adaptation.resume(part.session.name, budget=6, record=False).run()
    added = later.run()
    assert (added.walked, added.trials) == (3, whole.trials)


@pytest.mark.usefixtures("landscape")
def test_one_adaptation_continues_its_session_until_it_has_ended() -> None:
    stops = iter([False] * 3 + [True])
    part = adapt(5, budget=4, optimizer="pso", record=False, stop_requested=lambda: next(stops, True))
    assert part.ended == "interrupted"
    resumed = Adaptation.resume(part.session.name, record=False)
    assert resumed.run().ended == "budget"
    again = resumed.run()
    assert (again.walked, again.ended, len(again.trials)) == (0, "budget", 4)


@pytest.mark.usefixtures("landscape")
def test_optimizer_and_objective_of_ones_own() -> None:
    result = adapt(5, budget=5, optimizer=Backwards, objective=to_the_left, record=False)
    spec = result.session.spec
    assert (spec.optimizer, spec.objective) == (f"{__name__}:Backwards", f"{__name__}:to_the_left")
    assert (spec.objective_label, spec.objective_unit) == ("Distance to the left", "")
    assert result.best is not None
    assert result.best.score == min(
        trial.outcome["deviation_m"]["signed"] for trial in result.trials if trial.valid
    )
    resumed = Adaptation.resume(result.session.name, budget=8, trust=True, record=False).run()
    assert resumed.walked == 3


@pytest.mark.usefixtures("landscape")
def test_those_that_cannot_be_imported_are_given_again() -> None:
    class Local(Backwards):
        pass

    parts: dict[str, Any] = {"optimizer": Local, "objective": lambda result: -to_the_left(result)}
    result = adapt(5, budget=3, record=False, **parts)
    with pytest.raises(InputError, match="cannot be loaded"):
        Adaptation.resume(result.session.name, budget=4, trust=True, record=False)
    resumed = Adaptation.resume(result.session.name, budget=4, record=False, **parts)
    assert resumed.run().walked == 1


@pytest.mark.usefixtures("landscape")
def test_a_stop_can_be_requested() -> None:
    stopping: list[bool] = []
    spec = new_spec(failed_leg=5, prior="none", budget=6)
    adaptation = Adaptation(spec, record=False)
    result = adaptation.run(on_trial=lambda *_: stopping.append(True), stop_requested=lambda: bool(stopping))
    assert (result.ended, result.walked, result.session.ended) == ("interrupted", 1, None)
    with pytest.raises(NotBegunError):
        Adaptation(spec, record=False).run(stop_requested=lambda: True)
    assert len(list_sessions()) == 1


class Measures:
    """An operator who measures the same each time."""

    def __init__(self) -> None:
        self.placed: list[int] = []

    def place(self, index: int, code: int) -> bool:
        self.placed.append(code)
        return True

    def measure(self, index: int, *, at_most_m: float) -> Answer:
        return Answer(word="measured", distance_m=0.9 * at_most_m / 2, signed_m=0.1)


def test_a_connected_robot_and_an_operator() -> None:
    operator = Measures()
    result = adapt(
        5,
        budget=2,
        duration_s=1.0,
        servos=Blind(shipped()),
        operator=operator,
        prior="none",
        record=False,
        baseline=False,
    )
    assert [trial.score for trial in result.trials] == [pytest.approx(0.1)] * 2
    assert operator.placed == [trial.code for trial in result.trials]
    assert result.session.spec.backend == "tests.cli.adaptkits:Blind"
    (robot,) = Kit.made
    assert robot.closed


class Lost:
    """A live view whose viewer has ended."""

    lost = "the live view has ended"
    block_ticks = None

    def __enter__(self) -> "Lost":
        return self

    def __exit__(self, *_: object) -> None: ...

    def begin(self, *_: object, **__: object) -> None: ...

    def write_block(self, *_: object) -> None: ...


def test_a_live_view_that_was_lost_is_told_and_ends_no_search() -> None:
    notes: list[str] = []
    spec = new_spec(
        failed_leg=5, backend="tests.cli.adaptkits:Blind", ask=True, prior="none", budget=1, duration_s=1.0
    )
    view: Any = Lost()
    adaptation = Adaptation(spec, operator=Measures(), record=False, live=lambda: view, note=notes.append)
    assert adaptation.run().walked == 1
    assert notes[-1] == "the live view has ended; the trials are not affected"


def test_a_robot_that_stops_raises_and_the_session_stays() -> None:
    with pytest.raises(RobotStoppedError, match="estop"):
        adapt(
            5,
            budget=3,
            duration_s=1.0,
            self_rotation="none",
            backend="tests.cli.adaptkits:EStopped",
            prior="none",
            record=False,
            baseline=False,
        )
    (session,) = list_sessions()
    assert len(session.trials) == 1
    result = Adaptation.resume(session.name, record=False, servos=EStopped(shipped())).run()
    assert (result.ended, result.walked) == ("budget", 2)


@pytest.mark.slow
@pytest.mark.parametrize("policy", ["stop", "glide"])
def test_a_trial_in_which_another_leg_fails_does_not_count(policy: str, tmp_path: Path) -> None:
    world = tmp_path / "breaks.yaml"
    world.write_text("failures: ['2:limp@4']\n")
    options: dict[str, Any] = {"failed_leg": 5, "duration_s": 8.0, "budget": 1, "record": False}
    with pytest.raises(LegFailedError, match=r"trial 1 does not count: leg 2 limp, noticed 4") as raised:
        adapt(**options, world=str(world), policy=policy, baseline=False)
    assert raised.value.legs == (2,)
    (summary,) = list_sessions()
    session = load_session(summary.name)
    assert (session.trials, session.spec.policy) == ([], policy)
    world.write_text("failures: []\n")  # the leg is mended
    resumed = Adaptation.resume(summary.name, record=False).run()
    assert [trial.valid for trial in resumed.session.trials] == [True]


@pytest.mark.slow
def test_legs_are_not_watched_unless_asked(tmp_path: Path) -> None:
    world = tmp_path / "breaks.yaml"
    world.write_text("failures: ['2:limp@2']\n")
    result = adapt(failed_leg=5, duration_s=4.0, budget=1, record=False, world=str(world), baseline=False)
    assert len(result.session.trials) == 1


def test_a_target_may_be_a_share_of_the_distance() -> None:
    spec = new_spec(failed_leg=5, prior="none", target="1%", duration_s=10.0)
    ideal_m = 1.5 * 0.11 * 0.9 * 10.0
    assert spec.target_m == pytest.approx(0.01 * ideal_m)
    assert spec.target_share == 0.01
    assert spec.target_text == "1.49 cm (1 % of 1.49 m)"
    metres = new_spec(failed_leg=5, prior="none", target="0.05")
    assert (metres.target_m, metres.target_share, metres.target_text) == (0.05, None, "5 cm")
    assert new_spec(failed_leg=5, prior="none", target=0.05) == metres
    assert new_spec(failed_leg=5, prior="none", target_m=0.05) == metres


def test_a_share_of_the_distance_loads_its_world_once(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = mock.Mock(side_effect=load_world)
    monkeypatch.setattr("hexctl.adapt.setting.load_world", loaded)
    new_spec(failed_leg=5, prior="none", target="1%", world="slope")
    assert loaded.call_count == 1


@pytest.mark.slow
def test_a_session_reads_its_prior_once(monkeypatch: pytest.MonkeyPatch) -> None:
    made = mock.Mock()
    monkeypatch.setattr(Prior, "__post_init__", lambda prior: made(prior.key))
    result = adapt(5, budget=1, baseline=False, record=False)
    assert result.session.spec.sag_rad is not None
    assert made.call_count == 1


def test_a_search_with_a_prior_knows_what_a_trial_is_worth() -> None:
    uncertain = new_spec(failed_leg=5)
    assert uncertain.worth_m == pytest.approx(uncertain.uncertainty_m)
    assert new_spec(failed_leg=5, uncertainty_m=0).worth_m == pytest.approx(0.001)
    assert new_spec(failed_leg=5, worth_m=0.01).worth_m == 0.01
    assert new_spec(failed_leg=5, prior="none").worth_m is None


@pytest.mark.parametrize(
    "options", [{"prior": "none"}, {"optimizer": "random"}, {"duration_s": 7.0}, {"objective": "mean"}]
)
def test_a_search_without_a_belief_does_not_know_what_a_trial_is_worth(options: dict[str, Any]) -> None:
    with pytest.raises(InputError, match="prior"):
        new_spec(failed_leg=5, worth_m=0.01, **options)


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"target": "0%"}, "target: got 0%; allowed: a number above 0, or a share"),
        ({"target": "much"}, "target: got 'much'"),
        ({"target": "1%", "target_m": 0.1}, "allowed: one of the two"),
        ({"worth_m": -1.0}, "worth_m: got -1; allowed: 0 m or more"),
        ({"uncertainty_m": -1.0}, "uncertainty_m: got -1; allowed: 0 m or more"),
        (
            {"uncertainty_m": 0.1, "backend": "mock"},
            "uncertainty_m: got 0.1 with backend mock; allowed: with",
        ),
        (
            {"uncertainty_m": 0.1, "objective": "progress"},
            "uncertainty_m: got 0.1 with objective progress; allowed: with final",
        ),
        ({"failed_leg": 7}, "7"),
        ({"world": "mars"}, "mars"),
        ({"budget": 0}, "budget: got 0; allowed: 1..100000"),
        ({"optimizer": "magic"}, "magic"),
        ({"optimizer": Landscape}, "allowed: a name, or a subclass of Optimizer"),
        ({"objective": "haste"}, "haste"),
        ({"objective": 3}, "allowed: a name, an Objective, or a function"),
        ({"arena_m": 3.0}, "arena_m: got it with backend sim"),
        ({"backend": "mock", "home_m": (0.0, 1.0)}, "without arena_m; allowed: with it"),
        (
            {"backend": "mock", "arena_m": 9.0, "home_m": (0.0, math.nan)},
            r"home_m: got \[0.0, nan\]; allowed: x and y in m",
        ),
        ({"backend": "mock", "world": "flat"}, "world: got flat with backend mock"),
    ],
)
def test_bad_input_is_refused_before_a_session_exists(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        adapt(**{"failed_leg": 5, **options})
    assert not Path("runs").exists()


def test_an_operator_is_needed_to_measure() -> None:
    spec = new_spec(failed_leg=5, backend="mock", ask=True, prior="none")
    with pytest.raises(InputError, match="operator: got none"):
        Adaptation(spec)


@pytest.mark.parametrize(
    ("parts", "words"),
    [
        ({"operator": Measures()}, "operator: got one without ask"),
        ({"optimizer": Backwards}, r"optimizer: got .*:Backwards for a session with pso"),
        ({"objective": "mean"}, "objective: got mean for a session with final"),
        ({"objective": to_the_left}, "objective: got .*:to_the_left for a session with final"),
    ],
)
def test_parts_that_contradict_the_spec_are_refused(parts: dict[str, Any], words: str) -> None:
    spec = new_spec(failed_leg=5, optimizer="pso")
    with pytest.raises(InputError, match=words):
        Adaptation(spec, **parts)
    assert Adaptation(spec, optimizer="pso", objective="final").spec is spec


def test_bayes_may_be_named_by_its_class() -> None:
    assert new_spec(failed_leg=5, optimizer=Bayes) == new_spec(failed_leg=5, optimizer="bayes")


@pytest.mark.usefixtures("landscape")
def test_an_overview_that_cannot_be_drawn_costs_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("no picture")

    monkeypatch.setattr("hexctl.adapt.sessions.session_viewing.write_overview_file", broken)
    notes: list[str] = []
    result = adapt(5, budget=2, prior="none", note=notes.append)
    assert (result.ended, result.overview, notes[-1]) == ("budget", None, "no overview: no picture")


@pytest.mark.slow
def test_a_robot_without_a_position_is_refused() -> None:
    with pytest.raises(RobotFaultError, match="knows no position"):
        adapt(5, backend="mock", duration_s=0.5, record=False)


@pytest.mark.usefixtures("landscape")
def test_sessions_are_listed_exported_and_deleted() -> None:
    assert list_sessions() == []
    for load in (load_session, Adaptation.resume):
        with pytest.raises(InputError, match="none yet"):
            load("unknown")
    assert not Path("runs").exists()
    result = adapt(5, budget=3, record=False)
    (session,) = list_sessions()
    assert session.name == result.session.name
    assert load_session(session.name).trials == result.trials
    export_session(session.name, "trials.csv")
    assert len(Path("trials.csv").read_text().splitlines()) == 4
    delete_session(session.name)
    assert list_sessions() == []


def test_a_search_without_a_valid_trial_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(TrialRunner, "walk", lambda *_: WalkedTrial(result=result_of(0.1, "fell")))
    result = adapt(5, budget=2, record=False)
    assert (result.best, result.to_dict()["found"]) == (None, False)
    assert "no valid trial" in repr(result)


def test_early_stopping_is_for_optimizers_that_know_when() -> None:
    assert new_spec(failed_leg=5, optimizer=Backwards, early_stop=True).early_stop
    with pytest.raises(InputError, match="early_stop: got it without a prior"):
        new_spec(failed_leg=5, optimizer="pso", early_stop=True)


@pytest.mark.parametrize("part", ["on_trial", "stop_requested", "note"])
def test_what_must_be_a_function_is_refused_by_name(part: str, tmp_path: Path) -> None:
    given: dict[str, Any] = {part: 3}
    with pytest.raises(WrongTypeError, match=rf"^{part}: got 3 .int.; allowed: a function"):
        adapt(5, optimizer="random", **given)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_speed_is_searched_with_steered_walks_and_the_session_keeps_its_hold() -> None:
    notes: list[str] = []
    begun = adapt(5, budget=2, duration_s=3.0, objective="speed", record=False, note=notes.append)
    assert begun.session.spec.hold == "auto"
    assert (begun.session.spec.prior, begun.session.spec.uncertainty_m) == (None, 0.0)
    (note,) = [note for note in notes if "no prior" in note]
    assert "duration 30 s, not 3 s" in note
    assert note.endswith("searching with random instead")
    again = Adaptation.resume(begun.session.name, budget=3, record=False).run()
    assert again.session.spec.hold == "auto"
    stored = again.to_dict()
    walks = [*stored["baseline"], *stored["trials"]]
    assert [walk["hold"] for walk in walks] == ["line"] * 6
    for walk in walks:
        assert walk["score"] == pytest.approx(3.0 / walk["distance_m"])
        assert walk["cost_of_transport"] > 0
    front = again.session.pareto([make_objective("speed"), make_objective("cost")])
    assert 1 <= len(front) <= 3
    assert front[0][0] is again.best


def test_a_prior_is_for_the_hold_it_was_built_with() -> None:
    notes: list[str] = []
    spec = new_spec(failed_leg=5, hold="line", note=notes.append)
    assert (spec.optimizer, spec.prior, spec.hold) == ("random", None, "line")
    assert len(notes) == 1
    assert "priors of steered walks are for speed, cost, tilt, steadiness, not final" in notes[0]
    with pytest.raises(InputError, match="hold none, not line"):
        new_spec(failed_leg=5, hold="line", objective="speed", prior="ant-locked-rear-30s")
    assert new_spec(failed_leg=5).hold == "none"


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({"hold": "sideways"}, "hold: got sideways; allowed: auto, line, heading, none"),
        ({"objective": "tilt", "backend": "mock", "ask": True}, "objective: got tilt with ask"),
        ({"hold": "line", "backend": "mock", "ask": True}, "hold: got line with ask"),
    ],
)
def test_holds_and_objectives_that_do_not_fit_are_refused(options: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError, match=words):
        new_spec(failed_leg=5, **options)


def test_a_robot_that_does_not_tell_its_torques_is_not_searched_for_its_cost() -> None:
    with pytest.raises(InputError, match="got cost with a robot that does not tell its joint torques"):
        adapt(5, backend="tests.cli.adaptkits:Straight", objective="cost", record=False)
    assert list_sessions() == []


@pytest.mark.usefixtures("landscape")
def test_a_session_whose_folder_is_deleted_ends_with_one_error(tmp_path: Path) -> None:
    def delete(_: Session, trial: TrialRecord) -> None:
        if trial.index == 2:
            shutil.rmtree(tmp_path / "runs")

    adaptation = Adaptation(new_spec(failed_leg=5, prior="none", budget=6), record=False)
    with pytest.raises(StoreError, match="was deleted"):
        adaptation.run(on_trial=delete)
    assert list_sessions(tmp_path / "runs") == []


def test_a_recording_that_cannot_be_written_does_not_hide_that_the_store_is_gone(tmp_path: Path) -> None:
    spec = new_spec(failed_leg=5, prior="none", budget=6, baseline=False)
    adaptation = Adaptation(spec, record=False)

    def lose(_: TrialRunner, *_trial: object) -> WalkedTrial:
        shutil.rmtree(tmp_path / "runs")
        raise RecordingError("runs/trial-001.rrd: the recording cannot be written")

    with mock.patch.object(TrialRunner, "walk", lose), pytest.raises(StoreError, match="was deleted"):
        adaptation.run()
