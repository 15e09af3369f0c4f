"""`hexctl view` with a program in the viewer's place."""

import os
from pathlib import Path

import numpy as np
import pytest
import rerun as rr

from hexctl.adapt.session import TrialRecord
from hexctl.adapt.store import SessionStore
from hexctl.cli.main import exit_code
from hexctl.record import viewer
from tests.adapt.walking import SPEC, result_of


@pytest.fixture(autouse=True)
def _in_an_empty_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Work in an empty folder, with a viewer that notes what it is to open."""
    monkeypatch.chdir(tmp_path)
    program = tmp_path / "viewer"
    program.write_text('#!/bin/sh\nprintf "%s\\n" "$@" > opened\n')
    program.chmod(0o755)
    monkeypatch.setattr(viewer, "viewer_binary", lambda: program)


def opened() -> list[str]:
    return [line for line in Path("opened").read_text().splitlines() if line.endswith(".rrd")]


def recording(path: Path, age_s: int) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(b"RRF2")
    os.utime(path, (2_000_000_000 - age_s, 2_000_000_000 - age_s))
    return path


def session(trials: int, *, age_s: int = 10, missing: tuple[int, ...] = ()) -> str:
    """Make a session whose recordings are so old."""
    with SessionStore(Path("runs")) as store:
        made = store.create(SPEC)
        for index in range(1, trials + 1):
            result = result_of(0.1 * index)
            path = store.folder_of(made.name) / f"trial-{index:03d}.rrd"
            if index not in missing:
                recording(path, age_s)
            trial = TrialRecord(
                index=index,
                code=index,
                slots=(1, 2, 3, 4, 5, 6),
                score=0.1 * index,
                outcome=result.numbers(),
                path_m=np.round(result.path_m[::10], 4).tolist(),
                recording=str(path),
            )
            store.add_trial(made, trial, {})
    return made.name


def table_of(overview: Path) -> str:
    """Return the table of an overview, with its links."""
    chunks = rr.chunk.RrdReader(overview).stream().to_chunks()
    (table,) = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == "/table"]
    text: str = table.column("TextDocument:text").to_pylist()[0][0]
    return text


def test_a_session_opens_as_its_overview_with_a_link_to_each_trial() -> None:
    name = session(3)
    assert exit_code(["view", name]) == 0
    assert opened() == [f"runs/{name}/overview.rrd"]
    table = table_of(Path(opened()[0]))
    for index in (1, 2, 3):
        assert f"[▶ {index}]({Path.cwd().as_uri()}/runs/{name}/trial-00{index}.rrd)" in table


def test_an_overview_from_before_the_last_trials_is_made_anew() -> None:
    name = session(2)
    stale = Path("runs", name, "overview.rrd")
    stale.write_bytes(b"RRF2")
    assert exit_code(["view", name]) == 0
    assert stale.stat().st_size > 1000


def test_a_folder_as_the_shell_completes_it_is_a_session_too() -> None:
    name = session(1)
    assert exit_code(["view", f"runs/{name}/"]) == 0
    assert opened() == [f"runs/{name}/overview.rrd"]


def test_deleted_recordings_have_no_link() -> None:
    name = session(3, missing=(2,))
    assert exit_code(["view", name]) == 0
    table = table_of(Path(opened()[0]))
    assert "▶ 1" in table
    assert "▶ 2" not in table
    assert "▶ 3" in table


def test_recordings_and_sessions_open_together() -> None:
    name = session(1)
    recording(Path("mine.rrd"), 0)
    assert exit_code(["view", "mine.rrd", name]) == 0
    assert [Path(path).name for path in opened()] == ["mine.rrd", "overview.rrd"]


def test_without_a_name_the_newest_is_opened_session_or_recording() -> None:
    older, newer = session(1, age_s=30), session(1, age_s=20)
    assert exit_code(["view"]) == 0
    assert opened()[0] == f"runs/{newer}/overview.rrd"
    assert exit_code(["view", older]) == 0
    assert exit_code(["view"]) == 0
    assert opened()[0] == f"runs/{newer}/overview.rrd"
    recording(Path("runs/walk.rrd"), 10)
    assert exit_code(["view"]) == 0
    assert opened() == ["runs/walk.rrd"]


@pytest.mark.parametrize("name", ["nobody", "runs", "gone.rrd", "viewer"])
def test_what_cannot_be_opened_is_said_in_one_line(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    known = session(1)
    assert exit_code(["view", name]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    assert name in error
    assert (known in error) == (name in ("nobody", "runs"))
    assert not Path("opened").exists()


def test_without_sessions_and_recordings_nothing_is_made(capsys: pytest.CaptureFixture[str]) -> None:
    assert exit_code(["view", "nobody"]) == 2
    assert "none yet" in capsys.readouterr().err
    assert exit_code(["view"]) == 2
    assert "no recording" in capsys.readouterr().err
    assert not Path("runs").exists()


def test_a_session_without_trials_is_said(capsys: pytest.CaptureFixture[str]) -> None:
    name = session(0)
    assert exit_code(["view", name]) == 2
    assert f"adapt --resume {name}" in capsys.readouterr().err
