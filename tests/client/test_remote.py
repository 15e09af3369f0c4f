"""Robots on a link seen from outside: a stop is never refused, clearing a neighbour's is."""

import re
import signal
from pathlib import Path

import pytest

from hexctl.client.remote import RemoteRobots, remote_robots
from hexctl.errors import InputError, RobotFaultError
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.zenoh_session import open_session
from tests.server.processes import controlling, hexctl, served, stopped_by_session

pytestmark = pytest.mark.realtime


def test_a_neighbours_robot_may_be_stopped_by_default_and_cleared_only_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("hexctl.wire.description.user_name", lambda: "neighbour")
    with served(tmp_path, backend="mock") as robot:
        by_default = Link(endpoint=robot.endpoint, named=False)
        with open_session(by_default, Role.CONTROLLER, KeyMap.of("*")) as session:
            robots = RemoteRobots(session, by_default)
            assert [answer["stopped"] for answer in robots.stop()] == ["estop"]
            with pytest.raises(InputError, match=r"neighbour on .*; if it is the one you mean, name it"):
                robots.clear()
            assert robots.await_statuses()[0]["stopped"] == "estop"
        with remote_robots(Role.CONTROLLER, connect=robot.endpoint) as named:
            assert [answer["stopped"] for answer in named.clear()] == [None]


def test_commands_say_which_robot_answered(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot:
        here = ("--connect", robot.endpoint)
        stop = stopped_by_session(lambda: hexctl("estop", *here), lambda done: "started by" in done.stderr)
        clear = hexctl("estop", "--clear", *here)
        walk = hexctl("run", "--backend", "zenoh", "--no-record", "--duration", "0.1", *here)
        shown = hexctl("status", *here)
        process = f"process {robot.process.pid}"
    for done in (stop, clear, walk):
        assert done.returncode == 0, done.stderr
        assert "the robot is ant (mock), started by" in done.stderr
        assert process in done.stderr
    assert process in shown.stdout


class SilentSession:
    """A session on which no robot answers."""

    def get(self, *_args: object, **_options: object) -> list[object]:
        return []


def test_silence_is_an_error_with_the_endpoint(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hexctl.client.remote.ANSWER_TIMEOUT_S", 0.1)
    robots = RemoteRobots(SilentSession(), Link(endpoint="tcp/127.0.0.1:9"))  # type: ignore[arg-type]
    for ask in (robots.await_statuses, robots.stop, robots.clear):
        with pytest.raises(RobotFaultError, match=r"no robot answers at tcp/127\.0\.0\.1:9"):
            ask()


def test_legs_of_a_served_simulation_fail_and_heal_on_request(tmp_path: Path) -> None:
    with served(tmp_path, backend="sim") as robot:
        here = ("--connect", robot.endpoint)
        told = [
            hexctl("sim", *change, *here)
            for change in (
                *(("fail", "5:limp"), ("fail", "2:stuck:femur"), ("heal", "5"), ("fail", "7:limp")),
                *(("heal", "5"), ("fail", "limp")),
            )
        ]
        shown = hexctl("status", *here)
        with remote_robots(Role.CONTROLLER, connect=robot.endpoint) as robots:
            assert robots.statuses()[0]["simulated"]["failure"] == "leg 2 femur stuck"
            assert robots.statuses()[0]["failures"] == ["2:stuck:femur:0"]
            assert [answer["failures"] for answer in robots.heal(2)] == [[]]
            with pytest.raises(InputError, match="LEG:KIND"):
                robots.fail("limp")
    assert [done.returncode for done in told] == [0, 0, 0, 2, 0, 2]
    assert told[0].stdout == "failed now: leg 5 limp\n"
    assert told[1].stdout == "failed now: leg 2 femur stuck, leg 5 limp\n"
    assert told[2].stdout == "failed now: leg 2 femur stuck\n"
    assert "1..6" in told[3].stderr
    assert told[4].stderr == "hexctl: leg 5 was whole already\n"
    assert "LEG:KIND: got 'limp'; allowed: LEG:KIND such as 5:limp" in told[5].stderr
    assert "leg 2 femur stuck" in shown.stdout


def test_the_log_of_a_robot_tells_what_was_broken_and_who_lost_it(tmp_path: Path) -> None:
    with served(tmp_path, backend="sim") as robot:
        for words in (("fail", "5:limp"), ("heal", "5")):
            assert hexctl("sim", *words, "--connect", robot.endpoint).returncode == 0
        robot.wait_for("legs set to fail: leg 5 limp")
        robot.wait_for("legs set to fail: all are whole")
        with controlling(tmp_path, robot.endpoint):
            robot.wait_for("commanded by")
            robot.signal(signal.SIGINT)
            assert robot.wait() == 0
    *_, last = robot.said().splitlines()
    assert re.search(r" ended while hexctl on .* commanded it; the simulation ends with it$", last)


def test_a_real_robot_lets_no_leg_fail(tmp_path: Path) -> None:
    with served(tmp_path, backend="mock") as robot:
        done = hexctl("sim", "fail", "5:limp", "--connect", robot.endpoint)
    assert done.returncode == 3
    assert "not simulated" in done.stderr
    assert done.stderr.count("\n") == 1
