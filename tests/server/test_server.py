"""The robot's side of the link, tick by tick, with the network left out; and hostile input at every key."""

import json
import os
import random
import socket
import time
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hexctl.backends.base import TruePose
from hexctl.backends.sim.servos import SimServos
from hexctl.backends.zenoh.zenoh_client import ask
from hexctl.control.guard import POSE_EXPIRY_S
from hexctl.errors import RobotFaultError
from hexctl.server.transport import Arrival
from hexctl.types import FloatArray
from hexctl.wire.description import user_name
from hexctl.wire.links import KeyMap, Link, Role
from hexctl.wire.pose import decode_estimate, decode_orientation, decode_pose, encode_pose
from hexctl.wire.stop import UNNAMED
from hexctl.wire.zenoh_messages import SERVER_ENDED, encode_positions
from hexctl.wire.zenoh_session import open_session
from tests.control.posed import PosedMock
from tests.server.bench import Bench, Item, spoiled
from tests.server.processes import TIMEOUT_S, served
from tests.wire.test_zenoh_messages import COMMAND_BYTES

HERE, UPRIGHT = np.array([1.0, 2.0, 0.1]), np.array([1.0, 0.0, 0.0, 0.0])


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> Bench:
    return Bench(monkeypatch)


def test_a_command_reaches_the_servos_at_once_and_comes_back_as_a_state(bench: Bench) -> None:
    bench.acquire()
    wanted = bench.stance_rad + 0.01
    bench.command(wanted)
    np.testing.assert_array_equal(bench.servos.sent[-1].joint_positions_rad, wanted)
    assert bench.last_state()[1].command_sequence == 1


def test_a_short_time_to_live_ends_the_motion_sooner(bench: Bench) -> None:
    bench.acquire()
    bench.command(bench.stance_rad, ttl_ms=50)
    bench.ticks(2)
    assert bench.stopped is None
    bench.ticks(2)
    assert bench.stopped == "expired"
    assert bench.last_state()[1].stopped == "expired"


def test_silence_takes_the_lease_away_and_a_new_one_lifts_the_stop(bench: Bench) -> None:
    bench.obey()
    bench.ticks(12)
    assert bench.stopped == "expired"
    assert bench.server.status()["controller"] is None
    n_before = len(bench.servos.sent)
    bench.command(bench.stance_rad + 0.05)
    assert len(bench.servos.sent) == n_before
    assert bench.server.status()["commands"]["stale_owner"] == 1
    bench.acquire()
    bench.command(bench.stance_rad + 0.05)
    assert len(bench.servos.sent) == n_before + 1


def test_the_status_has_the_id_of_a_stop_and_says_whether_the_robot_is_at_rest(bench: Bench) -> None:
    assert bench.server.status()["stop"] is None
    bench.acquire()
    for tick in range(20):
        bench.command(bench.stance_rad + 0.01 * (tick % 2) + 0.005 * tick)
        bench.ticks(1)
    assert bench.server.status()["at_rest"] is False
    answer = bench.ask("estop", {"op": "stop"})
    stop = bench.server.status()["stop"]
    stopped_by = {"by": UNNAMED, "others_in_s": 1.0, "claims": []}
    assert stop == {"id": answer["stop_id"], "since_s": 0.0, "clear_in_s": 1.0, "kept": False, **stopped_by}
    bench.ticks(12)
    status = bench.server.status()
    assert status["at_rest"] is True
    assert 0.7 < status["stop"]["clear_in_s"] < 0.8
    for wrong in ({}, {"id": "0" * 16}, {"id": stop["id"]}):  # the last one too early
        answer = bench.ask("estop", {"op": "clear", **wrong})
        assert answer["stopped"] == "estop"
        assert "clear: got" in answer["error"]
        assert stop["id"] not in str(answer)
    assert bench.server.status()["cleared"] is None
    assert bench.clear()["stopped"] is None
    cleared = bench.server.status()["cleared"]
    assert (cleared["id"], cleared["reason"], cleared["by"]) == (stop["id"], "estop", UNNAMED)


