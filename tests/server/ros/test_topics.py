"""Topics of a robot: frames map -> odom -> base_link, dead reckoning, diagnostics, and the router's port."""

from dataclasses import dataclass, field, replace
from typing import Any
from unittest.mock import MagicMock

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexctl.errors import InputError
from hexctl.ik.legs import foot_positions_body
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.rotations import about_z, product, turned, wrapped_rad, yaw_rad
from hexctl.server.ros.frames import DeadReckoning, FramePose
from hexctl.server.ros.topics import (
    SENSORS,
    TOPICS,
    RobotMessages,
    RobotTopics,
    measured_ns,
    publisher_endpoint,
    statuses,
)
from hexctl.server.service import ENDPOINT_BESIDE_ROUTER, link_beside_router, router_warnings
from hexctl.server.snapshot import RobotSnapshot
from hexctl.types import N_JOINTS, FloatArray, RobotState, ServoReadings
from hexctl.wire import ros_cdr
from hexctl.wire.links import load_link
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.ros_names import RosEndpoint, RosNode
from hexctl.wire.ros.telemetry import Level
from tests.driven import Driven, driven
from tests.robots import shipped
from tests.server.bench import stopped_for
from tests.wire.ros.decoding import decoded

ROBOT = shipped()

#: Parent and transform by child.
Frames = dict[str, tuple[str, FramePose]]


def robot_messages() -> RobotMessages:
    return RobotMessages(ROBOT, urdf_of(ROBOT), "hexctl")


def frames(payload: bytes) -> Frames:
    found = {}
    for one in decoded(telemetry.TRANSFORMS, payload).transforms:
        at, turn = one.transform.translation, one.transform.rotation
        pose = FramePose(np.array([at.x, at.y, at.z]), np.array([turn.w, turn.x, turn.y, turn.z]))
        found[one.child_frame_id] = (one.header.frame_id, pose)
    return found


#: Turned by 0.4, 0.1 and -0.05 rad about z, y and x.
QUATERNION = np.array([0.978784085054, -0.014542269399, 0.053927616469, 0.197134597238])


def snapshot(state: RobotState) -> RobotSnapshot:
    return RobotSnapshot(state=state, orientation=QUATERNION, stamp_ns=10**18)


@pytest.fixture
def messages() -> RobotMessages:
    return robot_messages()


def walking(angles_rad: np.ndarray) -> RobotState:
    position = np.array([1.0, 2.0, 0.1])
    return RobotState(
        angles_rad, 0.0, True, base_position_world=position, base_quaternion_world=QUATERNION, age_s=0.01
    )


def test_feet_in_tf_are_where_the_kinematics_has_them(messages: RobotMessages) -> None:
    angles_rad = np.random.default_rng(2).uniform(ROBOT.joint_lower_rad, ROBOT.joint_upper_rad)
    shown = snapshot(walking(angles_rad))
    found = frames(messages.moving_frames(shown)) | frames(messages.fixed_frames(0))

    def place(name: str, until: str) -> tuple[FloatArray, Rotation]:
        if name == until:
            return np.zeros(3), Rotation.identity()
        parent, pose = found[name]
        at, rotation = place(parent, until)
        own = Rotation.from_quat(pose.quaternion, scalar_first=True)
        return at + rotation.apply(pose.position_m), rotation * own

    feet = np.array([place(f"leg{leg}_foot", "base_link")[0] for leg in range(1, 7)])
    np.testing.assert_allclose(feet, foot_positions_body(ROBOT, angles_rad), atol=1e-9)
    at, rotation = place("base_link", "odom")
    np.testing.assert_allclose(at, [1.0, 2.0, 0.1])
    np.testing.assert_allclose(rotation.as_quat(scalar_first=True), QUATERNION)


def test_a_robot_that_does_not_know_where_it_is_has_no_odometry(messages: RobotMessages) -> None:
    shown = snapshot(RobotState(ROBOT.stance_angles_rad, 0.0, False))
    assert messages.odometry(shown) is None
    found = frames(messages.moving_frames(shown))
    assert len(found) == 18
    assert "base_link" not in found


