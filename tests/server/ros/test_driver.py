"""Driving by ROS, tick by tick, with the network left out: lease, guard, expiry, stops and hostile input."""

import math
import random
from types import SimpleNamespace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest

from hexctl.errors import MessageError
from hexctl.gait.body_pose import BodyPose, feet_from_body
from hexctl.gait.gait import NAMED_SLOTS
from hexctl.ik.legs import solve_legs
from hexctl.robot.loader import load_robot
from hexctl.server.ros.bridge import RosBridge, _Commands
from hexctl.server.ros.settings import LiveSettings, RosSettings
from hexctl.server.transport import Arrival, Inbox
from hexctl.types import FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.links import Endpoint
from hexctl.wire.ros.motion_commands import (
    OFF,
    POSE,
    TWIST,
    TWIST_STAMPED,
    Called,
    RosCommand,
    Service,
    WantedJoints,
    WantedVelocity,
    decode_body_pose,
    decode_velocity,
)
from hexctl.wire.ros.ros_names import Kind, RosEndpoint, RosNode
from hexctl.wire.ros.ros_session import Attachment, open_ros_session
from hexctl.wire.ros.telemetry import encode_trigger_answer
from hexctl.wire.zenoh_messages import decode_positions, encode_positions
from tests.backends.fake_time import FakeTime
from tests.server.bench import Bench, spoiled
from tests.server.ros.test_settings import wishes
from tests.wire.ros.test_telemetry import twist

FORWARD = np.array([0.05, 0.0, 0.0])
STANDING_UP_TICKS = 110


def pose_message(roll_rad: float, *, up_m: float = 0.0, length: float = 1.0) -> bytes:
    half = roll_rad / 2
    turn = length * np.array([math.sin(half), 0.0, 0.0, math.cos(half)])
    at = ros_cdr.point(np.array([0.0, 0.0, up_m]))
    return ros_cdr.encode(ros_cdr.make(POSE, position=at, orientation=ros_cdr.quaternion(turn)))


class Node:
    """A node without a network."""

    drive = True
    condition = None

    def __init__(self) -> None:
        self.live = LiveSettings(load_robot("ant"), RosSettings(ros_drive=True))

    def offer(self, _: object) -> None:
        """Take a state."""

    def status(self) -> dict[str, Any]:
        return {}