def test_a_lease_says_which_states_are_of_before(bench: Bench) -> None:
    bench.ticks(7)
    newest = bench.last_state()[1].sequence
    assert bench.acquire()["state"] == newest == 7
    bench.ticks(1)
    assert bench.last_state()[1].sequence == 8


def test_a_stop_reaches_a_robot_in_the_middle_of_commands(bench: Bench) -> None:
    bench.obey()
    assert bench.ask("estop")["stopped"] == "estop"
    n_before = len(bench.servos.sent)
    bench.command(bench.stance_rad + 0.1)
    bench.ticks(1000)
    assert len(bench.servos.sent) == n_before
    assert "error" in bench.acquire()
    assert bench.clear()["stopped"] is None
    assert "lease" in bench.acquire()


@pytest.mark.parametrize("fault", ["low battery 9.6 V", None])
def test_a_fault_stops_the_robot_and_is_said_in_words(bench: Bench, fault: str | None) -> None:
    bench.acquire()
    bench.servos.healthy = False
    bench.servos.fault = fault
    bench.ticks(1)
    reason = "fault" if fault is None else f"fault: {fault}"
    assert bench.stopped == reason
    assert bench.last_state()[1].fault == fault
    bench.ask("lease", {"op": "release", "lease": bench.lease["lease"]})
    assert reason in bench.acquire()["error"]
    assert bench.clear()["stopped"] == reason, "it is still there"
    bench.servos.healthy, bench.servos.fault = True, None
    assert bench.clear()["stopped"] is None


def test_servos_that_cannot_be_reached_neither_rest_nor_hold(bench: Bench) -> None:
    bench.ticks(20)
    assert (bench.server.status()["at_rest"], bench.server.reaches_servos) == (True, True)
    bench.servos.age_s, bench.servos.healthy, bench.servos.fault = 0.5, False, "the port has gone"
    bench.ticks(20)
    status = bench.server.status()
    assert (status["at_rest"], status["posture"]) == (False, "unreached")
    assert status["stopped"] == "fault: the port has gone"
    assert not bench.server.reaches_servos


def test_a_command_that_waited_while_the_robot_was_held_up_is_late(bench: Bench) -> None:
    bench.obey()
    n_before = len(bench.servos.sent)
    bench.servos.time.work(0.3)
    bench.command(bench.stance_rad + 0.05, waited_s=0.3)
    assert len(bench.servos.sent) == n_before
    assert bench.server.status()["commands"]["late"] == 1


def test_a_fall_is_latched_until_it_is_cleared(bench: Bench) -> None:
    bench.acquire()
    bench.servos.lean(80)
    bench.ticks(20)
    assert bench.stopped == "fell"
    bench.servos.lean(0)
    bench.ticks(20)
    assert bench.stopped == "fell"
    assert bench.clear()["stopped"] is None


@pytest.mark.parametrize(
    ("of_command", "stopped"), [({}, None), ({"after": 1}, "expired"), ({"after": 2}, None)]
)
def test_a_controller_that_rests_is_not_silent_unless_a_later_command_comes(
    bench: Bench, of_command: dict[str, int], stopped: str | None
) -> None:
    """Commands and requests come on two threads of Zenoh: a rest may overtake the command before it."""
    bench.acquire()
    wanted = bench.stance_rad + 0.01
    bench.command(bench.stance_rad)
    bench.give_up("rest", **of_command)
    if of_command:
        bench.command(wanted)
        np.testing.assert_array_equal(bench.servos.sent[-1].joint_positions_rad, wanted)
    bench.ticks(30)
    assert bench.stopped == stopped


def test_a_rest_of_an_earlier_lease_is_none_of_the_next_one_and_needs_a_number(bench: Bench) -> None:
    bench.acquire()
    for after in (-1, 1.5, True, "7", 2**64, None):
        assert "after" in bench.give_up("rest", after=after)["error"]
    bench.give_up("rest", after=5)
    bench.give_up("release")
    bench.obey()
    bench.ticks(30)
    assert bench.stopped == "expired"


