"""What the servos do when a controller, a robot or the link between them fails: all in separate processes."""

import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.zenoh.zenoh_client import ask
from hexctl.cli.console import INTERRUPTED
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.stop import HOLD_S, claim_of, new_clear_key
from hexctl.wire.zenoh_session import open_session
from tests.robots import shipped
from tests.server.cable import Cable
from tests.server.processes import Served, controlling, hexctl, program, served, wait_until
from tests.server.recorded import JUMP_AT, JUMP_VARIABLE, ServoLog
from tests.server.swaying import HELD_UP

pytestmark = pytest.mark.realtime

#: A stopped robot's targets rest after this, e-stop or silence, on a machine that has time for it.
STILL_AFTER_S = 0.25

#: The same on a machine that runs other tests beside: what must end does, timing aside.
STILL_ON_A_BUSY_MACHINE_S = 1.0

#: Commands after which a walk has stood up and strides.
WALKS_AFTER = 150

#: What a program says that a busy machine kept waiting.
STOOD_STILL = "this program stood still"

#: How often a machine may be too busy for a controller.
ATTEMPTS = 4


def check_limits(log: ServoLog) -> None:
    """Check that no servo was ever told to leave its range, or to go faster than it may within a period."""
    robot = shipped()
    assert np.isfinite(log.joint_positions_rad).all()
    assert (log.joint_positions_rad >= robot.joint_lower_rad - 1e-9).all()
    assert (log.joint_positions_rad <= robot.joint_upper_rad + 1e-9).all()
    steps = np.abs(np.diff(log.joint_positions_rad, axis=0)) / (robot.joint_max_speed_rad_s * PERIOD_S)
    assert steps.max(initial=0.0) <= 1 + 1e-9


def stopped(robot: Served) -> str | None:
    reason = robot.status()["stopped"]
    assert reason is None or isinstance(reason, str)
    return reason


def status_when(folder: Path, come: Callable[[Served], bool], *options: str) -> dict[str, Any]:
    """Status of a robot that is swayed, once something has arrived.

    All of it again where the machine held the controller up for so long that its silence was real.
    """
    for attempt in range(ATTEMPTS):
        (place := folder / str(attempt)).mkdir()
        with served(place) as robot, controlling(place, robot.endpoint, *options) as controller:
            controller.wait_for("moving")
            wait_until(lambda: come(robot) or controller.process.poll() is not None, "what is waited for")
            status = robot.status()
            check_limits(robot.log())
        if status["stopped"] is None or HELD_UP not in controller.said():
            break
    return status


@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGSTOP])
def test_a_controller_that_is_killed_or_stopped_leaves_the_robot_frozen_until_a_new_lease(
    tmp_path: Path, how: signal.Signals
) -> None:
    with served(tmp_path) as robot:
        with controlling(tmp_path, robot.endpoint) as controller:
            controller.wait_for("moving")
            at_s = controller.signal(how)
            wait_until(lambda: stopped(robot) == "expired", "the stop")
            assert robot.log().moved_after(at_s) <= STILL_ON_A_BUSY_MACHINE_S
            time.sleep(0.3)
            if how is signal.SIGSTOP:
                controller.signal(signal.SIGCONT)
                controller.wait()
                assert "ended" in controller.said()
            assert robot.log().moved_after(at_s) <= STILL_ON_A_BUSY_MACHINE_S
        with controlling(tmp_path, robot.endpoint, "again=1", name="next") as following:
            following.wait_for("moving")
        check_limits(robot.log())


@pytest.mark.parametrize(("again_after_s", "latched"), [(0.2, "expired"), (None, None)])
def test_a_walk_that_a_second_ctrl_c_breaks_off_is_latched_and_one_that_ends_softly_is_not(
    tmp_path: Path, again_after_s: float | None, latched: str | None
) -> None:
    for attempt in range(ATTEMPTS):
        (place := tmp_path / str(attempt)).mkdir()
        if (interrupted := walk_interrupted(place, again_after_s)) is not None:
            reason, moved_for_s = interrupted
            assert reason == latched
            assert again_after_s is None or moved_for_s <= STILL_ON_A_BUSY_MACHINE_S
            return
    pytest.skip("this machine keeps a walk waiting for longer than a robot waits for its commands")


