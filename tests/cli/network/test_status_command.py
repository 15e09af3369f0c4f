"""What `hexctl status` shows of robots in several troubles, and of one that is served."""

from pathlib import Path
from typing import Any

import pytest
from rich.console import Console

from hexctl.cli.network.status_command import status_rows, status_table
from hexctl.server.serve_options import ServedOptions
from hexctl.wire.links import CLEAR_COMMAND
from tests.server.processes import hexctl, served

pytestmark = pytest.mark.realtime

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


SERVOS = {
    **dict.fromkeys(("ages_s", "efforts", "currents_a"), [None] * 18),
    "temperatures_c": [40.0] * 4 + [61.2] + [40.0] * 13,
    "voltages_v": [12.0] * 17 + [11.5],
    "errors": [""] * 18,
}


def test_a_calm_robot() -> None:
    assert dict(status_rows(CALM, CLEAR_COMMAND)) == {
        "robot": "ant (sim), world rough, failure leg 5 locked",
        "served by": "mia on lab-pc, process 12",
        "stopped": "no",
        "posture": "waiting for a command",
        "controller": "none",
        "battery": "does not say",
        "joints": "measured, 2 ms old",
        "position": "known",
        "commands": "7 executed; none dropped",
        "guard": "2 targets limited to what the joints can do, by the robot's own guard, behind the "
        "controller's",
        "loop": "100 ticks of 20 ms, 0 skipped",
        "link": "tcp/127.0.0.1:7447, no certificates",
    }


@pytest.mark.parametrize(
    ("changed", "row", "shown"),
    [
        ({"stopped": "fell"}, "stopped", "FELL: its body leant too far; hexctl estop --clear clears it"),
        (
            {"stopped": "fault: low battery 9.5 V", "fault": "low battery 9.5 V"},
            "stopped",
            "FAULT: low battery 9.5 V; see to it, then hexctl estop --clear",
        ),
        (
            {"host": "lab-pc", "user": "alice", "pid": 4711},
            "served by",
            "alice on lab-pc, process 4711",
        ),
        (
            {"stopped": "fault: the port has gone", "servos": SERVOS},
            "stopped",
            "FAULT: the port has gone; they answer again: hexctl estop --clear",
        ),
        (
            {"stopped": "fault: low battery 9.5 V"},
            "stopped",
            "FAULT: low battery 9.5 V; that is over: hexctl estop --clear",
        ),
        (
            {"stopped": "expired"},
            "stopped",
            "EXPIRED: no command came in time; the next controller clears it",
        ),
        (
            {"stopped": "expired", "stop": {"id": "00ff", "since_s": 1.5, "kept": False}},
            "stopped",
            "EXPIRED: no command came in time (00ff, 1.5 s ago); the next controller clears it",
        ),
        (
            {"stopped": "fell", "stop": {"id": "00ff", "since_s": 1.5, "kept": False}},
            "stopped",
            "FELL: its body leant too far (00ff, 1.5 s ago, not kept); hexctl estop --clear clears it",
        ),
        (
            {"stopped": "fell", "stop": {"id": "00ff", "since_s": 1.5, "kept": True, "by": "m"}},
            "stopped",
            "FELL: its body leant too far (00ff, 1.5 s ago, asked for by m); hexctl estop --clear clears it",
        ),
        (
            {"stopped": None, "cleared": {"id": "00ff", "reason": "fell", "by": "mia", "since_s": 2.5}},
            "stopped",
            "no (fell was cleared by mia, 2.5 s ago)",
        ),
        ({"controller": "lab", "controller_since_s": 3.5}, "controller", "lab, for 3.5 s"),
        ({"battery_v": 11.13, "battery_share": 0.4}, "battery", "11.1 V, 40%"),
        ({"servos": SERVOS}, "servos", "up to 61 C (leg2_femur), 11.5 to 12.0 V"),
        ({"servos": {**SERVOS, "temperatures_c": [None] * 18}}, "servos", "11.5 to 12.0 V"),
        ({"fault": "low battery"}, "fault", "low battery"),
        ({"joints": None}, "joints", "no state received yet"),
        (
            {"joints": "echoed", "state_age_s": None},
            "joints",
            "echoed targets, not measured",
        ),
        ({"pose": False}, "position", "not known, so no trial can be scored"),
        (
            {"commands": {"accepted": 7, "late": 2, "stale_owner": 1}},
            "commands",
            "7 executed; 2 late, 1 stale owner",
        ),
        (
            {"malformed": {"requests": 4, "poses": 0}, "leases_refused": 1},
            "dropped",
            "4 requests, 1 lease refused",
        ),
        ({"malformed": {"requests": 1}, "leases_refused": 2}, "dropped", "1 request, 2 leases refused"),
        ({"ticks": 1, "overruns": 1}, "loop", "1 tick of 20 ms, 1 skipped"),
        (
            {"insecure": True},
            "link",
            "tcp/127.0.0.1:7447, INSECURE: no certificates beyond that computer",
        ),
        (
            {"servo_link": {"received": 90, "lost": 2, "out_of_order": 0, "dropped": 1}},
            "servo link",
            "90 messages came; 2 lost, 1 dropped",
        ),
        ({"servo_link": {"received": 90, "lost": 0}}, "servo link", "90 messages came; none lost"),
        ({"secured": True}, "link", "tcp/127.0.0.1:7447, certificates"),
        ({"simulated": None, "backend": "mavlink"}, "robot", "ant (mavlink)"),
    ],
    ids=str,
)
def test_what_a_person_must_see(changed: dict[str, Any], row: str, shown: str) -> None:
    assert dict(status_rows({**CALM, **changed}, CLEAR_COMMAND))[row] == shown


