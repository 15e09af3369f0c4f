"""`hexctl view`: sessions and recordings in a stand-in for the viewer, in browsers; robots on the network."""

import os
import re
import signal
import sys
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import rerun as rr

from hexctl.adapt.sessions import session_viewing
from hexctl.adapt.sessions.store import SessionStore
from hexctl.adapt.sessions.walk_records import TrialRecord
from hexctl.adapt.space import GaitSpace
from hexctl.cli.main import exit_code
from hexctl.control.log import TickLog
from hexctl.recording import live, viewer
from hexctl.recording.viewer import viewer_binary
from hexctl.runs.run import run
from tests.adapt.walking import SPEC, result_of
from tests.recording.conftest import damage
from tests.server.processes import (
    TIMEOUT_S,
    Program,
    controlling,
    hexctl,
    program,
    served,
    wait_until,
)

pytestmark = pytest.mark.realtime

SPACE = GaitSpace((SPEC.broken.leg,))


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
    store = SessionStore(Path("runs"))
    made = store.create(SPEC)
    for index in range(1, trials + 1):
        result = result_of(0.1 * index)
        path = store.folder_of(made.name) / f"trial-{index:03d}.rrd"
        if index not in missing:
            recording(path, age_s)
        trial = TrialRecord(
            index=index,
            code=index,
            slots=SPACE.slots_of(index),
            score=0.1 * index,
            outcome=result.to_dict(),
            path_m=np.round(result.path_m[::10], 4).tolist(),
            recording=str(path),
        )
        store.add(made, trial, {})
    return made.name


def table_of(overview: Path) -> str:
    """The table of an overview, with its links."""
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


def test_an_outdated_overview_is_written_again() -> None:
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


def test_two_walks_open_as_one_scene() -> None:
    for name in ("a.rrd", "b.rrd"):
        run(duration_s=0.5, record=Path(name))
    assert exit_code(["view", "a.rrd", "b.rrd"]) == 0
    assert [Path(path).name for path in opened()] == ["side-by-side.rrd"]
    name = session(1)
    assert exit_code(["view", "a.rrd", name]) == 0
    assert [Path(path).name for path in opened()] == ["1-a.rrd", "overview.rrd"]


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


def page_of(viewer: Program) -> str:
    """What a browser gets at the address that a viewer prints."""
    viewer.wait_for("in a browser")
    match = re.search(r"http://127\.0\.0\.1:\d+/", viewer.said())
    assert match is not None

    def fetched() -> str:
        try:
            with urllib.request.urlopen(match[0], timeout=TIMEOUT_S) as answer:  # noqa: S310  loopback
                return str(answer.read().decode())
        except OSError:
            return ""

    return str(wait_until(fetched, "the page"))


def test_a_recording_is_served_to_a_browser_until_an_interrupt(tmp_path: Path) -> None:
    path = tmp_path / "walk.rrd"
    assert hexctl("run", "--duration", "1", "--record", str(path)).returncode == 0
    with program(tmp_path, "view", "hexctl", "view", "--web", str(path)) as viewer:
        assert "<html" in page_of(viewer).lower()
        viewer.signal(signal.SIGINT)
        assert viewer.wait() == 0


def test_a_robot_is_watched_while_another_commands_it(tmp_path: Path) -> None:
    with (
        served(tmp_path) as robot,
        controlling(tmp_path, robot.endpoint) as controller,
        program(tmp_path, "view", "hexctl", "view", "--web", "--connect", robot.endpoint) as viewer,
    ):
        controller.wait_for("moving")
        assert "<html" in page_of(viewer).lower()
        status = robot.status()
        assert status["stopped"] is None
        assert status["leases_refused"] == 0
        viewer.signal(signal.SIGINT)
        assert viewer.wait() == 0
        assert controller.process.poll() is None


