"""`hexctl view` and `export`: sessions and recordings in a stand-in for the viewer, in browsers, in files."""

import os
import re
import shutil
import signal
import urllib.request
from dataclasses import replace
from pathlib import Path

import pytest

from faults.injection import LongestWait
from faults.measurement import MOST_WAIT_S
from hexctl.adapt.sessions.store import SessionStore
from hexctl.cli.main import exit_code
from hexctl.recording import viewer
from hexctl.recording.viewer import viewer_binary
from hexctl.runs.run import run
from tests.adapt.walking import SPEC, record
from tests.cli.conftest import Call
from tests.recording.made_up import damaged_recordings
from tests.server.processes import TIMEOUT_S, Program, controlling, hexctl, program, served, wait_until


@pytest.fixture(autouse=True)
def _noting_viewer(tmp_path_factory: pytest.TempPathFactory, monkeypatch: pytest.MonkeyPatch) -> None:
    """Replace the viewer by one that notes what it is to open."""
    program = tmp_path_factory.mktemp("bin") / "viewer"
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
        path = store.folder_of(made.name) / f"trial-{index:03d}.rrd"
        if index not in missing:
            recording(path, age_s)
        store.add(made, replace(record(index, 0.1 * index), recording=str(path)), {})
    return made.name


def table_of(overview: Path) -> str:
    """The table of an overview, with its links."""
    import rerun as rr

    chunks = rr.chunk.RrdReader(overview).stream().to_chunks()
    (table,) = [chunk.to_record_batch() for chunk in chunks if chunk.entity_path == "/table"]
    text: str = table.column("TextDocument:text").to_pylist()[0][0]
    return text


def test_a_damaged_trial_is_named_by_every_command_with_one_exit_code(
    call: Call, caplog: pytest.LogCaptureFixture
) -> None:
    name, other = session(3), session(2)
    path = Path("runs", name, "session.jsonl")
    lines = path.read_text().splitlines()
    path.write_text("\n".join([*lines[:2], "broken", *lines[3:], ""]))
    shown = ["list"], ["show", name], ["compare", name, other]
    for command in (*[["sessions", *words] for words in shown], ["export", name, "--to", "csv"]):
        assert call(*command, code=3).line.startswith(
            f"hexctl: session {name}: damaged at line 3 of session.jsonl"
        )
    exit_code(["adapt", "--resume", name, "--budget", "3"])
    assert [record.getMessage().count("line 3") for record in caplog.records] == [1]


@pytest.mark.slow
def test_without_a_name_the_newest_is_opened_session_or_recording(call: Call) -> None:
    older, newer = session(1, age_s=30), session(1, age_s=20)
    call("view")
    assert opened()[0] == f"runs/{newer}/overview.rrd"
    call("view", older)
    call("view")
    assert opened()[0] == f"runs/{newer}/overview.rrd"
    recording(Path("runs/walk.rrd"), 10)
    call("view")
    assert opened() == ["runs/walk.rrd"]


@pytest.mark.parametrize("name", ["nobody", "runs", "gone.rrd", "a-file"])
def test_what_cannot_be_opened_is_said_in_one_line(name: str, call: Call) -> None:
    known = session(1)
    Path("a-file").touch()
    refusal = call("view", name, code=2).refusal
    assert name in refusal
    assert (known in refusal) == (name in ("nobody", "runs"))
    assert not Path("opened").exists()


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


#: How often a robot is watched again where the machine kept its commands waiting.
ATTEMPTS = 4


@pytest.mark.realtime
def test_a_robot_is_watched_while_another_commands_it(tmp_path: Path) -> None:
    with served(tmp_path) as robot:
        for attempt in range(ATTEMPTS):
            with (
                LongestWait() as wait,
                controlling(tmp_path, robot.endpoint, name=f"controller{attempt}") as controller,
                program(tmp_path, "view", "hexctl", "view", "--web", "--connect", robot.endpoint) as viewer,
            ):
                controller.wait_for("moving")
                assert "<html" in page_of(viewer).lower()
                assert robot.status()["leases_refused"] == 0
                viewer.signal(signal.SIGINT)
                assert viewer.wait() == 0
                ended = controller.process.poll() is not None
            if not ended or wait.longest_s < MOST_WAIT_S:
                break
        assert not ended, controller.said()


@pytest.mark.realtime
def test_without_a_screen_a_live_view_says_so_and_the_walk_goes_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    walked = hexctl("run", "--realtime", "--view", "--duration", "0.5", "--record", str(tmp_path / "a.rrd"))
    assert walked.returncode == 0, walked.stderr
    assert walked.stderr.count("display") == 1
    with served(tmp_path, backend="mock") as robot:
        watched = hexctl("view", "--connect", robot.endpoint)
    assert watched.returncode == 3
    assert "hexctl view --web" in watched.stderr


@pytest.fixture(scope="module")
def walk(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("walk") / "walk.rrd"
    run(duration_s=0.5, record=path)
    return path


@pytest.mark.slow
@pytest.mark.parametrize("web", [(), ("--web",)])
def test_a_damaged_recording_is_named_before_anything_is_shown(
    walk: Path, tmp_path: Path, call: Call, monkeypatch: pytest.MonkeyPatch, web: tuple[str, ...]
) -> None:
    damaged = tmp_path / "damaged.rrd"
    damaged.write_bytes(damaged_recordings()[0])
    monkeypatch.setattr(viewer, "viewer_binary", viewer_binary)
    refusal = call("view", *web, str(walk), str(damaged), code=2).refusal
    assert refusal.startswith(f"hexctl: recording: {damaged} is damaged")


@pytest.mark.slow
def test_a_session_opens_as_its_overview_with_a_link_to_each_trial_that_has_a_recording(call: Call) -> None:
    name = session(3, missing=(2,))
    stale = Path("runs", name, "overview.rrd")
    stale.write_bytes(b"RRF2")
    for typed in (name, f"runs/{name}/"):
        call("view", typed)
        assert opened() == [f"runs/{name}/overview.rrd"]
    table = table_of(Path(opened()[0]))
    for index in (1, 3):
        assert f"[▶ {index}]({Path.cwd().as_uri()}/runs/{name}/trial-00{index}.rrd)" in table
    assert "▶ 2" not in table


@pytest.mark.slow
def test_walks_open_with_sessions(call: Call, walk: Path) -> None:
    for name in ("a.rrd", "b.rrd"):
        shutil.copy(walk, name)
    call("view a.rrd b.rrd")
    assert [Path(path).name for path in opened()] == ["a.rrd", "b.rrd"]
    name = session(1)
    call("view a.rrd", name)
    assert [Path(path).name for path in opened()] == ["a.rrd", "overview.rrd"]


def test_without_sessions_and_trials_there_is_nothing_to_view(call: Call) -> None:
    call("view", code=2)
    assert not Path("runs").exists()
    name = session(0)
    assert f"adapt --resume {name}" in call("view", name, code=2).err


@pytest.mark.slow
def test_it_prints_where_the_output_lies(walk: Path, call: Call) -> None:
    for arguments, path in (
        (["ant", "--to", "urdf"], "ant.urdf"),
        (["ant", "--ros2-control", "-o", "a.urdf"], "a.urdf"),
        ([str(walk), "-o", "table.csv"], "table.csv"),
        ([str(walk), "-o", "walk.mcap"], "walk.mcap"),
    ):
        said = call("export", *arguments)
        assert said.out == f"{path}\n"
        assert ("not measured, which the new file does not show: servo" in said.err) == ("ant" in arguments)
        assert Path(path).stat().st_size > 1000
    assert "ros2_control" in Path("a.urdf").read_text()
