"""`hexctl.adapt` and `Adaptation`: a search in Python, its settings, and its progress bar."""

import math
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest import mock

import pytest

import hexctl
from hexctl.adapt.adaptation import Adaptation, adapt
from hexctl.adapt.measurement import Answer
from hexctl.adapt.optimizers.baselines import RandomSearch
from hexctl.adapt.optimizers.bayes import Bayes
from hexctl.adapt.runner import LegFailedError, NotBegunError, TrialRunner
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_lines import Walk
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import FILE_NAME, list_sessions, load_session
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.backends.sim.world import World, load_world
from hexctl.control.scoring.uncertainty_store import SimulationUncertainty, keep_uncertainty
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, WrongTypeError
from hexctl.types import RobotState
from tests.adapt.walking import Landscape
from tests.cli.adaptkits import Blind
from tests.robots import shipped

pytestmark = pytest.mark.usefixtures("in_an_empty_folder")


@pytest.fixture
def landscape(monkeypatch: pytest.MonkeyPatch) -> None:
    """Walks by a formula instead of a simulation."""
    monkeypatch.setattr(TrialRunner, "walk", lambda _, request: Landscape()(request))


class Backwards(RandomSearch):
    """A search of one's own."""

    name = "backwards"


def to_the_left(result: TrialResult) -> float:
    """Distance to the left."""
    return result.deviation.signed if result.deviation is not None else 0.0


@pytest.mark.slow
def test_one_call_searches_in_simulation(capsys: pytest.CaptureFixture[str]) -> None:
    seen: list[object] = []
    result = hexctl.adapt(
        failed_leg=4,
        budget=2,
        duration_s=3.0,
        prior="none",
        seed=2,
        target_m=1e-9,
        on_stored=lambda _, walk: seen.append(walk),
    )
    assert seen == [*result.baseline, *result.trials]
    assert (result.ended, result.trouble, result.walked) == ("budget", None, 2)
    assert result.best is not None
    assert result.best in result.trials
    assert result.to_dict()["best"]["code"] == result.best.code
    assert result.overview is not None
    assert all(Path(trial.recording or "").stat().st_size > 10_000 for trial in result.trials)
    assert f"best code {result.best.code}" in repr(result)
    assert all(len(str(walk)) < 160 for walk in (*result.baseline, *result.trials))
    assert "".join(capsys.readouterr()) == ""


def test_what_an_unknown_failure_breaks_is_noted_and_not_told() -> None:
    notes: list[str] = []
    options: dict[str, Any] = {"budget": 1, "duration_s": 1.0, "prior": "none", "baseline": False}
    result = adapt(failure="5:unknown", seed=1, note=notes.append, record=False, **options)
    assert result.session.spec.broken.kind == "unknown"
    assert "simulated failure: leg 5 limp; the controller assumes leg 5 unknown" in notes


@pytest.mark.usefixtures("landscape")
def test_a_damaged_line_costs_no_recording_and_an_ended_session_stays_as_it_is() -> None:
    name = adapt(5, budget=2, optimizer="pso", prior="none", record=False).session.name
    file, recording = Path("runs", name, FILE_NAME), Path("runs", name, "trial-002.rrd")
    file.write_text(file.read_text().replace('"index": 2', '"index": '))
    recording.touch()
    resumed = Adaptation.resume(name, budget=4, record=False).run()
    assert [trial.index for trial in resumed.trials] == [1, 2, 3, 4]
    assert recording.exists()
    begun: list[Session] = []
    before = file.read_bytes(), file.stat().st_mtime_ns
    again = Adaptation.resume(name, record=False).run(on_begin=begun.append)
    assert (file.read_bytes(), file.stat().st_mtime_ns) == before
    assert (again.walked, again.ended, again.trials) == (0, "budget", resumed.trials)
    assert [session.name for session in begun] == [name]


