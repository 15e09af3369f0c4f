"""What the servos do when a controller, a robot or the link between them fails: all in separate processes."""

import signal
import time
from collections.abc import Iterator
from contextlib import ExitStack
from pathlib import Path

import numpy as np
import pytest

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.zenoh.zenoh_client import ask
from hexctl.cli.console import INTERRUPTED
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.stop import LOCKOUT_S, claim_of, new_clear_key
from hexctl.wire.zenoh_session import open_session
from tests.robots import shipped
from tests.server.processes import Served, controlling, hexctl, program, relayed, served, wait_until
from tests.server.recorded import ServoLog

pytestmark = pytest.mark.realtime

#: A stopped robot's targets rest after this, on a machine that has time for it, and on a busy one.
STILL_AFTER_S, STILL_ON_A_BUSY_MACHINE_S = 0.25, 1.0

#: Commands after which a walk has stood up and strides.
WALKS_AFTER = 120

STOOD_STILL = "this program stood still"

#: How often a machine may be too busy for a controller.
ATTEMPTS = 4


def check_limits(log: ServoLog) -> None:
    """Check that no target left its range or moved faster than allowed within a period."""
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


def wait_for_motion(robot: Served) -> None:
    """Wait until a robot moves from now on."""
    now_s = time.monotonic()
    wait_until(lambda: robot.log().moved_after(now_s + 0.1) > 0, "motion")


