"""`hexctl serve` and `status`: what they print, and how they end."""

import json
import signal
import socket
import subprocess
import sys
from contextlib import nullcontext
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
from rich.console import Console

from hexctl.backends.mock import MockServos
from hexctl.cli.network.status_command import status_rows, status_table
from hexctl.server.serve_options import ServedOptions
from hexctl.wire.certificates import make_certificates
from hexctl.wire.links import CLEAR_COMMAND, Link
from tests.cli.conftest import Call
from tests.server.processes import RECORDED, free_port, hexctl, program, served


@pytest.mark.realtime
def test_a_view_without_a_viewers_certificate_is_refused_before_anything_is_served(
    tmp_path: Path, call: Call
) -> None:
    make_certificates(tmp_path / "keys", hosts=["localhost"], days=1)
    keys, endpoint = str(tmp_path / "keys" / "robot"), f"tls/127.0.0.1:{free_port()}"
    assert call("serve --backend mock --view --listen", endpoint, "--keys", keys, code=2).line


@pytest.mark.realtime
def test_an_address_that_is_taken_is_said_in_one_line(call: Call) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        endpoint = f"tcp/127.0.0.1:{taken.getsockname()[1]}"
        assert endpoint in call("serve --backend mock --listen", endpoint, code=3).line


@pytest.mark.realtime
@pytest.mark.parametrize("method", ["connect", "read"])
def test_own_servos_that_raise_end_it_as_a_fault_in_one_line(
    method: str, monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    def broken(*_: object) -> None:
        raise ZeroDivisionError("no such register")

    class Driver(MockServos):
        pass

    setattr(Driver, method, broken)
    monkeypatch.setattr("tests.server.recorded.RecordedServos", Driver)
    endpoint = f"tcp/127.0.0.1:{free_port()}"
    (*_, line) = call("serve --backend", RECORDED, "--listen", endpoint, code=3).err.splitlines()
    assert f"Driver.{method} raised ZeroDivisionError: no such register" in line


#: A robot and a board that end at once, in a process in which real-time priority may be granted.
ENDS = """
import os, sys
from hexctl.server.service import RobotService
from hexctl.simulators.board_service import BoardService

def has_priority():
    return os.sched_getscheduler(0) & ~os.SCHED_RESET_ON_FORK == os.SCHED_FIFO

for service in RobotService(backend="mock", listen=sys.argv[1]), BoardService(backend="mock", bus="pca9685"):
    during = []
    service.run(lambda: bool(during), on_started=lambda told: during.append((told.realtime, has_priority())))
    ((granted, held),) = during
    assert held is granted
    assert not has_priority()
"""


@pytest.mark.realtime
def test_real_time_priority_ends_with_the_loop() -> None:
    """A process that ends would keep others from a processor for a fifth of a second."""
    subprocess.run([sys.executable, "-c", ENDS, f"tcp/127.0.0.1:{free_port()}"], check=True)


@pytest.mark.realtime
@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGUSR1])
def test_it_ends_softly_when_asked(tmp_path: Path, number: signal.Signals) -> None:
    with served(tmp_path, backend="mock") as robot:
        assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
        robot.wait_for("STOPPED: estop")
        robot.signal(number)
        assert robot.wait() == 0
        assert "Traceback" not in robot.said()


@pytest.mark.realtime
@pytest.mark.parametrize("json_option", [(), ("--json",)])
def test_a_stop_whose_fault_is_still_there_is_not_cleared(
    json_option: tuple[str, ...], monkeypatch: pytest.MonkeyPatch, call: Call
) -> None:
    answer = {"stopped": "fault: no power", "robot": "ant", "backend": "mock"}
    robots = SimpleNamespace(clear=lambda **_: [answer], link=Link())
    monkeypatch.setattr("hexctl.client.remote.remote_robots", lambda *_, **__: nullcontext(robots))
    printed = call("estop --clear", *json_option, code=3).out
    assert "fault: no power" in printed
    assert ("not cleared, it is still stopped" in printed) is not bool(json_option)


