"""Sessions compared by their best score so far."""

import json
from pathlib import Path

import pytest
from matplotlib.image import imread

from hexctl.adapt.sessions.comparison import best_so_far, check_comparable, differences, draw_comparison
from hexctl.adapt.sessions.search_session import Session
from hexctl.adapt.sessions.session_spec import SessionSpec
from hexctl.cli.main import exit_code
from hexctl.errors import InputError
from tests.adapt.sessions.test_search_session import trial
from tests.adapt.walking import stored_session


def session(*offs_m: float, name: str = "a", **spec: str) -> Session:
    trials = [trial(index, off_m) for index, off_m in enumerate(offs_m, start=1)]
    return Session(name=name, spec=SessionSpec(failed_leg=5, **spec), created="2026-01-01", trials=trials)  # type: ignore[arg-type]


def test_the_best_so_far_never_rises_and_an_invalid_trial_is_none() -> None:
    assert best_so_far(session(1e9, 0.3, 0.5, 0.1)) == [None, 0.3, 0.3, 0.1]


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


def test_what_two_searches_do_not_share_is_named() -> None:
    assert differences([session(0.1), session(0.2, name="b", optimizer="random")]) == []
    (found,) = differences([session(0.1), session(0.2, name="b", world="rough")])
    assert found == "world (flat, rough)"


def test_the_plot_is_a_new_png(tmp_path: Path) -> None:
    both = [session(0.3, 0.1), session(0.5, 0.2, 0.05, name="b")]
    draw_comparison(both, tmp_path / "best.png")
    assert imread(tmp_path / "best.png").shape[:2] == (750, 1200)
    for path in ("best.png", "best.svg", "nowhere/best.png"):
        with pytest.raises(InputError, match="out: "):
            draw_comparison(both, tmp_path / path)


def test_the_list_has_what_each_search_recommends(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    stored_session(tmp_path / "runs", 0.12, tripod=0.001, demo=0.3)
    assert exit_code(["sessions", "list"]) == 0
    (row,) = capsys.readouterr().out.splitlines()[1:]
    assert row.split()[-4:-1] == ["tripod", "0.1", "cm"]
    assert len(row) <= 80


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