@pytest.mark.parametrize(
    ("last_step_rad", "rests", "stopped"), [(0.01, False, "expired"), (0.0, False, None), (0.01, True, None)]
)
def test_a_controller_that_leaves_in_mid_motion_counts_as_silent_unless_it_rests(
    bench: Bench, last_step_rad: float, rests: bool, stopped: str | None
) -> None:
    bench.acquire()
    for angle_rad in (0.01, 0.02, 0.02 + last_step_rad):
        bench.command(bench.stance_rad + angle_rad)
        bench.ticks(1)
    if rests:
        bench.give_up("rest")
    bench.give_up("release")
    bench.ticks(30)
    assert (bench.stopped, bench.server.status()["controller"]) == (stopped, None)
    assert "lease" in bench.acquire()
    assert bench.stopped is None


@pytest.mark.parametrize("age_s", [np.nan, np.inf, -0.5, 0.3])
def test_readings_that_are_old_or_no_numbers_stop_the_robot_and_do_not_end_it(
    bench: Bench, age_s: float
) -> None:
    bench.acquire()
    bench.servos.age_s = age_s
    bench.servos.joints_rad = np.full(18, np.nan)
    bench.ticks(60)
    assert bench.stopped == "state"
    assert json.dumps(bench.server.status(), allow_nan=False)


def test_a_server_that_ends_tells_its_controller(bench: Bench) -> None:
    bench.ticks(1)
    bench.acquire()
    bench.server._note_end()
    tag = bench.last_state()[1]
    assert (tag.healthy, tag.fault) == (False, SERVER_ENDED)


def test_a_position_that_jumps_is_not_published_but_counted(bench: Bench) -> None:
    bench.ticks(2)
    bench.pose_from_outside(np.zeros(3), UPRIGHT)
    bench.pose_from_outside(np.array([3e38, 0.0, 0.0]), UPRIGHT)
    bench.said.clear()
    bench.ticks(2)
    poses = [decode_pose(payload) for kind, payload, _ in bench.said if kind == "odom"]
    assert [position for position, _ in poses] == [None, None]
    status = bench.server.status()
    assert (status["positions_doubted"], status["stopped"], status["pose"]) == (1, None, False)


def test_a_pose_is_published_with_the_deviation_of_its_source(bench: Bench) -> None:
    def published() -> FloatArray:
        bench.said.clear()
        bench.ticks(1)
        (payload,) = [payload for kind, payload, _ in bench.said if kind == "odom"]
        variances: FloatArray = np.diag(decode_estimate(payload)[2].reshape(6, 6))
        return variances

    bench.ticks(2)

    assert (published() > 0).all(), "its own"
    for deviation_m in (0.002, 0.03):
        payload = encode_pose(HERE, UPRIGHT, position_variance_m2=deviation_m**2, yaw_variance_rad2=0.01**2)
        bench.server._set_pose(payload, bench.servos.time.now_s)
        assert np.sqrt(published())[[0, 1, 2, 5]] == pytest.approx([*3 * [deviation_m], 0.01])


@pytest.mark.parametrize("quaternion", [None, UPRIGHT])
def test_a_pose_from_outside_leaves_the_fall_detection_to_the_robots_own_orientation(
    bench: Bench, quaternion: Any
) -> None:
    bench.ticks(2)
    bench.pose_from_outside(HERE, quaternion, for_s=POSE_EXPIRY_S + 1.0)
    assert bench.stopped is None
    bench.servos.lean(80)
    bench.pose_from_outside(HERE, quaternion, for_s=0.4)
    assert bench.stopped == "fell"


@pytest.mark.parametrize(("position", "quaternion"), [(HERE, None), (None, UPRIGHT), (HERE, UPRIGHT)])
def test_a_pose_from_outside_that_stops_coming_is_lost_whatever_the_robot_knows_itself(
    bench: Bench, position: Any, quaternion: Any
) -> None:
    bench.ticks(2)
    bench.pose_from_outside(position, quaternion, for_s=1.0)
    bench.ticks(round(POSE_EXPIRY_S / 0.02))
    assert bench.stopped is None
    bench.ticks(20)
    assert bench.stopped == "pose lost"