@pytest.fixture(scope="module")
def robot(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A robot for all tests that do not end it."""
    with served(tmp_path_factory.mktemp("robot")) as robot:
        yield robot
        check_limits(robot.log())


def test_a_controller_that_is_killed_or_stopped_leaves_the_robot_frozen_until_a_new_lease(
    robot: Served, tmp_path: Path
) -> None:
    for how in (signal.SIGKILL, signal.SIGSTOP):
        with controlling(tmp_path, robot.endpoint, name=how.name) as controller:
            controller.wait_for("moving")
            at_s = controller.signal(how)
            wait_until(lambda: stopped(robot) == "expired", "the stop")
            time.sleep(0.3)
            if how is signal.SIGSTOP:
                controller.signal(signal.SIGCONT)
                controller.wait()
                assert "ended" in controller.said()
            assert robot.log().moved_after(at_s) <= STILL_ON_A_BUSY_MACHINE_S
    with controlling(tmp_path, robot.endpoint, "again=1", name="next") as following:
        following.wait_for("moving")


@pytest.mark.parametrize("cut", [signal.SIGSTOP, signal.SIGKILL], ids=["held", "closed"])
def test_a_link_that_is_cut_freezes_the_robot_and_what_waited_in_it_moves_nothing(
    robot: Served, tmp_path: Path, cut: signal.Signals
) -> None:
    with (
        ExitStack() as later,
        relayed(robot.endpoint) as (endpoint, relay),
        controlling(tmp_path, endpoint) as controller,
    ):
        controller.wait_for("moving")
        at_s = time.monotonic()
        relay.send_signal(cut)
        wait_until(lambda: stopped(robot) == "expired", "the stop")
        relay.send_signal(signal.SIGCONT)
        if cut is signal.SIGKILL:
            relay.wait()
            later.enter_context(relayed(robot.endpoint, at=int(endpoint.rpartition(":")[2])))
        assert controller.wait() == 3
        time.sleep(0.3)
        assert robot.log().moved_after(at_s) <= STILL_ON_A_BUSY_MACHINE_S


def test_a_walk_that_a_second_ctrl_c_breaks_off_is_latched_and_one_that_ends_softly_is_not(
    robot: Served, tmp_path: Path
) -> None:
    for again, latched in ((True, "expired"), (False, None)):
        outcomes = (
            walk_interrupted(robot, tmp_path, f"walk-{again}-{attempt}", again) for attempt in range(ATTEMPTS)
        )
        assert next((outcome for outcome in outcomes if outcome is not None), ("?",)) == (latched,)


def walk_interrupted(robot: Served, folder: Path, name: str, again: bool) -> tuple[str | None] | None:
    """Why the robot of a walk is stopped after Ctrl-C; None if this machine kept one of them waiting."""
    walk = ("hexctl", "run", "--backend", "zenoh", "--no-record", "--duration", "600", "--connect")
    before = robot.status()["commands"]["accepted"]
    with program(folder, name, *walk, robot.endpoint) as controller:

        def strides() -> bool:
            accepted: int = robot.status()["commands"]["accepted"]
            return accepted > before + WALKS_AFTER or controller.process.poll() is not None

        wait_until(strides, "the walk")
        at_s = controller.signal(signal.SIGINT)
        if again:
            time.sleep(0.2)
            at_s = controller.signal(signal.SIGINT)
        code = controller.wait()
        reason, moved_for_s = stopped(robot), robot.log().moved_after(at_s)
        if STOOD_STILL in robot.said() + controller.said() or "(state)" in controller.said():
            return None
        assert code == INTERRUPTED
        assert not again or moved_for_s <= STILL_ON_A_BUSY_MACHINE_S
    return (reason,)


@pytest.mark.parametrize(
    ("times", "still_after_s"),
    [(2, STILL_ON_A_BUSY_MACHINE_S), pytest.param(100, STILL_AFTER_S, marks=pytest.mark.soak)],
)
def test_an_estop_while_moving_ends_the_motion_every_time(
    robot: Served, tmp_path: Path, times: int, still_after_s: float
) -> None:
    """A controller takes each lease that it gets and commands, which moves nothing before the clear."""
    keys = KeyMap.of("ant")
    with (
        controlling(tmp_path, robot.endpoint, "again=1"),
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, keys) as session,
    ):
        for pause_s in np.random.default_rng(0).uniform(0.05, 0.25, times).tolist():
            wait_for_motion(robot)
            time.sleep(pause_s)
            at_s = time.monotonic()
            clear_key = new_clear_key()
            stop = {"op": "stop", "request": claim_of(clear_key)}
            assert [answer["stopped"] for answer in ask(session, keys.estop, stop)] == ["estop"]
            time.sleep(LOCKOUT_S + 0.05)
            assert robot.log().moved_after(at_s) <= still_after_s
            (described,) = ask(session, keys.describe)
            clear = {"op": "clear", "id": described["status"]["stop"]["id"], "keys": [clear_key]}
            assert [answer["stopped"] for answer in ask(session, keys.estop, clear)] == [None]


def test_a_stop_is_there_after_the_server_was_killed_and_started_again(tmp_path: Path) -> None:
    with served(tmp_path) as robot, controlling(tmp_path, robot.endpoint) as controller:
        controller.wait_for("moving")
        assert hexctl("estop", "--connect", robot.endpoint).returncode == 0
        wait_until(lambda: robot.status()["stop"]["kept"], "the stop on the disk")
        robot.signal(signal.SIGKILL)
    with served(tmp_path, port=robot.port, name="back") as back:
        assert "still stopped (estop" in back.said()
        with controlling(tmp_path, back.endpoint, name="barred") as barred:
            barred.wait()
            assert "the robot is stopped: estop" in barred.said()
        assert back.log().times_s.size == 0
        assert hexctl("estop", "--clear", "--connect", back.endpoint).returncode == 0
        assert stopped(back) is None


def test_a_robot_that_stalls_does_not_act_on_what_waited_and_one_that_is_killed_is_noticed(
    tmp_path: Path,
) -> None:
    with served(tmp_path) as robot:
        with controlling(tmp_path, robot.endpoint) as controller:
            controller.wait_for("moving")
            at_s = robot.signal(signal.SIGSTOP)
            time.sleep(1.0)
            robot.signal(signal.SIGCONT)
            controller.wait()
            robot.wait_for(f"{STOOD_STILL} for")
            robot.wait_for("STOPPED: expired")
            # At most what was on its way to the servos when the process froze, and one tick after it woke.
            log = robot.log()
            later_rad = log.joint_positions_rad[log.times_s >= at_s + 0.1]
            assert len(np.unique(later_rad, axis=0)) <= 2
        with controlling(tmp_path, robot.endpoint, name="second") as second:
            second.wait_for("moving")
            robot.signal(signal.SIGKILL)
            assert second.wait() == 3
        check_limits(robot.log())
