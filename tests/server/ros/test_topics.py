"""What the topics of a robot say, compared with its own kinematics."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from hexctl.ik.legs import foot_positions_body
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from hexctl.server.ros.snapshot import RobotSnapshot
from hexctl.server.ros.topics import TOPICS, RobotMessages, measured_ns, publisher_endpoint
from hexctl.types import RobotState
from hexctl.wire import ros_cdr
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.ros_names import RosNode
from tests.wire.ros.decoding import decoded

ROBOT = load_robot("ant")
QUATERNION = Rotation.from_euler("zyx", [0.4, 0.1, -0.05]).as_quat()[[3, 0, 1, 2]]


def snapshot(state: RobotState) -> RobotSnapshot:
    return RobotSnapshot(state, QUATERNION, stopped=None, posture="idle", controller=None, stamp_ns=10**18)


@pytest.fixture
def messages() -> RobotMessages:
    return RobotMessages(ROBOT, urdf_of(ROBOT))


def walking(angles_rad: np.ndarray) -> RobotState:
    position = np.array([1.0, 2.0, 0.1])
    return RobotState(
        angles_rad, 0.0, True, base_position_world=position, base_quaternion_world=QUATERNION, age_s=0.01
    )


def test_feet_in_tf_are_where_the_kinematics_has_them(messages: RobotMessages) -> None:
    angles_rad = np.random.default_rng(2).uniform(ROBOT.joint_lower_rad, ROBOT.joint_upper_rad)
    shown = snapshot(walking(angles_rad))
    moving = decoded(telemetry.TRANSFORMS, messages.moving_frames(shown)).transforms
    fixed = decoded(telemetry.TRANSFORMS, messages.fixed_frames(0)).transforms
    frames = {one.child_frame_id: one for one in (*moving, *fixed)}

    def place(name: str, until: str) -> tuple[np.ndarray, Rotation]:
        if name == until:
            return np.zeros(3), Rotation.identity()
        moved = frames[name].transform.translation
        turned = frames[name].transform.rotation
        at, rotation = place(frames[name].header.frame_id, until)
        own = Rotation.from_quat([turned.x, turned.y, turned.z, turned.w])
        return at + rotation.apply([moved.x, moved.y, moved.z]), rotation * own

    feet = np.array([place(f"leg{leg}_foot", "base_link")[0] for leg in range(1, 7)])
    np.testing.assert_allclose(feet, foot_positions_body(ROBOT, angles_rad), atol=1e-9)
    at, turned = place("base_link", "odom")
    np.testing.assert_allclose(at, [1.0, 2.0, 0.1])
    np.testing.assert_allclose(turned.as_quat()[[3, 0, 1, 2]], QUATERNION)


def test_a_robot_that_does_not_know_where_it_is_has_no_odometry(messages: RobotMessages) -> None:
    shown = snapshot(RobotState(ROBOT.stance_angles_rad, 0.0, False))
    assert messages.odometry(shown) is None
    names = [
        one.child_frame_id for one in decoded(telemetry.TRANSFORMS, messages.moving_frames(shown)).transforms
    ]
    assert len(names) == 18
    assert "base_link" not in names


def test_a_twist_is_in_the_frame_of_the_body(messages: RobotMessages) -> None:
    forward = Rotation.from_quat(QUATERNION[[1, 2, 3, 0]]).apply([0.1, 0.0, 0.0])
    for index in range(10):
        state = RobotState(
            ROBOT.stance_angles_rad,
            0.02 * index,
            True,
            base_position_world=0.02 * index * forward,
            base_quaternion_world=QUATERNION,
        )
        payload = messages.odometry(snapshot(state))
    assert payload is not None
    linear = decoded(ros_cdr.ODOMETRY, payload).twist.twist.linear
    np.testing.assert_allclose([linear.x, linear.y, linear.z], [0.1, 0.0, 0.0], atol=1e-9)


def test_stamps_are_those_of_the_measurement(messages: RobotMessages) -> None:
    shown = snapshot(walking(ROBOT.stance_angles_rad))
    assert measured_ns(shown) == 10**18 - 10_000_000
    stamp = decoded(ros_cdr.JOINT_STATE, messages.joint_states(shown)).header.stamp
    assert stamp.sec * 10**9 + stamp.nanosec == 10**18 - 10_000_000


def test_an_orientation_that_is_not_known_is_not_sent(messages: RobotMessages) -> None:
    none = RobotSnapshot(
        walking(ROBOT.stance_angles_rad), None, stopped=None, posture="idle", controller=None
    )
    assert messages.imu(none) is None


def test_endpoints_have_numbers_of_their_own() -> None:
    endpoints = [publisher_endpoint(RosNode(), topic) for topic in TOPICS]
    assert len({one.entity_id for one in endpoints}) == len(TOPICS)


def test_robots_of_two_namespaces_are_told_apart_in_the_diagnostics() -> None:
    messages = RobotMessages(ROBOT, "", RosNode(namespace="lab/ant").full_name)
    told = messages.diagnostics(snapshot(walking(ROBOT.stance_angles_rad)))
    for payload in (told, messages.silence()):
        assert decoded(telemetry.DIAGNOSTICS, payload).status[0].name == "lab/ant/hexctl: robot"
    alone = RobotMessages(ROBOT, "", RosNode().full_name).silence()
    assert decoded(telemetry.DIAGNOSTICS, alone).status[0].name == "hexctl: robot"