def test_the_command_that_clears_a_stop_is_the_one_given() -> None:
    there = "hexctl estop --clear --connect tcp/127.0.0.1:7448"
    rows = dict(status_rows({"stopped": "estop"}, there))
    assert rows["stopped"].endswith(f"{there} clears it")


def test_what_robots_and_controllers_call_themselves_is_shown_as_it_is() -> None:
    odd = {
        **CALM,
        "controller": "lab[/red]",
        "controller_since_s": 1.0,
        "fault": "the board says: [/E12]",
        "endpoint": "tcp/[fe80::1]:7447",
        "simulated": True,
    }
    console = Console(width=100)
    with console.capture() as shown:
        console.print(status_table([{}, CALM, odd], CLEAR_COMMAND))
    for text in ("ant (sim), world rough", "lab[/red], for 1.0 s", "[/E12]", "tcp/[fe80::1]:7447"):
        assert text in shown.get()


def test_only_a_simulation_tells_of_its_world() -> None:
    assert ServedOptions(backend="mock").simulated is None
    assert ServedOptions(backend="sim").simulated == {"world": "flat", "failure": "none"}
    assert ServedOptions(backend="sim", failed_leg=2).simulated == {
        "world": "flat",
        "failure": "leg 2 locked",
    }


def test_a_served_simulation_says_what_it_is(tmp_path: Path) -> None:
    with served(tmp_path, "--world", "rough", "--failure", "5:limp", backend="sim") as robot:
        shown = hexctl("status", "--connect", robot.endpoint)
        simulated = robot.status()["simulated"]
        walk = ("run", "--backend", "zenoh", "--connect", robot.endpoint, "--no-record", "--duration", "0.1")
        other = hexctl(*walk, "--failed-leg", "3", "--self-rotation", "none")
        same = hexctl(*walk, "--failure", "5:limp", "--self-rotation", "none")
    assert simulated == {"world": "rough", "failure": "leg 5 limp"}
    assert "there has failure leg 5 limp, this end walks as with failure leg 3 locked" in other.stderr
    assert same.returncode == 0, same.stderr
    assert "failure" not in same.stderr
    assert "ant (sim), world rough, failure leg 5 limp" in shown.stdout, shown.stderr
    assert "controller  none" in shown.stdout


def test_a_line_on_ros_where_the_robot_is_a_node() -> None:
    ros = {"router": "tcp/localhost:7447", "connected": True, "drive": True, "commands": 7, "malformed": 2}
    assert ("ROS", "router tcp/localhost:7447; 7 commands, 2 malformed") in status_rows(
        {"ros": ros}, CLEAR_COMMAND
    )
    lost = {**ros, "connected": False, "trouble": "no ROS router", "drive": False}
    assert ("ROS", "no ROS router; ROS may stop the robot, and not move it") in status_rows(
        {"ros": lost}, CLEAR_COMMAND
    )
    assert not [name for name, _ in status_rows({"ros": None}, CLEAR_COMMAND) if name == "ROS"]


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
    for name in ("stopped", "commands", "battery", "ROS", "dropped"):
        assert rows[name] == "told in another way than this version of hexctl understands"
    assert rows["robot"] == dict(status_rows(CALM, CLEAR_COMMAND))["robot"]