@pytest.mark.realtime
def test_a_walk_over_the_link_says_what_a_walk_in_process_says(tmp_path: Path) -> None:
    options = ("--gait", "tripod", "--duration", "2", "--json", "--no-record")
    with served(tmp_path, backend="sim") as robot:
        far = hexctl("run", "--backend", "zenoh", "--connect", robot.endpoint, *options)
        assert far.returncode == 0, far.stderr
    there, here = json.loads(far.stdout), json.loads(hexctl("run", *options).stdout)
    assert there.keys() == here.keys()
    assert there["status"] == here["status"] == "ok"
    assert there["distance_m"] == pytest.approx(here["distance_m"], abs=0.05)
    # Grid points that a busy machine skipped are counted, not lost.
    assert there["ticks"] + there["overruns"] == pytest.approx(here["ticks"], abs=3)


@pytest.mark.realtime
def test_with_certificates_controllers_command_and_viewers_look(tmp_path: Path) -> None:
    keys = tmp_path / "keys"
    assert hexctl("keys", "new", str(keys)).returncode == 0
    endpoint = f"tls/127.0.0.1:{free_port()}"
    serve = ("serve", "--backend", "mock", "--listen", endpoint, "--keys", str(keys))
    with program(tmp_path, "robot", "hexctl", *serve) as robot:
        robot.wait_for("certificates")
        here = ("--connect", endpoint, "--keys")
        walk = ("run", "--backend", "zenoh", "--no-record", "--duration", "0.5", "--json")
        assert hexctl(*walk, *here, str(keys)).returncode == 0
        status = hexctl("status", "--json", *here, str(keys / "viewer"))
        assert json.loads(status.stdout)["secured"] is True
        lines = hexctl("status", *here, str(keys / "viewer")).stdout.splitlines()
        assert ["controller", "none"] in [line.split() for line in lines]
        assert max(map(len, lines)) > 80, "in a pipe no line is wrapped"
        assert lines == [line.rstrip() for line in lines]
        for command in (walk, ("estop",)):
            refused = hexctl(*command, *here, str(keys / "viewer"))
            assert refused.returncode == 2
            assert "'viewer'" in refused.stderr
        assert hexctl("estop", *here, str(keys / "controller")).returncode == 0
        stranger = hexctl("status", "--connect", endpoint.replace("tls", "tcp"))
        assert stranger.returncode == 3
        assert "--keys" in stranger.stderr


CALM: dict[str, Any] = {
    "robot": "ant",
    "backend": "sim",
    "host": "lab-pc",
    "user": "mia",
    "pid": 12,
    "simulated": {"world": "rough", "failure": "leg 5 locked"},
    "stopped": None,
    "posture": "idle",
    "controller": None,
    "controller_since_s": None,
    "leases_refused": 0,
    "commands": {"accepted": 7, "refused": 0, "late": 0},
    "clipped": 2,
    "malformed": {"requests": 0, "poses": 0},
    "ticks": 100,
    "overruns": 0,
    "joints": "measured",
    "pose": True,
    "state_age_s": 0.0021,
    "fault": None,
    "battery_v": None,
    "battery_share": None,
    "endpoint": "tcp/127.0.0.1:7447",
    "secured": False,
    "insecure": False,
}


FELL = {"stopped": "fell"}
STOP = {"id": "00ff", "since_s": 1.5, "kept": True}
CLEARED = {**STOP, "reason": "fell", "by": "mia"}
COMMANDS = {"accepted": 7}
NO_ROUTER = {"connected": False, "drive": False}

ROS = {
    "router": "tcp/localhost:7447",
    "connected": True,
    "drive": True,
    "commands": 7,
    "malformed": 2,
    "trouble": "no ROS router",
}

SERVOS = {
    **dict.fromkeys(("ages_s", "efforts", "currents_a"), [None] * 18),
    "temperatures_c": [40.0] * 4 + [61.2] + [40.0] * 13,
    "voltages_v": [12.0] * 17 + [11.5],
    "errors": [""] * 18,
}