@pytest.mark.usefixtures("landscape")
def test_a_session_that_names_foreign_code_once_it_is_held_is_not_trusted() -> None:
    name = adapt(5, budget=2, optimizer="pso", record=False).session.name
    adaptation = Adaptation.resume(name, budget=4, record=False)
    file = Path("runs", name, FILE_NAME)
    file.write_text(file.read_text().replace('"optimizer": "pso"', '"optimizer": "planted:Thing"'))
    with pytest.raises(InputError, match="trust"):
        adaptation.run()


@pytest.mark.usefixtures("landscape")
def test_a_budget_above_the_number_of_gaits_is_noted() -> None:
    notes: list[str] = []
    adapt(5, budget=500, optimizer="random", target_m=100.0, record=False, note=notes.append)
    assert any("there are 120 gaits" in note for note in notes)


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

    def stop_after_a_trial(_: Session, walk: Walk) -> None:
        stopping.extend([True] * isinstance(walk, TrialRecord))

    result = adaptation.run(on_stored=stop_after_a_trial, stop_requested=lambda: bool(stopping))
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


class Warned(Blind):
    """Warns from the beginning, and of another servo once it walks."""

    def read(self) -> RobotState:
        servos = "leg 2 femur (id 5)" + ", leg 5 femur (id 14)" * bool(self.sent)
        return replace(super().read(), warnings=(f"warm, {60 + len(self.sent) % 7} degrees C: {servos}",))


def test_an_operator_measures_a_robot_with_warnings() -> None:
    operator, notes = Measures(), list[str]()
    options: dict[str, Any] = {"budget": 2, "duration_s": 1.0, "prior": "none", "baseline": False}
    robot = Warned(shipped())
    result = adapt(5, servos=robot, operator=operator, note=notes.append, record=False, **options)
    assert [trial.score for trial in result.trials] == [pytest.approx(0.1)] * 2
    assert operator.placed == [trial.code for trial in result.trials]
    assert result.session.spec.backend == f"{__name__}:Warned"
    assert robot.closed
    told = [note.partition(": leg ")[2] for note in notes if note.startswith("servos: warm")]
    assert told == ["2 femur (id 5)", "5 femur (id 14)"]


@pytest.mark.slow
@pytest.mark.parametrize("recovery", ["stop", "glide"])
def test_a_trial_in_which_another_leg_fails_does_not_count(recovery: str, tmp_path: Path) -> None:
    world = tmp_path / "breaks.yaml"
    world.write_text("failures: ['2:limp@4']\n")
    options: dict[str, Any] = {"failed_leg": 5, "duration_s": 8.0, "budget": 1, "record": False}
    with pytest.raises(LegFailedError, match=r"trial 1 does not count: leg 2 limp, noticed 4") as raised:
        adapt(**options, world=str(world), recovery=recovery, baseline=False)
    assert raised.value.legs == (2,)
    (summary,) = list_sessions()
    session = load_session(summary.name)
    assert (session.trials, session.spec.recovery) == ([], recovery)
    world.write_text("failures: []\n")  # the leg is mended
    resumed = Adaptation.resume(summary.name, record=False).run()
    assert [trial.valid for trial in resumed.session.trials] == [True]


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


def test_a_search_with_a_prior_knows_what_a_trial_is_worth() -> None:
    uncertain = new_spec(failed_leg=5, trim="off")
    assert uncertain.worth_m == pytest.approx(uncertain.uncertainty_m)
    assert new_spec(failed_leg=5, trim="off", uncertainty_m=0).worth_m == pytest.approx(0.001)
    assert new_spec(failed_leg=5, worth_m=0.01).worth_m == 0.01
    assert new_spec(failed_leg=5, trim="off", prior="none").worth_m is None


FOUND = SimulationUncertainty(step_m=0.03, solver_m=0.04, contact_m=0.1, walks=7, duration_s=40.0)


def spec_of(folder: Path, notes: list[str], **options: object) -> SessionSpec:
    return new_spec(failed_leg=5, prior="none", folder=folder, note=notes.append, **options)


