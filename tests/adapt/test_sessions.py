"""A session: its spec, its table, its overview, what it expected, and how it compares with others."""

import json
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import fields, replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any
from urllib.request import urlopen

import numpy as np
import pytest

import hexctl
from hexctl.adapt.adapt_options import AdaptOptions
from hexctl.adapt.runner import TrialRunner
from hexctl.adapt.search import new_spec
from hexctl.adapt.sessions.comparison import check_comparable
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.adapt.sessions.session_tables import ASKED_COLUMNS, flat_rows
from hexctl.adapt.sessions.session_viewing import make_overview, recordings_of, serve_runs
from hexctl.adapt.sessions.store import FILE_NAME, SessionStore, list_sessions, load_session
from hexctl.cli.main import exit_code
from hexctl.control.planning.top_speed import STRIDE
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.recording.sessions.session_overview import make_table
from hexctl.robot.failure import Failure
from tests.adapt.walking import SPEC, UNSEEN, Landscape, baseline_record, record, result_of, stored_session


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
    name = store.create(spec).name
    assert load_session(name, tmp_path).spec == spec
    stored = json.loads((tmp_path / name / FILE_NAME).read_text())["session"]["spec"]
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
    (begun_so,) = list_sessions()
    assert (begun_so.spec.duration_s, begun_so.spec.optimizer) == (7.0, "pso")
    Path("hexctl.toml").write_text("[adapt]\nduration = 9\noptimizer = 'dps'\nseed = 4\n")
    assert exit_code(["adapt", "--resume", begun_so.name, "--budget", "4", "--no-record", "--quiet"]) == 0
    again = load_session(begun_so.name)
    assert len(again.trials) == 4
    assert (again.spec.duration_s, again.spec.optimizer, again.spec.seed) == (7.0, "pso", 0)
    capsys.readouterr()


@pytest.mark.parametrize("field", ["optimizer", "objective", "backend", "recovery"])
def test_a_session_imports_no_code_without_trust(field: str) -> None:
    spec = new_spec(failed_leg=5)
    spec.check_trusted((), trust=False)
    named: dict[str, Any] = {field: "planted:Thing"}
    foreign = replace(spec, **named)
    with pytest.raises(InputError, match="trust"):
        foreign.check_trusted((), trust=False)
    foreign.check_trusted((), trust=True)
    foreign.check_trusted({"servos" if field == "backend" else field}, trust=False)


