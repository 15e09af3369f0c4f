"""`hexctl view --web` and `--connect`: served to a browser, and watching a robot without commanding it."""

import re
import signal
import urllib.request
from pathlib import Path
from typing import Any

import pytest

from hexctl.cli.main import exit_code
from hexctl.control.log import TickLog
from hexctl.record import live
from tests.serve.processes import (
    PATIENCE_S,
    Program,
    controlling,
    hexctl,
    program,
    served,
    wait_until,
)


def page_of(viewer: Program) -> str:
    """Return what a browser gets at the address that a viewer prints."""
    viewer.wait_for("in a browser")
    match = re.search(r"http://127\.0\.0\.1:\d+/", viewer.said())
    assert match is not None

    def fetched() -> str:
        try:
            with urllib.request.urlopen(match[0], timeout=PATIENCE_S) as answer:  # noqa: S310  loopback
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
