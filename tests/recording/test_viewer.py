"""The viewer's program, what is served to it, and the live view: whole, and never a delay for the robot."""

import io
import os
import pickle
import signal
import subprocess
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from urllib.error import HTTPError
from urllib.parse import parse_qs, urlsplit
from urllib.request import Request, urlopen

import numpy as np
import pytest

from hexctl.backends.sim.servos import SimServos
from hexctl.columns import COLUMN_NAMES
from hexctl.control.guard import Guard
from hexctl.control.log import Recorder, TickLog
from hexctl.control.trial import run_trial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import TrialResult
from hexctl.errors import InputError, RecordingError
from hexctl.gait.gait import make_gait
from hexctl.recording import live as live_module
from hexctl.recording import live_feed, viewer
from hexctl.recording.live import LiveView, rows_of
from hexctl.recording.recording import Recording
from hexctl.recording.rrd import load_rerun
from hexctl.recording.viewer import FileServer, newest_recording, open_viewer, serve_web, web_page, web_url
from hexctl.robot.failure import Failure
from hexctl.runs.run import run
from hexctl.waiting import wait_for
from tests.control.posed import readings
from tests.robots import shipped
from tests.trials import Calling


def test_the_newest_recording_of_all_folders_is_found(tmp_path: Path) -> None:
    for age, name in enumerate(["a.rrd", "session/b.rrd", "c.txt"]):
        path = tmp_path / name
        path.parent.mkdir(exist_ok=True)
        path.touch()
        os.utime(path, (1000 + age, 1000 + age))
    assert newest_recording(tmp_path) == tmp_path / "session" / "b.rrd"
    for folder in ("", "missing"):
        with pytest.raises(InputError):
            newest_recording(tmp_path / "none" / folder)
    (tmp_path / "notes.rrd").write_text("hello")
    for name in ("gone.rrd", "notes.rrd"):
        with pytest.raises(InputError, match=name):
            open_viewer([tmp_path / name])


