"""Stops of a driver at a served robot: latched for all clients, with one claim however often pressed."""

from pathlib import Path
from typing import Any

from hexctl.client.stop_sender import StopSender
from hexctl.waiting import wait_for
from hexctl.wire.links import Link
from tests.server.processes import hexctl, served

WAIT_S = 30.0


def test_stops_in_a_row_have_one_claim_and_one_after_a_clear_has_another(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot, StopSender(Link(endpoint=robot.endpoint)) as sender:

        def stop() -> dict[str, Any] | None:
            sender.press()
            stopped: dict[str, Any] | None = robot.status()["stop"]
            return stopped

        first = wait_for(stop, WAIT_S, "the robot is not stopped")
        for _ in range(20):
            again = stop()
        assert again is not None
        assert again["claims"] == first["claims"]
        assert len(first["claims"]) == 1
        assert sender.trouble is None
        assert hexctl("estop", "--clear", "--connect", robot.endpoint).returncode == 0
        assert robot.status()["stop"] is None
        after = wait_for(stop, WAIT_S, "the robot is not stopped again")
        wait_for(lambda: robot.status()["stop"]["claims"], WAIT_S, "the stop is not claimed")
        assert after["id"] != first["id"]


def test_a_stop_that_reaches_no_robot_says_so() -> None:
    with StopSender(Link(endpoint="tcp/127.0.0.1:1")) as sender:
        sender.press()
        trouble = wait_for(lambda: sender.trouble, WAIT_S, "nothing is said")
    assert "127.0.0.1:1" in trouble