def test_a_simulated_session_stores_the_uncertainty_that_was_measured(tmp_path: Path) -> None:
    notes: list[str] = []
    assert (
        0 < spec_of(tmp_path, notes).uncertainty_m < 0.01 < spec_of(tmp_path, notes, trim="off").uncertainty_m
    )
    keep_uncertainty(shipped(), World(), FOUND, folder=tmp_path)
    assert spec_of(tmp_path, notes, duration_s=40.0, trim="off").uncertainty_m == pytest.approx(0.03)
    assert spec_of(tmp_path, notes, duration_s=40.0, uncertainty_m=0).uncertainty_m == 0
    assert not notes


def test_walks_are_confirmed_where_a_finer_step_says_more(tmp_path: Path) -> None:
    notes: list[str] = []
    assert 0 < spec_of(tmp_path, notes, trim="off").confirmed_uncertainty_m < 0.015
    assert (
        spec_of(tmp_path, notes).confirmed_uncertainty_m
        == spec_of(tmp_path, notes, world="slope").uncertainty_m
        == 0.0
    )
    fine = tmp_path / "fine.yaml"
    fine.write_text("time_step_s: 0.0005", encoding="utf-8")
    keep_uncertainty(
        shipped(), load_world(fine), FOUND.model_copy(update={"confirmed_m": 0.01}), folder=tmp_path
    )
    at_fine = spec_of(tmp_path, notes, world=str(fine), duration_s=40.0, trim="off")
    assert (at_fine.uncertainty_m, at_fine.confirmed_uncertainty_m) == (FOUND.step_m, 0.0)
    assert spec_of(tmp_path, notes, objective="mean").confirmed_uncertainty_m == 0.0