def test_stamps_are_those_of_the_measurement(messages: RobotMessages) -> None:
    shown = snapshot(walking(ROBOT.stance_angles_rad))
    assert measured_ns(shown) == 10**18 - 10_000_000
    stamp = decoded(ros_cdr.JOINT_STATE, messages.joint_states(shown)).header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == 10**18 - 10_000_000


def test_sensors_are_sent_if_known(messages: RobotMessages) -> None:
    state = walking(ROBOT.stance_angles_rad)
    assert [messages.sensor(topic, snapshot(state)) for topic in SENSORS] == [None] * len(SENSORS)
    feet, rates = np.arange(6) % 2 == 0, np.array([0.1, -0.2, 0.3])
    known = replace(
        state,
        foot_contacts=feet,
        angular_velocity_body_rad_s=rates,
        joint_velocities_rad_s=np.arange(18.0),
    )
    found = {topic: messages.sensor(topic, snapshot(known)) or b"" for topic in SENSORS}
    assert found.keys() == {"foot_contacts"}
    touching = decoded("std_msgs/msg/UInt8MultiArray", found["foot_contacts"])
    assert list(touching.data) == feet.tolist()
    for shown in (snapshot(known), RobotSnapshot(state=known)):
        imu = decoded(ros_cdr.IMU, messages.imu(shown) or b"")
        assert (imu.header.frame_id, imu.angular_velocity.z) == ("base_link", 0.3)
        assert imu.orientation_covariance[0] == (-1 if shown.orientation is None else 0)
    joints = decoded(ros_cdr.JOINT_STATE, messages.joint_states(snapshot(known)))
    assert list(joints.velocity) == list(range(18))


