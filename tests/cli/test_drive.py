"""`hexctl drive` as a process on a pseudo-terminal: keys, Ctrl-C, a terminal that goes, and the page."""

import json
import re
import signal
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from websockets.sync.client import connect
from websockets.sync.connection import Connection
from websockets.typing import Origin, Subprotocol

from hexctl.backends.zenoh.zenoh_client import ZenohServos
from hexctl.cli.walk.drive_command import _why
from hexctl.control.drive.drive import Drive
from hexctl.recording.recorded_trial import LEG_CONDITIONS, read_trial
from hexctl.waiting import wait_for
from hexctl.wire.links import Link
from tests.cli.conftest import Call
from tests.cli.terminals import WAIT_S, OnTerminal
from tests.recording.conftest import ReadBack
from tests.server.processes import hexctl, served


@pytest.mark.realtime
def test_keys_drive_until_q_and_the_drive_is_recorded(tmp_path: Path) -> None:
    with OnTerminal(tmp_path, "--record", "drive.rrd", "--gamepad", "none") as terminal:
        terminal.wait("w s or arrows")
        terminal.wait("tripod · driving")
        terminal.type("ww")
        terminal.wait(r"forward \+0\.071 .* keyboard")
        terminal.wait(r"\d\.\d m at \d\.\d\d m/s, yaw .*keyboard")
        terminal.type("g")
        terminal.wait("wave · driving")
        terminal.type(" ")
        terminal.wait(r"forward \+0\.000.*wave · driving")
        terminal.type("q")
        shown = terminal.wait("recorded in drive.rrd; look at it with: hexctl view drive.rrd")
        assert re.search(r"ended; the robot stands\s+hexctl: recorded in", shown)  # no status behind it
        assert terminal.code() == 0
    assert (tmp_path / "drive.rrd").stat().st_size > 10_000


@pytest.mark.realtime
def test_ctrl_c_ends_at_a_stand(tmp_path: Path) -> None:
    with OnTerminal(tmp_path) as terminal:
        terminal.wait("tripod · driving")
        terminal.type("www")
        terminal.wait(r"forward \+0\.1")
        terminal.process.send_signal(signal.SIGINT)
        terminal.wait("interrupted; the robot stands")
        assert terminal.code() == 130


@pytest.mark.realtime
def test_a_terminal_that_goes_ends_at_a_stand_with_a_whole_recording(tmp_path: Path) -> None:
    record = tmp_path / "drive.rrd"
    with OnTerminal(tmp_path, "--record", str(record), "--gait", "wave", "--failed-leg", "4") as terminal:
        terminal.wait("· driving")
        terminal.type("www")
        terminal.wait(r"forward \+0\.0[1-9]|forward \+0\.[1-9]")
        terminal.close()
        assert terminal.code() == 0
    (panel,) = ReadBack(record).values("/summary", "TextDocument:text")[-1]
    assert "| failed leg | 4 (locked)" in panel
    failed = LEG_CONDITIONS.index("failed")
    assert (read_trial(record).leg_conditions == [0, 0, 0, failed, 0, 0]).all()


@pytest.mark.realtime
def test_a_stop_of_the_page_is_latched_at_a_served_robot_until_a_person_clears_it(tmp_path: Path) -> None:
    with served(tmp_path, backend="sim") as robot:
        link = ("--backend", "zenoh", "--connect", robot.endpoint)
        with OnTerminal(tmp_path, "--page", "127.0.0.1:0", "--no-keyboard", *link) as terminal:
            port = re.search(r"127\.0\.0\.1:(\d+)/\s", terminal.wait(r"drive on http://127\.0\.0\.1:\d+/\s"))
            assert port is not None
            with paged(port[1]) as page:

                def status(**wanted: object) -> dict[str, Any]:
                    said: dict[str, Any] = {}
                    while any(said.get(name, "") != value for name, value in wanted.items()):
                        said = json.loads(page.recv(timeout=WAIT_S))
                    return said

                status(mode="driving")

                def drives() -> bool:
                    page.send(json.dumps({"v": [0.5, 0, 0]}))
                    return bool(json.loads(page.recv(timeout=WAIT_S)).get("source") == "page")

                wait_for(drives, WAIT_S, "the page does not drive")
                page.send(json.dumps({"do": "stop"}))
                clear = status(stopped="estop")["clear"]
                assert clear == f"hexctl estop --clear --connect {robot.endpoint}"
                stop = robot.status()["stop"]
                assert len(stop["claims"]) == 1

                def stand_refused() -> bool:
                    page.send(json.dumps({"do": "stand"}))
                    return "estop --clear" in json.loads(page.recv(timeout=WAIT_S)).get("said", "")

                wait_for(stand_refused, WAIT_S, "the robot stands again")
                walk = hexctl("run", "--no-record", "--duration", "0.1", *link)
                assert walk.returncode != 0
                assert "estop --clear" in walk.stderr
                assert robot.status()["stop"]["id"] == stop["id"]

                assert hexctl("estop", "--clear", "--connect", robot.endpoint).returncode == 0
                page.send(json.dumps({"do": "stand"}))
                assert status(stopped=None)["clear"] is None
                status(mode="driving")
                page.send(json.dumps({"do": "stop"}))
                status(stopped="estop")
                page.send(json.dumps({"do": "quit"}))
            assert terminal.code() == 4
        assert robot.status()["stopped"] == "estop"


@contextmanager
def paged(port: str) -> Iterator[Connection]:
    own = f"127.0.0.1:{port}"
    with connect(
        f"ws://{own}/drive", origin=Origin(f"http://{own}"), subprotocols=[Subprotocol("hexctl.drive.1")]
    ) as page:
        yield page


@pytest.mark.realtime
def test_where_nothing_was_driven_there_is_no_recording(call: Call) -> None:
    call("drive --page 127.0.0.1:0 --record drive.rrd --gait trot", code=2)
    call("drive --page 127.0.0.1:0 --record drive.rrd --backend zenoh --connect tcp/127.0.0.1:1", code=3)
    assert not Path("drive.rrd").exists()


@pytest.mark.realtime
def test_the_command_that_ends_a_stop_leads_to_the_robot_that_was_driven() -> None:
    there = Drive(servos=ZenohServos("ant", link=Link(endpoint="tcp/127.0.0.1:7448")))
    assert _why(there, "estop").endswith(
        "hexctl estop --clear --connect tcp/127.0.0.1:7448 when it may move again"
    )
    assert "--clear" not in _why(Drive("ant"), "estop"), "no server keeps the stop of a simulation"