def test_a_robot_that_ends_is_said_in_one_line(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot:
        watching = ("hexctl", "view", "--web", "--connect", robot.endpoint)
        with program(tmp_path, "view", *watching) as viewer:
            viewer.wait_for("in a browser")
            robot.signal(signal.SIGKILL)
            assert viewer.wait() == 3
            assert "silent" in viewer.said()
            assert "Traceback" not in viewer.said()


class MadeUpView:
    """Counts what it is shown, and is closed by its user in the third recording."""

    lost: str | None = None
    url: str | None = None

    def __init__(self, **_: Any) -> None:
        self.rows: list[int] = []

    def __enter__(self) -> "MadeUpView":
        return self

    def __exit__(self, *_: object) -> None:
        shown.append(self.rows)

    @property
    def open(self) -> bool:
        return len(self.rows) < 3

    def begin(self, *_: Any, **__: Any) -> None:
        self.rows.append(0)

    def write_block(self, _log: TickLog, start: int, stop: int) -> None:
        self.rows[-1] += stop - start

    def close(self, **_: Any) -> None:
        pass


shown: list[list[int]] = []


def test_a_long_watch_is_shown_in_parts_that_fit_into_memory(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live, "LiveView", MadeUpView)
    monkeypatch.setattr(live, "MAX_WATCHED_TICKS", 20)
    shown.clear()
    with served(tmp_path, backend="mock") as robot:
        assert exit_code(["view", "--web", "--connect", robot.endpoint]) == 0
    assert shown == [[20, 20, 0]]


def test_without_a_screen_a_live_view_says_so_and_the_walk_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    walked = hexctl("run", "--realtime", "--view", "--duration", "0.5", "--record", str(tmp_path / "a.rrd"))
    assert walked.returncode == 0, walked.stderr
    assert walked.stderr.count("finds no display") == 1
    assert "close the viewer" not in walked.stderr
    with served(tmp_path, backend="mock") as robot:
        watched = hexctl("view", "--connect", robot.endpoint)
    assert watched.returncode == 3
    assert "finds no display; hexctl view --web" in watched.stderr


def test_bad_input() -> None:
    assert exit_code(["view", "--keys", "x"]) == 2
    assert exit_code(["view", "a.rrd", "--connect", "tcp/127.0.0.1:1"]) == 2
    assert exit_code(["view", "--connect", "nonsense"]) == 2


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walk") / "walk.rrd"
    run(duration_s=0.5, record=path)
    return path


@pytest.fixture(scope="module")
def damaged(walk: Path) -> Path:
    return damage(walk)


def test_a_session_is_shown_without_what_is_damaged_and_names_it(
    damaged: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    name = session(3)
    lost, empty = (Path("runs", name, f"trial-00{index}.rrd") for index in (2, 3))
    lost.write_bytes(damaged.read_bytes())
    empty.write_bytes(b"")
    for named in (
        name,
        f"runs/{name}/overview.rrd",
        str(lost.resolve().with_name("overview.rrd")),
    ):
        assert exit_code(["view", named]) == 3
        assert opened() == [f"runs/{name}/overview.rrd"]
        table = table_of(Path(opened()[0]))
        assert "▶ 1" in table
        assert "▶ 2" not in table
        assert "▶ 3" not in table
        damage, emptied = capsys.readouterr().err.splitlines()
        assert damage.startswith(f"hexctl: recording: {lost} is damaged")
        assert emptied.startswith(f"hexctl: recording: {empty} is not a Rerun recording")


def test_an_old_overview_that_leads_to_damage_is_not_opened(
    damaged: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    name = session(2)
    old = Path("runs", name, "overview.rrd")
    assert exit_code(["view", name]) == 0
    Path("runs", name, "trial-002.rrd").write_bytes(damaged.read_bytes())
    write = session_viewing.write_overview

    def refused(*arguments: Any, **options: Any) -> Path:
        if options.get("into") is None:
            raise PermissionError(13, "Permission denied")
        return write(*arguments, **options)

    monkeypatch.setattr(session_viewing, "write_overview", refused)
    assert exit_code(["view", name]) == 3
    assert Path(opened()[0]).name == old.name
    assert opened() != [str(old)]


def test_ctrl_c_of_a_served_viewer_mentions_no_soft_stop(
    monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    def interrupted(*_: object, **__: object) -> None:
        with monkeypatch.context() as patch:
            patch.setattr(sys.stderr, "isatty", lambda: True)
            os.kill(os.getpid(), signal.SIGINT)

    monkeypatch.setattr(session_viewing, "serve_runs", interrupted)
    assert exit_code(["view", "--web"]) == 0
    said = capfd.readouterr().err
    assert ("Ctrl-C" in said, "soft stop" in said) == (True, False)


def test_a_session_is_served_without_what_is_damaged(damaged: Path, tmp_path: Path) -> None:
    name = session(2)
    Path("runs", name, "trial-001.rrd").write_bytes(damaged.read_bytes())
    runs = str(tmp_path / "runs")
    with program(tmp_path, "view", "hexctl", "view", "--web", name, HEXCTL_RUNS=runs) as viewer:
        assert "<html" in page_of(viewer).lower()
        assert "trial-001.rrd is damaged" in viewer.said()
        viewer.signal(signal.SIGINT)
        assert viewer.wait() == 3


@pytest.mark.parametrize("options", [(), ("--web",)])
def test_a_damaged_recording_is_named_before_anything_is_shown(
    options: tuple[str, ...], walk: Path, damaged: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(viewer, "viewer_binary", viewer_binary)
    assert exit_code(["view", str(walk), str(damaged), *options]) == 2
    told = capsys.readouterr().err
    assert told.startswith(f"hexctl: recording: {damaged} is damaged")
    assert told.count("\n") == 1