@pytest.mark.parametrize("without", ["", "odom"])
def test_subscribers_get_each_known_topic_at_its_rate_and_hear_of_silence(
    without: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Five states within two seconds, the last two with orientation and contacts; then it is silent."""
    got: dict[str, list[bytes]] = {}

    class Publisher:
        def __init__(self, _session: object, endpoint: RosEndpoint) -> None:
            self.subscribed = endpoint.topic != without
            self.put = got.setdefault(endpoint.topic, []).append

    monkeypatch.setattr("hexctl.server.ros.topics.RosPublisher", Publisher)
    topics = RobotTopics(MagicMock(), RosNode(), robot_messages())
    shown = RobotSnapshot(state=replace(walking(ROBOT.stance_angles_rad), base_quaternion_world=None))
    for now_s in (0.0, 0.5, 0.9):
        topics.publish(shown, now_s)
    assert not got.keys() & {"imu/data", "foot_contacts"}
    shown = snapshot(replace(walking(ROBOT.stance_angles_rad), foot_contacts=np.ones(6, bool)))
    for now_s in (1.1, 1.9, 2.2):
        topics.publish(shown, now_s) if now_s < 2 else topics.publish_silence(now_s)
    topics.publish_silence(2.3)
    counts = {"joint_states": 5, "tf": 5, "odom": 2, "imu/data": 2, "foot_contacts": 2, "battery_state": 2}
    counts |= {"/diagnostics": 3, "tf_static": 1, "robot_description": 1}
    assert {topic: len(got[topic]) for topic in got if topic != without} == {
        topic: count for topic, count in counts.items() if topic != without
    }
    assert not got.get(without)
    levels = [decoded(telemetry.DIAGNOSTICS, one).status[0].level for one in got["/diagnostics"]]
    assert levels == [Level.OK, Level.OK, Level.STALE]


def test_endpoints_have_numbers_of_their_own_and_no_unknown_orientation_is_sent(
    messages: RobotMessages,
) -> None:
    state = walking(ROBOT.stance_angles_rad)
    assert messages.imu(RobotSnapshot(state=state)) is None
    endpoints = [publisher_endpoint(RosNode(), topic) for topic in TOPICS]
    assert len({one.entity_id for one in endpoints}) == len(TOPICS)


SERVOS = ServoReadings(
    ages_s=np.zeros(N_JOINTS),
    efforts=np.zeros(N_JOINTS),
    currents_a=np.full(N_JOINTS, np.nan),
    voltages_v=np.full(N_JOINTS, 7.4),
    temperatures_c=np.full(N_JOINTS, 35.0),
)
STATE = RobotState(np.zeros(N_JOINTS), 0.0, True, servos=SERVOS, battery_v=11.1, battery_share=0.5)


def told(state: RobotState, stopped: str | None = None) -> RobotSnapshot:
    return RobotSnapshot(state=state, stop=stopped_for(stopped), posture="commanded", controller="me")


def test_all_is_well() -> None:
    robot, *servos = statuses(told(STATE), "hexctl")
    assert robot.level is Level.OK
    assert (robot.values["battery (V)"], robot.values["charge (%)"]) == ("11.1", "50")
    assert len(servos) == N_JOINTS
    assert servos[3].name == "hexctl: leg2_coxa"
    assert servos[3].values == {"temperature (C)": "35", "voltage (V)": "7.4", "effort (%)": "0"}
    assert len(statuses(told(replace(STATE, servos=None)), "hexctl")) == 1


@pytest.mark.parametrize(
    ("change", "stopped", "level", "word"),
    [
        ({"warnings": ("leg 2: low voltage",)}, None, Level.WARN, "low voltage"),
        ({"age_s": np.inf}, None, Level.STALE, "nothing new"),
        ({}, "fell", Level.ERROR, "stopped: fell (its body leant too far)"),
        ({"healthy": False, "fault": "no power"}, None, Level.ERROR, "no power"),
    ],
)
def test_levels_of_a_robot(change: dict[str, object], stopped: str | None, level: Level, word: str) -> None:
    robot = statuses(told(replace(STATE, **change), stopped), "hexctl")[0]  # type: ignore[arg-type]
    assert (robot.level, word in robot.message) == (level, True)


@pytest.mark.parametrize(
    ("temperature_c", "age_s", "error", "level"),
    [
        (35.0, 0.0, "stale", Level.STALE),
        (62.0, 0.0, "", Level.WARN),
        (69.0, 0.0, "", Level.ERROR),
        (35.0, np.inf, "", Level.STALE),
        (35.0, 0.0, "overload", Level.ERROR),
        (np.nan, 0.0, "", Level.OK),
    ],
)
def test_levels_of_a_servo(temperature_c: float, age_s: float, error: str, level: Level) -> None:
    temperatures, ages = SERVOS.temperatures_c.copy(), SERVOS.ages_s.copy()
    temperatures[4], ages[4] = temperature_c, age_s
    stale = np.arange(N_JOINTS) == 4 if error == "stale" else None
    errors = tuple(error if joint == 4 and stale is None else "" for joint in range(N_JOINTS))
    servos = replace(SERVOS, temperatures_c=temperatures, ages_s=ages, errors=errors)
    levels = [
        status.level
        for status in statuses(told(replace(STATE, servos=servos, stale_joints=stale)), "hexctl")[1:]
    ]
    assert levels == [level if joint == 4 else Level.OK for joint in range(N_JOINTS)]


ROUTER = "tcp/localhost:7447"


def test_the_default_port_is_left_to_the_router() -> None:
    assert link_beside_router(load_link(), ROUTER).endpoint == ENDPOINT_BESIDE_ROUTER
    for endpoint in ("tcp/127.0.0.1:7447", "tcp/0.0.0.0:7447", "tls/localhost:7447"):
        with pytest.raises(InputError, match="7448"):
            link_beside_router(load_link(connect=endpoint), ROUTER)
    other = load_link(connect="tcp/127.0.0.1:7500")
    assert link_beside_router(other, ROUTER) == other
    assert link_beside_router(load_link(), "tcp/10.0.0.2:7447") == load_link()


def test_it_is_warned_who_may_stop_and_drive() -> None:
    beside, may = router_warnings(link_beside_router(load_link(), ROUTER), ROUTER, drive=False)
    assert "7448" in beside
    assert "may stop" in may
    (may,) = router_warnings(load_link(connect="tcp/127.0.0.1:7500"), ROUTER, drive=True)
    assert "may drive" in may


ROLLED = np.array([np.cos(0.05), np.sin(0.05), 0.0, 0.0])
START = FramePose(np.array([1.0, 2.0, 0.1]), product(about_z(0.4), ROLLED))


@pytest.fixture(scope="module")
def walk() -> Driven:
    return walked()


def walked() -> Driven:
    return driven("ant", ((1, 0, 0, 0), (4, 0.8, 0, 0.4)))


def state(walk: Driven, index: int) -> RobotState:
    return RobotState(walk.joints_rad[index], walk.times_s[index], True)


def imu(walk: Driven, index: int) -> FloatArray:
    """What an IMU measures that began elsewhere, on a body that leans."""
    return product(about_z(walk.poses[index, 2] + 2.9), ROLLED)


def away(walk: Driven) -> complex:
    """True way from the first to the last place, in the frame of the first."""
    moved = (walk.poses[-1] - walk.poses[0])[:2] @ np.array([1, 1j])
    return complex(moved * np.exp(-1j * walk.poses[0, 2]))


@pytest.mark.parametrize("with_imu", [True, False])
def test_a_walk_goes_on_from_where_it_began(walk: Driven, with_imu: bool) -> None:
    reckoning = DeadReckoning(ROBOT, START)
    poses = [
        reckoning.update(state(walk, index), imu(walk, index) if with_imu else None)
        for index in range(len(walk.times_s))
    ]
    np.testing.assert_array_equal(poses[0].position_m, START.position_m)
    np.testing.assert_allclose(poses[0].quaternion, START.quaternion, atol=1e-12)
    moved = complex(*(poses[-1].position_m - START.position_m)[:2]) * np.exp(-0.4j)
    assert abs(moved - away(walk)) < 0.06 * abs(away(walk))
    turned = wrapped_rad(float(yaw_rad(poses[-1].quaternion)) - 0.4)
    true = walk.poses[-1, 2] - walk.poses[0, 2]
    assert turned == pytest.approx(true, abs=1e-9 if with_imu else 0.15 * abs(true))
    steps_m = np.linalg.norm(np.diff([one.position_m for one in poses], axis=0), axis=1)
    assert steps_m.max() < 0.012
    rise_m = [one.position_m[2] - START.position_m[2] for one in poses]
    np.testing.assert_allclose(rise_m, walk.height_m - walk.height_m[0], atol=0.004)


def test_an_orientation_that_is_not_finite_leaves_the_pose(walk: Driven) -> None:
    reckoning = DeadReckoning(ROBOT, START)
    before = reckoning.update(state(walk, 100), imu(walk, 100))
    reckoning.update(state(walk, 101), np.full(4, np.nan))
    after = reckoning.update(state(walk, 102), imu(walk, 102))
    assert np.linalg.norm(after.position_m - before.position_m) < 0.01
    np.testing.assert_allclose(after.quaternion, before.quaternion, atol=0.02)


#: Turn and shift from the frame of the robot's own pose to that of the one from outside.
SHIFT_M, TURN = np.array([3.0, -1.0, 0.0]), about_z(2.0)

LEAN = np.array([np.cos(0.04), 0.0, np.sin(0.04), 0.0])


@dataclass
class Walker:
    """A robot that walks, of which a state comes in every control period."""

    messages: RobotMessages = field(default_factory=robot_messages)
    index: int = 0
    has_imu: bool = True
    last: RobotSnapshot | None = None

    def true_pose(self) -> FramePose:
        walk = walked()
        x_m, y_m, yaw = walk.poses[self.index]
        return FramePose(np.array([x_m, y_m, walk.height_m[self.index]]), product(about_z(yaw), LEAN))

    def next(self, pose: FramePose | None, posed_at_s: float | None) -> Frames:
        """Frames after one more state: parent and transform by child."""
        walk = walked()
        state = RobotState(
            walk.joints_rad[self.index],
            walk.times_s[self.index],
            True,
            base_position_world=None if pose is None else pose.position_m,
            base_quaternion_world=None if pose is None else pose.quaternion,
        )
        orientation = self.true_pose().quaternion if self.has_imu else None
        self.last = RobotSnapshot(state=state, orientation=orientation, posed_at_s=posed_at_s)
        self.index += 1
        self.messages.follow(self.last, subscribed=True)
        return frames(self.messages.moving_frames(self.last))

    def own(self) -> Frames:
        """Frames after a state with a pose of the robot's own."""
        return self.next(self.true_pose(), None)

    def outside(self, jump_m: FloatArray | float = 0.0, *, level: bool = False) -> FramePose:
        true = self.true_pose()
        quaternion = about_z(float(yaw_rad(true.quaternion))) if level else true.quaternion
        return FramePose(SHIFT_M + turned(TURN, true.position_m) + jump_m, product(TURN, quaternion))

    def posed(self, pose: FramePose | None) -> Frames:
        """Frames after a state with a pose from outside that is new, or lost for None."""
        at_s = self.last.posed_at_s if pose is None and self.last is not None else float(self.index)
        return self.next(pose, at_s)


def in_map(found: Frames) -> FramePose:
    """Pose of `base_link` in `map`."""
    (of_odom, odom), (of_body, body) = found["odom"], found["base_link"]
    assert (of_odom, of_body) == ("map", "odom")
    quaternion = product(odom.quaternion, body.quaternion)
    return FramePose(odom.position_m + turned(odom.quaternion, body.position_m), quaternion)


def same(one: FramePose, other: FramePose) -> None:
    np.testing.assert_allclose(one.position_m, other.position_m, atol=1e-6)
    assert abs(one.quaternion @ other.quaternion) == pytest.approx(1.0, abs=1e-12)


@pytest.mark.parametrize("has_imu", [True, False])
def test_a_pose_from_outside_is_in_map_and_odom_goes_on(has_imu: bool) -> None:
    walker = Walker(has_imu=has_imu, index=60)
    before = walker.own()["base_link"][1]
    for _ in range(100):
        pose = walker.outside()
        found = walker.posed(pose)
        same(in_map(found), pose)
        after = found["base_link"][1]
        assert np.linalg.norm(after.position_m - before.position_m) < 0.012
        assert abs(after.quaternion @ before.quaternion) > np.cos(0.02)
        before = after


def test_a_jump_from_outside_is_one_of_map_to_odom_alone() -> None:
    found = []
    for jump_m in (np.zeros(3), np.array([0.5, -0.3, 0.0])):
        walker = Walker(index=60)
        walker.own()
        walker.posed(walker.outside())
        pose = walker.outside(jump_m)
        found.append(walker.posed(pose))
        same(in_map(found[-1]), pose)
    (_, calm), (_, jumped) = (one["base_link"] for one in found)
    np.testing.assert_array_equal(calm.numbers, jumped.numbers)
    moved_m = found[1]["odom"][1].position_m - found[0]["odom"][1].position_m
    np.testing.assert_allclose(moved_m, [0.5, -0.3, 0.0], atol=1e-9)


def test_while_the_pose_is_lost_map_stays_and_the_legs_go_on() -> None:
    walker = Walker(index=80)
    walker.own()
    known = walker.posed(walker.outside())
    for _ in range(50):
        true = walker.outside()
        lost = walker.posed(None)
        np.testing.assert_array_equal(lost["odom"][1].numbers, known["odom"][1].numbers)
    assert np.linalg.norm(true.position_m - in_map(known).position_m) > 0.05
    assert np.linalg.norm(true.position_m - in_map(lost).position_m) < 0.01
    before, pose = lost["base_link"][1], walker.outside(np.array([0.1, 0.0, 0.0]))
    found = walker.posed(pose)
    same(in_map(found), pose)
    assert np.linalg.norm(found["base_link"][1].position_m - before.position_m) < 0.012


def test_a_camera_sees_no_roll_and_pitch_which_stay_the_robots_own() -> None:
    walker = Walker(index=60)
    walker.own()
    for _ in range(20):
        true, pose = walker.outside(), walker.outside(level=True)
        found = walker.posed(pose)
        np.testing.assert_allclose(in_map(found).position_m, pose.position_m, atol=1e-6)
        same(in_map(found), true)
        np.testing.assert_allclose(found["odom"][1].quaternion[1:3], 0, atol=1e-15)


def test_without_an_own_pose_odom_begins_at_the_origin() -> None:
    walker = Walker(has_imu=False)
    first = walker.posed(None)
    assert "odom" not in first
    np.testing.assert_array_equal(first["base_link"][1].position_m, np.zeros(3))
    pose = walker.outside()
    same(in_map(walker.posed(pose)), pose)


def odometry(walker: Walker) -> tuple[Any, FloatArray]:
    """Odometry as it is sent, and its standard deviations of x, y, z in m and roll, pitch, yaw in rad."""
    assert walker.last is not None
    message = walker.messages.odometry(walker.last)
    assert message is not None
    told = decoded(ros_cdr.ODOMETRY, message)
    matrix = np.array(told.pose.covariance).reshape(6, 6)
    twist = np.diag(np.array(told.twist.covariance).reshape(6, 6))
    assert (np.diag(matrix) > 0).all()
    assert (twist > 0).all()
    assert not (matrix - np.diag(np.diag(matrix))).any()
    return told, np.sqrt(np.diag(matrix))


@pytest.mark.parametrize("has_imu", [True, False])
def test_odometry_is_dead_reckoning_and_its_covariance_grows_and_covers_its_error(has_imu: bool) -> None:
    walker = Walker(index=60, has_imu=has_imu)
    walker.own()
    assert odometry(walker)[1][0] == pytest.approx(0.003)
    found: list[FloatArray] = []
    for jump_m in np.linspace(0, 1, 100):
        body = walker.posed(walker.outside(np.array([jump_m, 0, 0])))["base_link"][1]
        told, errors = odometry(walker)
        found.append(errors)
    assert (told.header.frame_id, told.child_frame_id) == ("odom", "base_link")
    at = told.pose.pose.position
    np.testing.assert_array_equal([at.x, at.y, at.z], body.position_m)
    assert 0.03 < told.twist.twist.linear.x < 0.3
    assert abs(told.twist.twist.linear.y) < 0.1
    way = walked().poses[60:160, :2]
    moved_m = np.linalg.norm(np.diff(way, axis=0), axis=1).sum()
    assert (np.diff(found, axis=0) >= 0).all()
    assert 0.08 * moved_m < found[-1][0] < 0.3 * moved_m
    assert found[-1][5] < 0.02 if has_imu else found[-1][5] > 0.02


@pytest.mark.parametrize(
    ("world", "share"),
    [("flat", (0, 0, 1)), ("flat", (1, 0, 0)), ("rough", (1, 0, 0)), ("real:2", (0, 1, 0))],
)
def test_walks_are_off_by_no_more_than_three_deviations(world: str, share: tuple[int, int, int]) -> None:
    walk = driven("ant", ((1, 0, 0, 0), (4, *share)), world=world)
    reckoning = DeadReckoning(ROBOT)
    for index in range(len(walk.times_s)):
        pose = reckoning.update(state(walk, index), None)
    off_m = abs(complex(*pose.position_m[:2])) - abs(away(walk))
    off_rad = float(yaw_rad(pose.quaternion)) - (walk.poses[-1, 2] - walk.poses[0, 2])
    sigma = np.sqrt(np.diag(reckoning.error.covariance(imu=False).reshape(6, 6)))
    assert abs(off_m) < 3 * sigma[0]
    assert abs(np.remainder(off_rad + np.pi, 2 * np.pi) - np.pi) < 3 * sigma[5]