def walk_interrupted(folder: Path, again_after_s: float | None) -> tuple[str | None, float] | None:
    """Why the robot of a walk is stopped after Ctrl-C, and for how long after the last one it moved on.

    None where the machine kept one of them waiting, so that silence was real.
    """
    walk = ("hexctl", "run", "--backend", "zenoh", "--no-record", "--duration", "600", "--connect")
    with served(folder) as robot, program(folder, "walk", *walk, robot.endpoint) as controller:
        wait_until(
            lambda: (
                robot.status()["commands"]["accepted"] > WALKS_AFTER or controller.process.poll() is not None
            ),
            "the walk",
        )
        if controller.process.poll() is not None:
            return None
        at_s = controller.signal(signal.SIGINT)
        if again_after_s is not None:
            time.sleep(again_after_s)
            at_s = controller.signal(signal.SIGINT)
        code = controller.wait()
        reason, moved_for_s = stopped(robot), robot.log().moved_after(at_s)
        if STOOD_STILL in robot.said() + controller.said() or "(state)" in controller.said():
            return None
        assert code == INTERRUPTED
        assert ("interrupted without a soft stop" in controller.said()) is (again_after_s is not None)
    return reason, moved_for_s


def test_after_a_longer_silence_the_robot_sits_down_and_relaxes(tmp_path: Path) -> None:
    with served(tmp_path, "--sit-after", "1") as robot:
        with controlling(tmp_path, robot.endpoint) as controller:
            controller.wait_for("moving")
            controller.signal(signal.SIGKILL)
        wait_until(lambda: robot.log().relaxed.any(), "relaxing")
        log = robot.log()
        assert robot.status()["posture"] == "limp"
        knees = log.joint_positions_rad[:, 1::3]
        assert (knees[-1] > shipped().stance_angles_rad[1] + 0.5).all()
        check_limits(log)
        with controlling(tmp_path, robot.endpoint, "again=1", name="next") as following:
            following.wait_for("moving")
        check_limits(robot.log())


def test_an_estop_ends_motion_and_nothing_resumes_without_a_clear_and_a_new_lease(tmp_path: Path) -> None:
    with served(tmp_path) as robot:
        with controlling(tmp_path, robot.endpoint) as controller:
            controller.wait_for("moving")
            answer = hexctl("estop", "--connect", robot.endpoint)
            assert answer.returncode == 0
            assert "stopped (estop)" in answer.stdout
            controller.wait()
            assert "estop" in controller.said()
            confirmed_s = time.monotonic()
        with controlling(tmp_path, robot.endpoint, name="barred") as barred:
            barred.wait()
            assert "the robot is stopped: estop" in barred.said()
        assert hexctl("estop", "--clear", "--connect", robot.endpoint).returncode == 0
        time.sleep(0.3)
        assert robot.log().moved_after(confirmed_s) == 0
        with controlling(tmp_path, robot.endpoint, "again=1", name="next") as following:
            following.wait_for("moving")
        check_limits(robot.log())


def test_a_second_controller_is_told_who_holds_the_robot_and_moves_nothing(tmp_path: Path) -> None:
    with served(tmp_path) as robot, controlling(tmp_path, robot.endpoint) as first:
        first.wait_for("moving")
        with controlling(tmp_path, robot.endpoint, name="second") as second:
            second.wait()
            assert f"process {first.process.pid}" in second.said()
        status = robot.status()
        assert str(first.process.pid) in status["controller"]
        assert status["leases_refused"] >= 1
        assert status["commands"]["stale_owner"] == 0
        assert first.process.poll() is None


def test_a_robot_that_is_killed_is_noticed_and_can_be_used_again_when_it_is_back(tmp_path: Path) -> None:
    with served(tmp_path) as robot, controlling(tmp_path, robot.endpoint) as controller:
        controller.wait_for("moving")
        robot.signal(signal.SIGKILL)
        assert controller.wait() == 3
        assert "ended" in controller.said()
        port = int(robot.endpoint.rpartition(":")[2])
    with (
        served(tmp_path, port=port, name="back") as back,
        controlling(tmp_path, back.endpoint, "again=1", name="next") as following,
    ):
        following.wait_for("moving")
        check_limits(back.log())


def test_a_robot_that_stalls_for_a_second_does_not_act_on_what_waited(tmp_path: Path) -> None:
    with served(tmp_path) as robot, controlling(tmp_path, robot.endpoint) as controller:
        controller.wait_for("moving")
        at_s = robot.signal(signal.SIGSTOP)
        time.sleep(1.0)
        robot.signal(signal.SIGCONT)
        controller.wait()
        wait_until(lambda: stopped(robot) == "expired", "the stop")
        # At most what was on its way to the servos when the process froze, and one tick after it woke.
        later = robot.log().between(at_s + 0.1, at_s + 60)
        assert len(np.unique(later.joint_positions_rad, axis=0)) <= 2
        check_limits(robot.log())


@pytest.mark.parametrize("loss", [0.02, 0.3])
def test_lost_and_overtaken_commands_are_counted_and_the_motion_stays_within_limits(
    tmp_path: Path, loss: float
) -> None:

    def has_lost(robot: Served) -> bool:
        counts = robot.status()["commands"]
        return bool(counts["lost"] and counts["out_of_order"])

    status = status_when(tmp_path, has_lost, f"loss={loss}", "reorder=0.1")
    assert status["stopped"] is None
    assert status["commands"]["lost"] > 0
    assert status["commands"]["out_of_order"] > 0
    assert status["commands"]["accepted"] > 0


