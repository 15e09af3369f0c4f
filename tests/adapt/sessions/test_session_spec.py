"""The spec of a session: what was asked for, as it was resolved, is what is stored and continued."""

import json
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

from hexctl.adapt.adapt_options import AdaptOptions
from hexctl.adapt.adaptation import Adaptation
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.store import FILE_NAME, SessionStore, list_sessions, load_session
from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from hexctl.robot.failure import Failure
from tests.adapt.walking import Landscape


def test_every_option_of_a_search_is_stored_and_comes_back(tmp_path: Path) -> None:
    spec = new_spec(
        failure=Failure(leg=2, kind="stuck", joint="femur", angle_rad=0.123456789),
        seed=7,
        duration_s=12.5,
        heading_rad=0.1,
        hold="heading",
        target="2%",
        prior="none",
        baseline=False,
    )
    store = SessionStore(tmp_path)
    session = store.create(spec)
    assert load_session(session.name, tmp_path).spec == spec
    stored = json.loads((tmp_path / session.name / FILE_NAME).read_text())["session"]["spec"]
    assert {field.name for field in fields(AdaptOptions)} < set(stored)
    assert (spec.target_share, spec.versions["hexctl"] != "") == (0.02, True)


def test_json_has_leg_and_kind_and_degrees() -> None:
    values = SessionSpec(
        failure=(Failure(leg=3, kind="weak", torque_fraction=0.5),), heading_rad=0.5
    ).as_json()
    assert (values["failed_leg"], values["failure"]) == (3, "weak:0.5")
    assert values["heading_deg"] == pytest.approx(28.6478897565)
    assert "heading_rad" not in values


def test_a_session_continues_as_it_began_whatever_the_settings_say_by_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TrialRunner, "walk", lambda _, *trial: Landscape()(*trial))
    Path("hexctl.toml").write_text("[adapt]\nduration = 7\noptimizer = 'pso'\n")
    begun = ["adapt", "--failed-leg", "5", "--budget", "2", "--no-record", "--quiet"]
    assert exit_code(begun) == 0
    (session,) = list_sessions()
    assert (session.spec.duration_s, session.spec.optimizer) == (7.0, "pso")
    Path("hexctl.toml").write_text("[adapt]\nduration = 9\noptimizer = 'dps'\nseed = 4\n")
    assert exit_code(["adapt", "--resume", session.name, "--budget", "4", "--no-record", "--quiet"]) == 0
    again = load_session(session.name)
    assert len(again.trials) == 4
    assert (again.spec.duration_s, again.spec.optimizer, again.spec.seed) == (7.0, "pso", 0)
    capsys.readouterr()


@pytest.mark.parametrize("field", ["optimizer", "objective", "backend", "policy"])
def test_a_session_imports_no_code_without_trust(field: str) -> None:
    spec = new_spec(failed_leg=5)
    spec.check_trusted((), trust=False)
    named: dict[str, Any] = {field: "planted:Thing"}
    foreign = replace(spec, **named)
    with pytest.raises(InputError, match="trust"):
        foreign.check_trusted((), trust=False)
    foreign.check_trusted((), trust=True)
    foreign.check_trusted({"servos" if field == "backend" else field}, trust=False)


def test_resuming_a_foreign_session_runs_none_of_its_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "planted_score.py").write_text("open('ran', 'w').close()\ndef score(result): return 1.0\n")
    foreign = replace(new_spec(failed_leg=5, budget=2), objective="planted_score:score")
    store = SessionStore(tmp_path / "runs")
    name = store.create(foreign).name
    for session in (name, load_session(name, tmp_path / "runs")):
        with pytest.raises(InputError, match="trust"):
            Adaptation.resume(session, folder=tmp_path / "runs", record=False)
    assert not (tmp_path / "ran").exists()
    Adaptation.resume(name, folder=tmp_path / "runs", record=False, trust=True)
    assert (tmp_path / "ran").exists()