def stand_in(folder: Path, script: str, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Put a program in the viewer's place and return a file that looks like a recording."""
    program = folder / "viewer"
    program.write_text(f"#!/bin/sh\n{script}\n")
    program.chmod(0o755)
    monkeypatch.setattr(viewer, "viewer_binary", lambda: program)
    recording = folder / "trial.rrd"
    recording.write_bytes(b"RRF2")
    return recording


def test_the_viewer_gets_the_file_and_listens_to_this_machine_only(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = stand_in(tmp_path, f'echo "$@" > {tmp_path}/arguments', monkeypatch)
    assert open_viewer([recording]) == 0
    arguments = (tmp_path / "arguments").read_text().split()
    assert arguments[:2] == ["--bind", "127.0.0.1"]
    assert arguments[-1] == str(recording)


def test_a_browser_is_sent_to_the_dark_viewer_of_all_recordings(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    stand_in(tmp_path, "sleep 60", monkeypatch)
    urls = ["http://127.0.0.1:1/a session/1.rrd", "http://127.0.0.1:1/b.rrd?x=1&y=2"]
    with serve_web(9090, urls) as served:
        assert served.poll() is None
    page = web_page(9090, urls)
    assert page.startswith("http://127.0.0.1:9090/?")
    asked = parse_qs(urlsplit(page).query)
    assert asked == {"theme": ["dark"], "url": urls}
    live = parse_qs(urlsplit(web_url(1234, 9090)).query)
    assert live == {"theme": ["dark"], "url": ["rerun+http://127.0.0.1:1234/proxy"]}


@pytest.mark.parametrize(
    ("said", "told"),
    [
        (
            "Error: winit EventLoopError: neither WAYLAND_DISPLAY nor WAYLAND_SOCKET nor DISPLAY is set.",
            "--web",
        ),
        ("info\\nError: no GPU", "no GPU"),
    ],
)
def test_an_error_of_the_viewer_is_passed_on_in_one_line(
    said: str, told: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    recording = stand_in(tmp_path, f'printf "{said}\\n" >&2; exit 3', monkeypatch)
    with pytest.raises(RecordingError, match=told) as refusal:
        open_viewer([recording])
    assert "\n" not in str(refusal.value)


ORIGIN = "http://127.0.0.1:9090"


def status_of(url: str, method: str = "GET", **headers: str) -> int:
    """HTTP status of an answer."""
    try:
        with urlopen(Request(url, headers=headers, method=method)) as answer:  # noqa: S310  loopback
            return int(answer.status)
    except HTTPError as error:
        return error.code


def test_recordings_that_were_added_are_served_to_pages_of_the_viewer_and_nothing_else(
    tmp_path: Path,
) -> None:
    (tmp_path / "secret").touch()
    (tmp_path / "notes.rrd").write_text("hello")
    path = tmp_path / "ein großer 1%.rrd"
    for recording in (path, tmp_path / "other.rrd"):
        recording.write_bytes(b"RRF2" + recording.name.encode())
    with FileServer(ORIGIN) as server:
        url = server.add("a session", path)
        assert url.startswith("http://127.0.0.1:")
        assert url.startswith(server.base("a session"))
        with urlopen(url) as answer:  # noqa: S310  loopback
            assert answer.read() == path.read_bytes()
            assert answer.headers["Access-Control-Allow-Origin"] == ORIGIN
        for method in ("GET", "HEAD"):
            assert status_of(url, method) == 200
            for name in ("other.rrd", "../secret", "%2e%2e/secret", "", "/etc/passwd"):
                assert status_of(server.base("a session") + name, method) == 404
            assert status_of(url, method, Host="evil.example") == 403
        with pytest.raises(InputError, match=r"notes\.rrd"):
            server.add("here", tmp_path / "notes.rrd")
        path.unlink()
        assert status_of(url) == 404


PLAN = TrialPlan(gait=make_gait(shipped(), "tripod"), duration_s=3.0)

#: Has a row for each tick.
ROBOT = "world/robot"
TIMEOUT_S = 30.0
TICKS = 50 + 150 + 101


def walk(*recorders: Recorder | TickLog) -> TrialResult:
    with Guard(SimServos(shipped())) as servos:
        return run_trial(servos, PLAN, recorders=recorders)


@contextmanager
def viewing(saved: Path) -> Iterator[LiveView]:
    """Show walks to a viewer that needs no screen and saves what it is sent, until the block ends."""
    live = LiveView(options=("--save", str(saved)))
    try:
        yield live
    finally:
        live.close(leave_viewer=False)


def rows_at(path: Path, entity: str) -> int:
    """Number of rows of an entity in a recording; 0 while it cannot be read yet."""
    try:
        stream = load_rerun().chunk.RrdReader(path).stream()
        chunks = [chunk for chunk in stream if str(chunk.entity_path) == f"/{entity}"]
    except (OSError, RuntimeError, ValueError):
        return 0
    return sum(chunk.num_rows for chunk in chunks if not chunk.is_static)


@pytest.mark.realtime
def test_what_is_shown_is_the_whole_walk(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """The viewer's place is taken by one that saves what it is sent."""
    monkeypatch.setattr(live_module, "END_TIMEOUT_S", TIMEOUT_S)  # however slowly the feeder starts
    saved = tmp_path / "shown.rrd"
    with viewing(saved) as live:
        live.begin(shipped(), PLAN, title="walk")
        log = TickLog()
        assert walk(log, live).status == "ok"
        assert len(log) == TICKS
        live.close()
        assert live.lost is None
        wait_for(lambda: rows_at(saved, ROBOT) == TICKS, TIMEOUT_S, "the viewer did not save the walk")


@pytest.mark.realtime
@pytest.mark.parametrize(("who", "how"), [("viewer", signal.SIGKILL), ("feeder", signal.SIGSTOP)])
def test_a_viewer_that_dies_or_hangs_holds_nothing_up(tmp_path: Path, who: str, how: signal.Signals) -> None:
    with (
        viewing(tmp_path / "shown.rrd") as live,
        Recording(tmp_path / "walk.rrd", shipped(), PLAN, title="walk") as recording,
    ):
        live.begin(shipped(), PLAN, title="walk")
        process = live._viewer if who == "viewer" else live._feeder

        def break_it(_: TickLog, start: int, stop: int) -> None:
            if start <= 100 < stop:
                process.send_signal(how)

        log = TickLog()
        with warnings.catch_warnings():
            warnings.simplefilter("error")  # a recorder that fails is a warning
            result = walk(log, recording, live, Calling(break_it, block_ticks=live.block_ticks))
        assert result.status == "ok"
        assert len(log) == TICKS
        recording.finish(result, {})
        live.close(leave_viewer=False)
    assert rows_at(tmp_path / "walk.rrd", ROBOT) == TICKS
    assert not live.open


@pytest.mark.realtime
def test_what_a_slow_viewer_leaves_waiting_is_bounded(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(live_module, "MAX_WAITING_BYTES", 100_000)
    with viewing(tmp_path / "shown.rrd") as live:
        live._feeder.send_signal(signal.SIGSTOP)
        live.begin(shipped(), PLAN, title="walk")
        walk(live)
        assert live.lost is not None
        assert "too slow" in live.lost
        live.close(leave_viewer=False)


def test_what_is_sent_arrives_up_to_where_it_was_cut_off() -> None:
    sent = [{"rows": {"time_s": np.arange(3.0)}}, {"title": "walk"}]
    stream = b"".join(pickle.dumps(message, protocol=5) for message in sent)
    for missing in (0, 1, 20):
        arrived = list(live_feed.messages(io.BytesIO(stream[: len(stream) - missing])))
        assert len(arrived) == (2 if missing == 0 else 1)
        np.testing.assert_array_equal(arrived[0]["rows"]["time_s"], np.arange(3.0))


def test_rows_that_cross_the_pipe_are_the_rows_of_the_log() -> None:
    log = run(gait="tripod", duration_s=3.5, failure="2:limp@2.5", recovery="glide", record=False).log
    other = TickLog()
    for start in range(0, len(log), 7):
        sent = pickle.dumps(rows_of(log, start, min(start + 7, len(log))))
        live_feed.append(other, pickle.loads(sent))  # noqa: S301  our own
    assert len(other) == len(log)
    assert (other.walked_ticks, other.walk_from) == (log.walked_ticks, log.walk_from)
    assert [text for _, text in log.notes if text.startswith("noticed: leg 2")]
    assert other.notes == log.notes
    assert other.leg_changes == log.leg_changes
    for name in COLUMN_NAMES:
        np.testing.assert_array_equal(other[name], log[name])


def test_events_of_a_log_that_began_before_the_feeder_are_at_their_rows() -> None:
    log, other = TickLog(), TickLog()
    first = run(gait="tripod", duration_s=0.2, record=False).log
    log.extend({name: first[name] for name in COLUMN_NAMES})
    start = len(log)
    log.note(["an event"])
    log.note_failures("world", (Failure(leg=5),))
    log.servo_rows.append(start, readings(temperatures_c=np.full(18, 30.0)))
    log.extend({name: first[name] for name in COLUMN_NAMES})
    live_feed.append(other, rows_of(log, start, len(log)))
    assert other.notes == [(0, "an event")]
    assert [change.row for change in other.leg_changes] == [0]
    assert [row for row, _ in other.servo_rows.between(0, len(other))] == [0]


@pytest.mark.slow
def test_a_feeder_without_a_viewer_ends_by_itself() -> None:
    command = [sys.executable, "-c", SHORT_PATIENCE]
    done = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, timeout=60, check=False)
    assert (done.returncode, done.stderr) == (1, b"")


SHORT_PATIENCE = """
from hexctl.recording import live_feed
live_feed.VIEWER_TIMEOUT_S = 0.3
live_feed.main("9")
"""
