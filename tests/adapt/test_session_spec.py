"""The spec of a session, its table of trials, and sessions compared by their best score so far."""

import json
import sys
from dataclasses import fields, replace
from pathlib import Path
from typing import Any

import pytest

import hexctl
from hexctl.adapt.adapt_options import AdaptOptions
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.comparison import check_comparable, draw_comparison
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.session_tables import ASKED_COLUMNS, flat_rows
from hexctl.adapt.sessions.store import FILE_NAME, SessionStore, list_sessions, load_session
from hexctl.cli.main import exit_code
from hexctl.control.assessment.top_speed import STRIDE
from hexctl.errors import InputError, MissingExtraError
from hexctl.robot.failure import Failure
from tests.adapt.walking import SPEC, Landscape, baseline_record, record, result_of, stored_session


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


def test_a_session_continues_as_it_began_whatever_the_settings_say_by_then(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(TrialRunner, "walk", lambda _, request: Landscape()(request))
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


def session(*offs_m: float, name: str = "a", **spec: str) -> Session:
    trials = [record(index, off_m) for index, off_m in enumerate(offs_m, start=1)]
    return Session(name=name, spec=SessionSpec(failed_leg=5, **spec), created="2026-01-01", trials=trials)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    "given",
    [
        [session(0.1)],
        [session(0.1), session(0.1)],
        [session(0.1), session(0.1, name="b", objective="mean")],
        [session(0.1), session(name="b")],
    ],
)
def test_what_cannot_be_compared_is_refused(given: list[Session]) -> None:
    with pytest.raises(InputError, match="session: "):
        check_comparable(given)


def test_the_plot_is_a_new_png(tmp_path: Path) -> None:
    from matplotlib.image import imread

    both = [session(0.3, 0.1), session(0.5, 0.2, 0.05, name="b")]
    draw_comparison(both, tmp_path / "best.png")
    assert imread(tmp_path / "best.png").shape[:2] == (750, 1200)
    for path in ("best.png", "best.svg", "nowhere/best.png"):
        with pytest.raises(InputError, match="out: "):
            draw_comparison(both, tmp_path / path)


def test_the_command_prints_a_column_each(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    names = [
        stored_session(tmp_path / "runs", 0.12, tripod=0.02),
        stored_session(tmp_path / "runs", 0.034),
    ]
    assert exit_code(["sessions", "compare", *names, "--out", "best.png"]) == 0
    head, tripod, row, found, out = capsys.readouterr().out.splitlines()
    assert head.split() == ["trials", *names]
    assert tripod.split() == ["0:", "tripod", "2.0", "cm", "-"]
    assert row.split() == ["best", "of", "1", "12.0", "cm", "3.4", "cm"]
    assert found.split() == ["found", "tripod", "2.0", "cm", "17", "3.4", "cm"]
    assert exit_code(["sessions", "compare", *names, "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)["sessions"]
    assert [row["without_search"] for row in rows] == [{"tripod": pytest.approx(0.02)}, {}]
    assert [row["recommended"]["code"] for row in rows] == [None, 17]
    assert Path(out).is_file()
    assert exit_code(["sessions", "compare", names[0]]) == 2
    assert exit_code(["sessions", "compare", names[0], "nobody"]) == 2


def test_every_trial_of_all_sessions_is_a_row_and_without_pandas_the_extra_is_named(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import pandas

    empty = hexctl.sessions(tmp_path)
    assert len(empty[empty["status"] == "ok"].sort_values("score")) == 0
    assert not list(tmp_path.iterdir())
    names = [stored_session(tmp_path, off_m, tripod=0.2) for off_m in (0.12, 0.03)]
    table = hexctl.sessions(tmp_path)
    assert isinstance(table, pandas.DataFrame)
    assert (table["session"].tolist(), table["failed_leg"].tolist()) == (names, [2, 2])
    assert str(table["created"].dtype).startswith("datetime64")
    sessions = {session.name: session for session in list_sessions(tmp_path)}
    for row in table.to_dict("records"):
        trial = sessions[row["session"]].trials[row["index"] - 1]
        assert row["slots"] == " ".join(map(str, trial.slots))
        assert (row["score"], row["status"]) == (trial.score, trial.as_json()["status"])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="data"):
        hexctl.sessions(tmp_path)


def test_exported_rows_are_trials_alone_and_the_baseline_is_columns() -> None:
    session = Session(name="s", spec=SPEC, created="2026-01-01", trials=[record(1), record(2)])
    without = flat_rows(session)
    session.baseline.append(baseline_record("tripod", result_of(0.0, "no_progress")))
    rows = flat_rows(session)
    assert [row["index"] for row in rows] == [1, 2]
    columns = list(rows[0])
    assert columns == list(without[0])
    asked = [*ASKED_COLUMNS, *STRIDE]
    assert [rows[0][name] for name in asked] == ["ant", "flat", "locked", 30.0, None, *[None] * len(STRIDE)]
    assert all(row["baseline_tripod_status"] == "no_progress" for row in rows)
    assert all(row["baseline_tripod_score"] is None for row in rows)
    assert all(row[name] is None for row in without for name in columns if name.startswith("baseline_"))


def test_json_has_leg_and_kind_and_degrees() -> None:
    failure = Failure(leg=3, kind="weak", torque_fraction=0.5)
    values = SessionSpec(failure=(failure,), heading_rad=0.5).as_json()
    assert (values["failed_leg"], values["failure"]) == (3, "weak:0.5")
    assert values["heading_deg"] == pytest.approx(28.6478897565)
    assert "heading_rad" not in values