def test_what_robots_and_controllers_call_themselves_is_shown_as_it_is() -> None:
    odd = {
        **CALM,
        "controller": "lab[/red]",
        "controller_since_s": 1.0,
        "fault": "the board reports: [/E12]",
        "endpoint": "tcp/[fe80::1]:7447",
        "simulated": True,
    }
    console = Console(width=100)
    with console.capture() as shown:
        console.print(status_table([{}, CALM, odd], CLEAR_COMMAND))
    for text in ("ant (sim), world rough", "lab[/red], for 1.0 s", "[/E12]", "tcp/[fe80::1]:7447"):
        assert text in shown.get()


def test_what_is_told_in_another_way_costs_no_other_line() -> None:
    odd = {
        **CALM,
        "stopped": {"id": 5},
        "commands": "many",
        "battery_v": "full",
        "ros": "yes",
        "malformed": 3,
    }
    rows = dict(status_rows(odd, CLEAR_COMMAND))
    assert len({rows[name] for name in ("stopped", "commands", "battery", "ROS", "dropped")}) == 1
    assert rows["robot"] == dict(status_rows(CALM, CLEAR_COMMAND))["robot"]


@pytest.mark.parametrize(
    ("changed", "row", "shown"),
    [
        ({}, "stopped", "no"),
        ({}, "served by", "mia on lab-pc, process 12"),
        ({}, "robot", "ant (sim), world rough, failure leg 5 locked"),
        (FELL, "stopped", "FELL: its body leant too far; hexctl estop --clear clears it"),
        ({"stopped": "fault: low", "fault": "low"}, "stopped", "FAULT: low; remove the cause, then"),
        ({"stopped": "fault: gone", "servos": SERVOS}, "stopped", "FAULT: gone; they answer again: hexctl"),
        ({"stopped": "fault: low"}, "stopped", "FAULT: low; the fault is over: hexctl estop --clear"),
        ({"stopped": "expired"}, "stopped", "EXPIRED: no command came in time; the next controller clears"),
        ({**FELL, "stop": {**STOP, "kept": False}}, "stopped", "FELL: its body leant too far (00ff"),
        ({**FELL, "stop": {**STOP, "by": "m"}}, "stopped", "FELL: its body leant too far (00ff, 1.5"),
        ({"cleared": CLEARED}, "stopped", "no (fell was cleared by mia, 1.5 s"),
        ({"servos": SERVOS}, "servos", "up to 61 C (leg2_femur), 11.5 to 12.0 V"),
        ({"commands": {**COMMANDS, "late": 2, "stale_owner": 1}}, "commands", "7 executed; 2 late, 1 stale"),
        ({"malformed": {"requests": 1}, "leases_refused": 2}, "dropped", "1 request, 2 leases refused"),
        ({"ticks": 1, "overruns": 1}, "loop", "1 tick of 20 ms, 1 skipped"),
        ({"insecure": True}, "link", "tcp/127.0.0.1:7447, INSECURE"),
        ({"servo_link": {"received": 90, "lost": 2}}, "servo link", "90 messages came; 2 lost"),
        ({"ros": ROS}, "ROS", "router tcp/localhost:7447; 7 commands, 2 malformed"),
        ({"ros": {**ROS, **NO_ROUTER}}, "ROS", "no ROS router; ROS may stop the robot"),
    ],
    ids=str,
)
def test_what_a_person_must_see(changed: dict[str, Any], row: str, shown: str) -> None:
    assert dict(status_rows({**CALM, **changed}, CLEAR_COMMAND))[row].startswith(shown)


def test_a_calm_robot_has_no_rows_of_troubles_and_a_stop_is_cleared_by_the_command_that_is_given() -> None:
    assert not {"fault", "dropped", "servo link", "ROS"} & dict(status_rows(CALM, CLEAR_COMMAND)).keys()
    there = "hexctl estop --clear --connect tcp/127.0.0.1:7448"
    assert there in dict(status_rows({"stopped": "estop"}, there))["stopped"]


def test_only_a_simulation_tells_of_its_world() -> None:
    assert ServedOptions(backend="mock").simulated is None
    failed = {"world": "flat", "failure": "leg 2 locked"}
    assert ServedOptions(backend="sim", failed_leg=2).simulated == failed
