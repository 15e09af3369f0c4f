"""`hexctl view --web` and `--connect`: served to a browser, and watching a robot without commanding it."""

import re
import signal
import urllib.request
from pathlib import Path

from hexctl.cli.main import exit_code
from tests.serve.processes import PATIENCE_S, Program, controlling, hexctl, program, served, wait_until


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


def test_bad_input() -> None:
    assert exit_code(["view", "--keys", "x"]) == 2
    assert exit_code(["view", "a.rrd", "--connect", "tcp/127.0.0.1:1"]) == 2
    assert exit_code(["view", "--connect", "nonsense"]) == 2