@pytest.mark.parametrize(("side", "jump_s"), [("controller", 86_400.0), ("robot", -86_400.0)])
def test_a_jump_of_the_walls_clock_on_either_side_changes_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, jump_s: float, side: str
) -> None:
    if side == "robot":
        monkeypatch.setenv(JUMP_VARIABLE, str(jump_s))

    def is_past(robot: Served) -> bool:
        return len(robot.log().times_s) > JUMP_AT + 25

    status = status_when(tmp_path, is_past, *([f"jump={jump_s}"] if side == "controller" else []))
    assert status["stopped"] is None
    assert status["commands"]["late"] == 0
    assert status["controller"] is not None


@pytest.mark.parametrize("how", ["hold", "close"])
def test_a_link_that_is_cut_freezes_the_robot_and_what_waited_in_it_moves_nothing(
    tmp_path: Path, how: str
) -> None:
    with served(tmp_path) as robot, Cable(robot.endpoint) as cable:
        with controlling(tmp_path, cable.endpoint) as controller:
            controller.wait_for("moving")
            at_s = cable.cut(how)
            wait_until(lambda: stopped(robot) == "expired", "the stop")
            cable.mend()
            assert controller.wait() == 3
            time.sleep(0.5)
            assert robot.log().moved_after(at_s) <= STILL_ON_A_BUSY_MACHINE_S
        with controlling(tmp_path, cable.endpoint, "again=1", name="next") as following:
            following.wait_for("moving")
        check_limits(robot.log())


def wait_for_motion(robot: Served) -> None:
    """Wait until a robot moves from now on."""
    now_s = time.monotonic()
    wait_until(lambda: robot.log().moved_after(now_s + 0.1) > 0, "motion")


def stop_often(folder: Path, times: int, *, still_after_s: float) -> None:
    """Stop a swaying robot again and again, and check how long it moves on each time."""
    pause = np.random.default_rng(0).uniform(0.05, 0.25, times)
    with (
        served(folder) as robot,
        controlling(folder, robot.endpoint, "again=1"),
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, KeyMap.of("ant")) as session,
    ):
        key = KeyMap.of("ant").estop
        for pause_s in pause.tolist():
            wait_for_motion(robot)
            time.sleep(pause_s)
            at_s = time.monotonic()
            clear_key = new_clear_key()
            stop = {"op": "stop", "request": claim_of(clear_key)}
            assert [answer["stopped"] for answer in ask(session, key, stop)] == ["estop"]
            time.sleep(still_after_s + 0.1)
            assert robot.log().moved_after(at_s) <= still_after_s
            time.sleep(max(0.0, HOLD_S + 0.05 - (time.monotonic() - at_s)))
            (described,) = ask(session, KeyMap.of("ant").describe)
            stop_id = described["status"]["stop"]["id"]
            clear = {"op": "clear", "id": stop_id, "keys": [clear_key]}
            assert [answer["stopped"] for answer in ask(session, key, clear)] == [None]
        check_limits(robot.log())


def test_an_estop_while_moving_ends_the_motion_every_time(tmp_path: Path) -> None:
    stop_often(tmp_path, times=3, still_after_s=STILL_ON_A_BUSY_MACHINE_S)


def test_a_stop_is_there_after_the_server_was_killed_and_started_again(tmp_path: Path) -> None:
    with served(tmp_path) as robot:
        with controlling(tmp_path, robot.endpoint) as controller:
            controller.wait_for("moving")
            assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
            wait_until(lambda: robot.status()["stop"]["kept"], "the stop on the disk")
            robot.signal(signal.SIGKILL)
        port = int(robot.endpoint.rpartition(":")[2])
    with served(tmp_path, port=port, name="back") as back:
        assert "still stopped (estop" in back.said()
        with controlling(tmp_path, back.endpoint, name="barred") as barred:
            barred.wait()
            assert "the robot is stopped: estop" in barred.said()
        assert back.log().times_s.size == 0
        assert hexctl("estop", "--clear", "--connect", back.endpoint).returncode == 0
        with controlling(tmp_path, back.endpoint, "again=1", name="next") as following:
            following.wait_for("moving")
        back.end()
    with served(tmp_path, port=port, name="third") as third:
        assert stopped(third) is None


@pytest.mark.soak
def test_an_estop_while_moving_ends_the_motion_a_hundred_times_of_a_hundred(tmp_path: Path) -> None:
    stop_often(tmp_path, times=100, still_after_s=STILL_AFTER_S)