@pytest.mark.parametrize("late_s", [0.6, 3600.0])
def test_a_pose_from_outside_that_comes_late_is_not_used_and_is_counted(bench: Bench, late_s: float) -> None:
    bench.pose_from_outside(HERE, UPRIGHT, for_s=1.0)
    for _ in range(20):
        bench.send_pose(HERE, UPRIGHT, late_s=late_s)
        bench.ticks(1)
    status = bench.server.status()
    assert (status["pose"], status["late_poses"]) == (False, 20)
    bench.pose_from_outside(HERE, UPRIGHT)
    assert bench.server.status()["pose"]


def test_an_own_orientation_that_stays_away_is_lost_although_a_position_comes_from_outside(
    bench: Bench,
) -> None:
    bench.ticks(2)
    bench.pose_from_outside(HERE, None)
    bench.servos.quaternion_world = None
    bench.pose_from_outside(HERE, None, for_s=POSE_EXPIRY_S + 0.2)
    assert bench.stopped == "pose lost"


def test_a_pose_from_outside_that_knows_nothing_yet_leaves_the_robots_own(bench: Bench) -> None:
    bench.ticks(2)
    bench.pose_from_outside(None, None, for_s=POSE_EXPIRY_S + 1.0)
    assert bench.stopped is None
    assert bench.server.status()["pose"]


def test_the_own_orientation_goes_out_beside_a_pose_from_outside(bench: Bench) -> None:
    bench.servos.lean(10)
    own = bench.servos.quaternion_world
    bench.pose_from_outside(HERE, UPRIGHT, for_s=0.1)
    said = [payload for kind, payload, _ in bench.said if kind == "imu"]
    assert len(said) == 5
    assert decode_orientation(said[-1]) == pytest.approx(own, abs=1e-9)
    _, outside = decode_pose([payload for kind, payload, _ in bench.said if kind == "odom"][-1])
    assert outside == pytest.approx(UPRIGHT)
    bench.servos.quaternion_world = None
    bench.ticks(1)
    assert [kind for kind, _, _ in bench.said].count("imu") == 5


class Still(SimServos):
    """A simulation of a robot that is here and stands upright."""

    def __init__(self) -> None:
        super().__init__("ant")

    @property
    def true_pose(self) -> TruePose:
        return HERE, UPRIGHT