def test_a_session_of_another_user_or_computer_chooses_no_robot_without_trust(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    spec = replace(new_spec(failed_leg=5), backend="zenoh", connect="tcp/127.0.0.1:7447")
    name = SessionStore(tmp_path).create(spec).name
    own = load_session(name, tmp_path).spec
    own.check_trusted((), trust=False)
    others: list[dict[str, Any]] = [{"connect": "tcp/10.0.0.7:7447"}, {"backend": "dynamixel"}, {"seal": "é"}]
    for foreign in (spec, *(replace(own, **other) for other in others), own):
        if foreign is own:
            monkeypatch.setenv("XDG_STATE_HOME", str(tmp_path / "of another user"))
        with pytest.raises(InputError, match=r"session: .* its robot.*trust"):
            foreign.check_trusted((), trust=False)
        foreign.check_trusted((), trust=True)
        foreign.check_trusted({"servos"}, trust=False)


def session(*results: float | TrialResult, name: str = "a", **spec: Any) -> Session:
    """A session whose trials have these results, or end so far to the left of the line."""
    trials = [record(index, result) for index, result in enumerate(results, start=1)]
    return Session(name=name, spec=replace(SPEC, **spec), created="2026-01-01", trials=trials)


@pytest.mark.parametrize(
    "others", [[], [session(0.1)], [session(0.1, name="b", objective="mean")], [session(name="b")]]
)
def test_what_cannot_be_compared_is_refused(others: list[Session]) -> None:
    with pytest.raises(InputError, match="session: "):
        check_comparable([session(0.1), *others])


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
    assert Path(out).read_bytes().startswith(b"\x89PNG")
    capsys.readouterr()
    for path in ("best.png", "best.svg", "nowhere/best.png"):
        assert exit_code(["sessions", "compare", *names, "--out", path]) == 2
        assert "--out: " in capsys.readouterr().err
    assert exit_code(["sessions", "compare", names[0], "nobody"]) == 2
    assert exit_code(["sessions", "compare", names[0]]) == 2


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
    sessions = {one.name: one for one in list_sessions(tmp_path)}
    for row in table.to_dict("records"):
        trial = sessions[row["session"]].trials[row["index"] - 1]
        assert row["slots"] == " ".join(map(str, trial.slots))
        assert (row["score"], row["status"]) == (trial.score, trial.as_json()["status"])
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(MissingExtraError, match="data"):
        hexctl.sessions(tmp_path)


def test_exported_rows_are_trials_alone_and_the_baseline_is_columns() -> None:
    both = session(0.2, 0.2)
    without = flat_rows(both)
    both.baseline.append(baseline_record("tripod", result_of(0.0, "no_progress")))
    rows = flat_rows(both)
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


def test_trials_keep_their_numbers_and_invalid_ones_have_no_score() -> None:
    overview = make_overview(session(-0.3, result_of(0.0, "no_progress"), 0.02))
    assert [trial.score_m for trial in overview.trials] == [0.3, None, 0.02]
    assert [trial.deviation_m for trial in overview.trials] == [-0.3, 0.0, 0.02]
    assert [trial.status for trial in overview.trials] == ["ok", "no_progress", "ok"]
    assert overview.best is overview.trials[2]
    assert overview.course_m == 4.455


def test_a_trial_that_never_set_out_or_diverged_has_no_impossible_points() -> None:
    lost = replace(UNSEEN, status="aborted")
    wild = replace(result_of(0.0, "diverged"), path_m=np.full((40, 2), np.nan))
    overview = make_overview(session(lost, wild))
    assert [len(trial.path_m) for trial in overview.trials] == [0, 1]
    assert overview.best is None


def test_the_baseline_is_shown_before_the_trials_and_is_never_the_best() -> None:
    shown = session(-0.3)
    shown.trials.append(record(2, -0.3, confirms=True))
    shown.baseline.append(baseline_record("tripod", 0.01))
    overview = make_overview(shown)
    assert overview.best is overview.trials[0]
    assert overview.trials[1].status == "ok (repeat)"
    assert "without a search: tripod 1.0 cm" in overview.facts
    rows = [row for row in make_table(overview).splitlines() if row.startswith("| ")]
    assert rows[1].startswith("| 0 | tripod | 1,4,1,4,1,4 | 1.0 cm left |")


def test_of_the_recordings_of_a_session_those_that_exist_are_found(tmp_path: Path) -> None:
    one = session(0.1, 0.2)
    one.trials = [replace(trial, recording=f"trial-{trial.index}.rrd") for trial in one.trials]
    one.baseline = [replace(baseline_record("auto", 0.3), recording="elsewhere/auto.rrd")]
    for name in ("auto.rrd", "trial-2.rrd", "trial-3.rrd"):
        (tmp_path / name).touch()
    assert recordings_of(one, tmp_path) == {"auto": tmp_path / "auto.rrd", 2: tmp_path / "trial-2.rrd"}


def test_a_browser_gets_recordings_of_one_name_and_sessions_until_the_viewer_ends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    paths = [tmp_path / folder / "walk.rrd" for folder in ("a", "b")]
    for path in paths:
        path.parent.mkdir()
        path.write_bytes(b"RRF2" + 8 * path.parent.name.encode())
    name, fetched = stored_session(tmp_path, 0.03), list[bytes]()

    @contextmanager
    def viewer(_port: int, urls: Sequence[str]) -> Iterator[SimpleNamespace]:
        for url in urls:
            with urlopen(url) as answer:  # noqa: S310  loopback
                fetched.append(answer.read())
        yield SimpleNamespace(poll=lambda: 9, returncode=9)

    def drawn(path: Path, _: object) -> None:
        path.parent.mkdir()
        path.write_bytes(b"RRF2overview")

    viewing = "hexctl.adapt.sessions.session_viewing"
    monkeypatch.setattr(f"{viewing}.serve_web", viewer)
    monkeypatch.setattr(f"{viewing}.write_overview_file", drawn)
    names = [str(paths[0]), name, str(paths[1])]
    serve_runs(names, tmp_path, on_url=str, stop_requested=lambda: True)
    assert fetched == [paths[0].read_bytes(), b"RRF2overview", paths[1].read_bytes()]
    with pytest.raises(RecordingError, match="ended with 9"):
        serve_runs(names, tmp_path, on_url=str, stop_requested=iter([False, True]).__next__)