class RosBench(Bench):
    """A server that ROS may drive, whose time and network the test holds."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        node = Node()
        super().__init__(monkeypatch, lambda *_: node)
        self.live = node.live

    def send(self, command: RosCommand) -> None:
        self.server._handle(Arrival("ros", command, self.servos.time.now_s))

    def call(self, service: Service) -> tuple[bool, str]:
        answers: list[tuple[bool, str]] = []
        self.send(Called(service, lambda *answer: answers.append(answer)))
        (answer,) = answers
        return answer

    def drive(self, times: int, velocity: FloatArray = FORWARD) -> None:
        """Let time go on, with a velocity in every control period."""
        for _ in range(times):
            self.send(WantedVelocity(velocity))
            self.ticks(1)

    def joints(self) -> FloatArray:
        return self.servos.sent[-1].joint_positions_rad

    def status(self) -> dict[str, Any]:
        return self.server.status()

    def moved(self, ticks: int, velocity: FloatArray | None = None) -> float:
        """By how much the targets change within some ticks, in rad."""
        seen = [self.joints()]
        for _ in range(ticks):
            self.ticks(1) if velocity is None else self.drive(1, velocity)
            seen.append(self.joints())
        return float(np.ptp(seen, axis=0).max())


@pytest.fixture
def bench(monkeypatch: pytest.MonkeyPatch) -> RosBench:
    return RosBench(monkeypatch)


def test_a_velocity_makes_the_robot_stand_up_and_walk_under_a_lease_of_ros(bench: RosBench) -> None:
    bench.drive(STANDING_UP_TICKS)
    assert bench.status()["controller"] == "ROS 2"
    assert bench.status()["ros"]["motion"] == "driving"
    assert bench.moved(50, FORWARD) > 0.05


def test_silence_ends_in_a_stand_and_gives_the_robot_back_and_a_zero_stops_it_sooner(bench: RosBench) -> None:
    bench.drive(STANDING_UP_TICKS + 50)
    bench.ticks(24)
    assert bench.moved(5) > 0  # for half a second it goes on
    bench.ticks(40)
    assert bench.status()["controller"] is None
    assert bench.status()["stopped"] is None
    assert bench.moved(50) == 0
    bench.drive(50)
    bench.send(WantedVelocity(np.zeros(3)))
    bench.ticks(14)
    assert bench.moved(8) == 0


def test_the_lease_decides_who_moves_it_and_a_clear_of_no_stop_disturbs_nobody(
    bench: RosBench,
) -> None:
    bench.acquire()
    bench.drive(20)
    assert bench.status()["ros"]["refused"] == 20
    assert not bench.call(Service.STAND)[0]
    assert not bench.call(Service.SIT)[0]
    assert bench.call(Service.CLEAR_STOP)[0]
    assert bench.status()["controller"] == "test"
    assert not bench.servos.sent
    bench.server._leases.revoke()
    bench.drive(STANDING_UP_TICKS)
    assert bench.call(Service.CLEAR_STOP)[0]
    assert bench.status()["ros"]["motion"] == "driving"
    assert bench.moved(20) > 0.05
    bench.server._leases.revoke()
    assert bench.moved(20) == 0


def test_zeros_of_an_idle_planner_do_not_hold_the_robot(bench: RosBench) -> None:
    bench.drive(50, np.zeros(3))
    assert bench.status()["controller"] is None
    assert not bench.servos.sent


def test_a_stop_ends_everything_until_it_is_cleared(bench: RosBench) -> None:
    bench.drive(STANDING_UP_TICKS + 20)
    bench.server._requests.stop_over_ros()
    assert bench.moved(50, FORWARD) == 0
    assert bench.status()["stopped"] == "estop"
    success, why = bench.call(Service.STAND)
    assert not success
    assert "estop" in why
    assert bench.call(Service.CLEAR_STOP) == (True, "no longer stopped")
    assert bench.moved(20) == 0  # a command of before the stop is forgotten
    bench.drive(STANDING_UP_TICKS)
    assert bench.status()["ros"]["motion"] == "driving"


def test_ros_does_not_clear_the_stop_of_another_client_that_ended_its_walk(bench: RosBench) -> None:
    bench.drive(STANDING_UP_TICKS)
    bench.server._requests.urgent(b"")
    assert bench.moved(50, FORWARD) == 0
    assert not bench.call(Service.CLEAR_STOP)[0]
    assert bench.status()["stopped"] == "estop"


def test_standing_and_sitting_by_services(bench: RosBench) -> None:
    stance = bench.servos.robot.stance_angles_rad
    assert bench.call(Service.STAND) == (True, "standing up")
    bench.ticks(STANDING_UP_TICKS)
    np.testing.assert_allclose(bench.joints(), stance, atol=1e-6)
    bench.ticks(50)
    assert bench.status()["controller"] is None
    assert bench.call(Service.SIT) == (True, "sitting down")
    bench.ticks(300)
    assert bench.status()["posture"] == "limp"
    assert bench.servos.limp
    assert bench.status()["controller"] is None


def test_a_velocity_while_it_sits_down_lets_it_stand_up_again(bench: RosBench) -> None:
    bench.call(Service.STAND)
    bench.ticks(STANDING_UP_TICKS)
    bench.call(Service.SIT)
    bench.ticks(40)
    bench.drive(2 * STANDING_UP_TICKS)
    assert bench.status()["ros"]["motion"] == "driving"


def test_joint_commands_pass_the_guard_and_freeze_the_robot_when_they_end(bench: RosBench) -> None:
    wanted = bench.servos.robot.stance_angles_rad + 0.01
    bench.send(WantedJoints(wanted))
    np.testing.assert_array_equal(bench.joints(), wanted)
    assert bench.status()["controller"] == "ROS 2"
    bench.send(WantedJoints(wanted + 1.0))
    most = bench.servos.robot.joint_max_speed_rad_s * bench.servos.clock.period_s
    assert (np.abs(bench.joints() - wanted) <= most + 0.01).all()
    for _ in range(30):
        bench.send(WantedJoints(wanted))
        bench.ticks(1)
    bench.ticks(12)
    assert bench.status()["stopped"] == "expired"
    bench.send(WantedJoints(wanted + 0.01))
    assert bench.status()["stopped"] is None
    np.testing.assert_allclose(bench.joints(), wanted + 0.01)


def test_joints_and_velocities_exclude_each_other(bench: RosBench) -> None:
    wanted = bench.servos.robot.stance_angles_rad
    bench.send(WantedJoints(wanted))
    bench.send(WantedVelocity(FORWARD))
    assert bench.status()["ros"]["refused"] == 1
    bench.ticks(60)
    bench.drive(STANDING_UP_TICKS)
    sent = len(bench.servos.sent)
    bench.send(WantedJoints(wanted + 0.3))
    assert len(bench.servos.sent) == sent
    assert bench.status()["ros"]["refused"] == 2


def test_a_body_pose_makes_the_robot_stand_up_and_lean_and_its_repetition_holds_nothing(
    bench: RosBench,
) -> None:
    bench.send(BodyPose())
    assert bench.status()["controller"] is None
    wanted = decode_body_pose(pose_message(0.1, up_m=0.02))
    assert wanted.roll_rad == pytest.approx(0.1)
    bench.send(wanted)
    assert bench.status()["controller"] == "ROS 2"
    bench.ticks(STANDING_UP_TICKS + 60)
    robot = bench.servos.robot
    expected = solve_legs(robot, feet_from_body(robot.stance_feet_body, wanted.array)).joint_positions_rad
    np.testing.assert_allclose(bench.joints(), expected, atol=1e-9)
    bench.send(wanted)
    assert bench.status()["controller"] is None, "it is there already"
    bench.drive(60)
    assert bench.moved(50, FORWARD) > 0.05
    bench.send(BodyPose(roll_rad=1.0))
    bench.ticks(2)
    assert 0.1 < bench.status()["ros"]["pose_share"] < 1
    bench.send(BodyPose())
    bench.call(Service.SIT)
    bench.ticks(400)
    assert bench.status()["posture"] in ("sitting", "limp")
    bench.send(WantedJoints(robot.stance_angles_rad))
    bench.send(wanted)
    assert bench.status()["ros"]["refused"] == 1


@pytest.mark.parametrize("changed", [{"length": 1.1}, {"up_m": math.nan}, {"up_m": 2.0}, {"length": 1e300}])
def test_poses_that_are_none_are_refused_in_one_line(changed: dict[str, float]) -> None:
    with pytest.raises(MessageError, match=r"body_pose: .*got .*; allowed: .*") as caught:
        decode_body_pose(pose_message(0.1, **changed))
    assert "\n" not in str(caught.value)
    assert decode_body_pose(pose_message(0.1, length=0.0)) == BodyPose(), "zeros are no rotation"


#: Messages of each type in the ordinary tests.
TIMES = 2000

GOOD = {
    TWIST: twist(TWIST, FORWARD),
    TWIST_STAMPED: twist(TWIST_STAMPED, FORWARD),
    "joints": encode_positions(np.zeros(18)),
    POSE: pose_message(0.1, up_m=0.02),
}


def command_of(kind: str, payload: bytes) -> RosCommand:
    if kind == POSE:
        return decode_body_pose(payload)
    return (
        WantedJoints(decode_positions(payload))
        if kind == "joints"
        else WantedVelocity(decode_velocity(kind, payload))
    )


@pytest.mark.parametrize("kind", list(GOOD))
@pytest.mark.parametrize("times", [TIMES, pytest.param(100_000, marks=pytest.mark.soak)])
def test_spoiled_messages_never_leave_the_limits(bench: RosBench, kind: str, times: int) -> None:
    """What can be decoded at all moves no joint faster or further than it may."""
    chance, refused = random.Random(kind), 0
    robot = bench.servos.robot
    bench.servos.position_world = None  # it would stand still while the legs walk, and be lost
    before = robot.stance_angles_rad
    for index in range(times):
        payload = spoiled(GOOD[kind], chance)
        try:
            command = command_of(kind, payload)
        except MessageError:
            refused += 1
        else:
            bench.send(command)
        if index % 4 == 0:
            bench.ticks(1)
            if bench.servos.sent:
                now, most = bench.joints(), robot.joint_max_speed_rad_s * bench.servos.clock.period_s
                assert np.isfinite(now).all()
                assert (now >= robot.joint_lower_rad - 1e-9).all()
                assert (now <= robot.joint_upper_rad + 1e-9).all()
                assert (np.abs(now - before) <= 2 * most + 1e-9).all()  # this period's and the last one's
                before = now
    assert times / 3 < refused < times
    assert bench.status()["stopped"] in (None, "expired")


def test_settings_hold_from_the_next_control_period_on_and_the_gait_changes_in_stride(
    bench: RosBench,
) -> None:
    bench.drive(STANDING_UP_TICKS + 50)
    changes = wishes(gait="wave", sit_after=2.0, level=True)
    assert bench.live.set(changes["parameters"]) == ""
    steps = [bench.joints()]
    for _ in range(100):
        bench.drive(1)
        steps.append(bench.joints())
    driver: Any = bench.server._driver
    assert driver._pilot.walk.gaits[0].slots == NAMED_SLOTS["wave"]
    assert driver._pilot.level
    assert np.abs(np.diff(steps, axis=0)).max() < 0.15, "no jump"
    bench.ticks(50 * 4)
    assert bench.status()["posture"] in ("sitting", "limp")


# Messages and requests of ROS clients, on a session without a router


ROUTER = "tcp/127.0.0.1:1"


def stamped(velocity: FloatArray, stamp_s: float) -> bytes:
    wanted = ros_cdr.make(
        TWIST,
        linear=ros_cdr.point(np.array([velocity[0], velocity[1], 0.0])),
        angular=ros_cdr.point(np.array([0.0, 0.0, velocity[2]])),
    )
    header = ros_cdr.header(round(1e9 * stamp_s))
    return ros_cdr.encode(ros_cdr.make(TWIST_STAMPED, header=header, twist=wanted))


@pytest.mark.parametrize("drive", [False, True])
def test_any_client_stops_the_robot_and_moves_it_only_with_ros_drive(drive: bool) -> None:
    time, inbox, stops = FakeTime(), Inbox(), list[str]()
    bridge = RosBridge(
        load_robot("ant"), RosNode(), inbox, lambda: stops.append("estop"),
        router=ROUTER, settings=RosSettings(ros_drive=drive), time=time,
    )  # fmt: skip
    gid, stopped = Attachment(1, 0, bytes(16)).packed(), {"stops": 1, "sessions": 0}

    with open_ros_session(Endpoint.parse(ROUTER)) as session:
        commands = _Commands(session, bridge.node, bridge)

        def put(topic: str, kind: str, payload: bytes, *, attachment: bytes = gid) -> RosCommand | None:
            endpoint = RosEndpoint(bridge.node, Kind.PUBLISHER, topic, kind, 1)
            session.put(endpoint.key, payload, attachment=attachment)
            commands.take()
            arrival = inbox.take(0.0)
            return None if arrival is None else arrival.item

        assert put("~/estop", "std_msgs/msg/Empty", b"", attachment=b"") is None
        assert stops == ["estop"]
        joints = encode_positions(np.arange(18.0), 0)
        came = [
            put("cmd_vel", TWIST, twist(TWIST, FORWARD)),
            put("robot_joint_command", ros_cdr.JOINT_STATE, joints),
            put("body_pose", POSE, pose_message(0.1)),
            put("cmd_vel", TWIST, b"nonsense"),
        ]
        for late_s, velocity in ((0.0, FORWARD), (0.4, FORWARD), (0.6, FORWARD), (0.6, 0 * FORWARD)):
            time.sleep(1.0)
            came.append(put("cmd_vel", TWIST_STAMPED, stamped(velocity, time.now() - late_s)))
        kinds = (
            *(WantedVelocity, WantedJoints, BodyPose, type(None)),
            *(WantedVelocity, WantedVelocity, type(None), WantedVelocity),
        )
        assert [type(one) for one in came] == ([*kinds] if drive else 8 * [type(None)])
        served = RosEndpoint(bridge.node, Kind.SERVICE, "~/stand", "std_srvs/srv/Trigger", 2)
        replies = session.get(served.key, payload=b"", attachment=gid)
        commands.take()
        called = inbox.take(0.0)
        if drive:
            assert called is not None
            called.item.answer(False, "busy")
        (reply,) = replies
        assert reply.ok is not None
        assert bytes(reply.ok.payload) == encode_trigger_answer(False, "busy" if drive else OFF)
    stopped |= {"commands": 6, "malformed": 1, "late": 2} if drive else dict.fromkeys(
        ("commands", "malformed", "late"), 0
    )  # fmt: skip
    assert {name: bridge.status()[name] for name in stopped} == stopped


def test_states_are_published_until_the_robot_falls_silent_and_a_missing_router_is_named(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    times = iter(np.arange(0.0, 60.0, 0.3).tolist())
    bridge = RosBridge(
        load_robot("ant"), RosNode(), Inbox(), print,
        router=ROUTER, settings=RosSettings(), time=SimpleNamespace(now=times.__next__),  # type: ignore[arg-type]
    )  # fmt: skip
    topics = MagicMock()
    topics.publish_silence.side_effect = lambda _: bridge._closing.set()
    monkeypatch.setattr("hexctl.server.ros.bridge.RobotTopics", lambda *_: topics)
    state: Any = object()
    bridge.offer(state)
    with open_ros_session(Endpoint.parse(ROUTER)) as session:
        bridge._serve(session)
    ((published, at_s), _), (silent_s,) = topics.publish.call_args, topics.publish_silence.call_args.args
    assert published is state
    assert 1.0 < silent_s - at_s < 2.0
    assert not bridge.status()["connected"]
    assert bridge.condition == f"no ROS router at {ROUTER} yet; ros2 run rmw_zenoh_cpp rmw_zenohd starts one"