def test_only_a_simulated_robot_tells_the_truth(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    bench.ticks(1)
    assert "truth" not in [kind for kind, _, _ in bench.said]
    monkeypatch.setattr(PosedMock, "simulation", Still())
    bench.ticks(1)
    position, quaternion = decode_pose([payload for kind, payload, _ in bench.said if kind == "truth"][-1])
    assert position == pytest.approx(HERE)
    assert quaternion == pytest.approx(UPRIGHT)


def test_reading_for_an_answer_does_not_count_towards_a_fall(bench: Bench) -> None:
    bench.obey()
    bench.servos.lean(80)
    for _ in range(20):
        bench.command(bench.stance_rad)
    assert bench.stopped is None


def test_the_status_and_the_answer_to_a_stop_say_who_started_the_robot(bench: Bench) -> None:
    for answer in (bench.server.status(), bench.ask("describe")["status"], bench.ask("estop")):
        assert (answer["host"], answer["user"], answer["pid"]) == (
            socket.gethostname(),
            user_name(),
            os.getpid(),
        )
        assert (answer["robot"], answer["backend"]) == ("ant", "mock")


#: Messages at each key in the ordinary tests, and in the soak tests.
TIMES, MANY = 3_000, 100_000

GOOD = {
    "command": encode_positions(np.zeros(18)),
    "pose": encode_pose(np.zeros(3), UPRIGHT),
    "lease": b'{"op": "renew", "lease": "00"}',
    "estop": b'{"op": "clear"}',
    "describe": b"",
}


@pytest.mark.parametrize("kind", list(GOOD))
@pytest.mark.parametrize("times", [TIMES, pytest.param(MANY, marks=pytest.mark.soak)])
def test_spoiled_messages_move_nothing_and_are_counted(bench: Bench, kind: str, times: int) -> None:
    chance = random.Random(kind)
    for _ in range(times):
        attachment = spoiled(COMMAND_BYTES, chance) if chance.random() < 0.9 else COMMAND_BYTES
        item: Any = Item(spoiled(GOOD[kind], chance), attachment)
        bench.server._handle(Arrival(kind, item, 0.0))
        assert item.dropped == (kind in ("lease", "estop", "describe"))
    status = bench.server.status()
    assert not bench.servos.sent
    commands = status["commands"]
    assert commands["accepted"] == 0
    if kind == "command":
        assert commands["malformed"] + commands["stale_owner"] == times
    if kind == "pose":
        assert status["malformed"]["poses"] > times / 2
    if kind in ("lease", "estop"):
        assert status["malformed"]["requests"] > times / 2
        assert status["controller"] is None


def test_spoiled_commands_of_the_lease_holder_never_leave_the_limits(bench: Bench) -> None:
    chance = random.Random(1)
    bench.acquire()
    for _ in range(5_000):
        bench.send_command(spoiled(GOOD["command"], chance))
    robot = bench.servos.robot
    sent = np.array([targets.joint_positions_rad for targets in bench.servos.sent])
    assert len(sent) == bench.server.status()["commands"]["accepted"] > 10
    assert np.isfinite(sent).all()
    within = robot.joint_max_speed_rad_s * bench.servos.clock.period_s + 1e-9
    assert (np.abs(sent - robot.stance_angles_rad) <= within).all()


def test_a_message_of_a_million_joints_is_dropped(bench: Bench) -> None:
    for kind in GOOD:
        item: Any = Item(bytes(8_000_000), COMMAND_BYTES)
        bench.server._handle(Arrival(kind, item, 0.0))
    assert bench.server.status()["commands"]["malformed"] == 1
    assert not bench.servos.sent


@pytest.mark.soak
@pytest.mark.parametrize("kind", ["command", "pose", "lease", "estop", "describe", "status"])
def test_a_hundred_thousand_spoiled_messages_over_the_link_move_nothing_and_delay_no_stop(
    tmp_path: Path, kind: str
) -> None:
    chance, keys = random.Random(kind), KeyMap.of("ant")
    good = GOOD.get(kind, b"{}")
    with (
        served(tmp_path) as robot,
        open_session(Link(endpoint=robot.endpoint), Role.CONTROLLER, keys) as session,
    ):
        key = getattr(keys, kind)
        for _ in range(MANY):
            session.put(key, spoiled(good, chance), attachment=spoiled(COMMAND_BYTES, chance))
        assert robot.process.poll() is None
        began_s = time.monotonic()
        assert [one["stopped"] for one in ask(session, keys.estop, {"op": "stop"})] == ["estop"]
        assert time.monotonic() - began_s < TIMEOUT_S
        status = robot.status()
        assert status["stopped"] == "estop"
        assert robot.log().times_s.size == 0
        if kind == "command":
            counts = status["commands"]
            dropped = counts["malformed"] + counts["stale_owner"] + counts["overflowed"]
            assert dropped > MANY / 100  # Zenoh drops what a robot cannot take; what came is counted


@pytest.mark.parametrize("error", [OSError(5, "Input/output error"), KeyError("leg7")])
def test_servos_that_raise_while_a_command_is_answered_are_a_fault_with_a_name(
    bench: Bench, monkeypatch: pytest.MonkeyPatch, error: Exception
) -> None:
    def read() -> None:
        raise error

    bench.obey()
    monkeypatch.setattr(bench.servos, "read", read)
    with pytest.raises(RobotFaultError, match=type(error).__name__):
        bench.command(bench.stance_rad + 0.01)
    with pytest.raises(RobotFaultError, match=r"PosedMock\.read"):
        bench.ticks(1)