@pytest.mark.usefixtures("landscape")
def test_an_overview_that_cannot_be_drawn_costs_no_result(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(*_: object, **__: object) -> None:
        raise ValueError("no picture")

    monkeypatch.setattr("hexctl.adapt.sessions.session_viewing.write_overview_file", broken)
    notes: list[str] = []
    result = adapt(5, budget=2, prior="none", note=notes.append)
    assert (result.ended, result.overview) == ("budget", None)
    assert "no picture" in notes[-1]


def test_an_uncertainty_that_is_not_known_is_one_note_with_its_command(tmp_path: Path) -> None:
    world = tmp_path / "coarse.yaml"
    world.write_text("time_step_s: 0.004")
    for options, command in (
        ({"duration_s": 45.0}, "hexctl check ant --physics --duration 45"),
        ({"world": str(world), "trim": "off"}, f"hexctl check ant --physics --world {world}"),
    ):
        notes: list[str] = []
        assert spec_of(tmp_path, notes, **options).uncertainty_m == 0
        (note,) = notes
        assert command in note


@pytest.mark.parametrize(
    "parts",
    [{"operator": Measures()}, {"optimizer": Backwards}, {"objective": "mean"}, {"objective": to_the_left}],
    ids=lambda parts: "-".join(parts),
)
def test_parts_that_contradict_the_spec_are_refused(parts: dict[str, Any]) -> None:
    spec = new_spec(failed_leg=5, optimizer="pso")
    with pytest.raises(InputError, match=next(iter(parts))):
        Adaptation(spec, **parts)
    assert Adaptation(spec, optimizer="pso", objective="final").spec is spec


@pytest.mark.parametrize(
    ("options", "optimizer"),
    [
        ({}, "trim"),
        ({"hold": "heading"}, "trim"),
        ({"trim": "off"}, "bayes"),
        ({"trim": "off", "prior": "none"}, "random"),
        ({"optimizer": "pso"}, "pso"),
        ({"optimizer": Bayes}, "bayes"),
        ({"optimizer": Backwards, "early_stop": True}, f"{__name__}:Backwards"),
        ({"objective": "mean"}, "random"),
        ({"hold": "line"}, "random"),
        ({"early_stop": True}, "bayes"),
        ({"objective": "speed"}, "strides"),
        ({"objective": "speed", "prior": "none"}, "random"),
        ({"objective": "speed", "hold": "none"}, "random"),
        ({"objective": "tilt"}, "bayes"),
    ],
    ids=str,
)
def test_the_default_optimizer_follows_the_options(options: dict[str, Any], optimizer: str) -> None:
    assert new_spec(failed_leg=5, **options).optimizer == optimizer


#: Options of a search that are refused before a session exists, and the named option.
REFUSED: list[tuple[dict[str, Any], str]] = [
    ({"target": "0%"}, "target"),
    ({"target": "much"}, "target"),
    ({"target": "1%", "target_m": 0.1}, "target"),
    ({"worth_m": 0.01, "prior": "none"}, "prior"),
    ({"worth_m": 0.01, "duration_s": 7.0}, "prior"),
    ({"uncertainty_m": 0.1, "backend": "mock"}, "uncertainty_m"),
    ({"uncertainty_m": 0.1, "objective": "progress"}, "uncertainty_m"),
    ({"optimizer": Landscape}, "optimizer"),
    ({"objective": "tilt", "backend": "mock", "ask": True}, "objective"),
    ({"hold": "line", "backend": "mock", "ask": True}, "hold"),
    ({"hold": "line", "objective": "speed", "prior": "ant-locked-rear-30s"}, "hold"),
    ({"hold": "line", "early_stop": True}, "prior"),
    ({"arena_m": 3.0}, "arena_m"),
    ({"backend": "mock", "home_m": (0.0, 1.0)}, "arena_m"),
    ({"backend": "mock", "arena_m": 9.0, "home_m": (0.0, math.nan)}, "home_m"),
    ({"backend": "mock", "world": "flat"}, "world"),
    ({"optimizer": "trim", "hold": "line"}, "optimizer"),
    ({"optimizer": "trim", "objective": "speed"}, "optimizer"),
    ({"optimizer": "trim", "early_stop": True}, "optimizer"),
    ({"optimizer": "trim", "worth_m": 0.0}, "optimizer"),
    ({"optimizer": "trim", "trim": "off"}, "trim"),
    ({"optimizer": "strides", "objective": "speed", "hold": "none"}, "strides"),
]


@pytest.mark.parametrize(("options", "field"), REFUSED, ids=str)
def test_options_that_do_not_fit_are_refused(options: dict[str, Any], field: str) -> None:
    with pytest.raises(InputError, match=field):
        new_spec(**{"failed_leg": 5, **options})


@pytest.mark.parametrize(
    ("options", "field"),
    [
        ({"budget": 0}, "budget"),
        ({"objective": "cost", "backend": "tests.cli.adaptkits:Straight"}, "cost"),
        *(({part: 3}, part) for part in ("on_stored", "stop_requested", "note")),
    ],
)
def test_a_search_that_is_refused_leaves_no_session(options: dict[str, Any], field: str) -> None:
    with pytest.raises((InputError, WrongTypeError), match=field):
        adapt(5, record=False, **options)
    assert list_sessions() == []


def test_an_operator_is_needed_to_measure() -> None:
    with pytest.raises(InputError, match="operator"):
        Adaptation(new_spec(failed_leg=5, backend="mock", ask=True, prior="none"))


def test_a_live_view_that_was_lost_is_told_and_ends_no_search() -> None:
    notes: list[str] = []
    spec = new_spec(
        failed_leg=5, backend="tests.cli.adaptkits:Blind", ask=True, prior="none", budget=1, duration_s=1.0
    )
    view = mock.MagicMock(lost="the live view has ended", block_ticks=None, write_block=lambda *_: None)
    view.__enter__.return_value = view
    adaptation = Adaptation(spec, operator=Measures(), record=False, live=lambda: view, note=notes.append)
    assert adaptation.run().walked == 1
    assert "the live view has ended" in notes[-1]
