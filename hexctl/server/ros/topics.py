"""Topics that a robot publishes in ROS 2, its diagnostics among them."""

import math
import time
from collections.abc import Callable
from functools import partial

import numpy as np
import zenoh

from hexctl.columns import SENSED
from hexctl.control.stop_reason import reason_in_words
from hexctl.robot.body_twist import BodyTwist
from hexctl.robot.formats.link_frames import BASE_LINK, fixed_transforms, link_transforms
from hexctl.robot.model import Robot
from hexctl.server.ros.frames import MAP_FRAME, Frames
from hexctl.server.snapshot import RobotSnapshot
from hexctl.types import JOINT_NAMES, TOO_HOT_C, WARM_C, RobotState, ServoReadings
from hexctl.wire import ros_cdr
from hexctl.wire.pose import WORLD_FRAME, odometry
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.odometry_error import twist_covariance
from hexctl.wire.ros.ros_names import Kind, Qos, RosEndpoint, RosNode
from hexctl.wire.ros.ros_session import RosPublisher
from hexctl.wire.ros.sensor_messages import encode_sensor, message_type
from hexctl.wire.ros.telemetry import DiagnosticStatus, Level
from hexctl.wire.zenoh_messages import encode_battery, encode_positions

LATCHED = Qos(depth=1, latched=True)

#: Sensors with a topic of their own, by name: torques and velocities of joints are in `joint_states`.
SENSORS = {
    column.topic.removeprefix("/"): column
    for column in SENSED
    if column.topic is not None and message_type(column) != ros_cdr.JOINT_STATE
}

#: Types and qualities of topics by name. `imu/data` and sensors are published once they are known.
TOPICS = {
    "joint_states": (ros_cdr.JOINT_STATE, Qos()),
    "odom": (ros_cdr.ODOMETRY, Qos()),
    "tf": (telemetry.TRANSFORMS, Qos(depth=100)),
    "tf_static": (telemetry.TRANSFORMS, LATCHED),
    "imu/data": (ros_cdr.IMU, Qos()),
    "battery_state": (ros_cdr.BATTERY_STATE, Qos()),
    "/diagnostics": (telemetry.DIAGNOSTICS, Qos()),
    "robot_description": (telemetry.STRING, LATCHED),
    **{topic: (message_type(column), Qos()) for topic, column in SENSORS.items()},
}

#: Encoder of a topic; None for unknown values.
Encoder = Callable[[RobotSnapshot], bytes | None]

#: Period of battery and diagnostics.
SLOW_S = 1.0

#: Number of the first endpoint of the node.
FIRST_PUBLISHER = 10


def publisher_endpoint(node: RosNode, topic: str) -> RosEndpoint:
    """Endpoint of one of the `TOPICS`."""
    message, qos = TOPICS[topic]
    return RosEndpoint(node, Kind.PUBLISHER, topic, message, FIRST_PUBLISHER + list(TOPICS).index(topic), qos)


class RobotMessages:
    """Encodes the messages of a robot's topics; `node` is its name in diagnostics."""

    def __init__(self, robot: Robot, urdf: str, node: str) -> None:
        self._robot, self._urdf, self._node = robot, urdf, node
        fixed, moving = fixed_transforms(robot), link_transforms(robot, robot.stance_angles_rad)
        links = moving.frames
        self._fixed_numbers = fixed.numbers
        self._fixed = telemetry.transforms(fixed.frames)
        self._links = telemetry.transforms(links)
        self._all_links = telemetry.transforms(((WORLD_FRAME, BASE_LINK), *links))
        self._on_map = telemetry.transforms(((MAP_FRAME, WORLD_FRAME), (WORLD_FRAME, BASE_LINK), *links))
        self._twist, self._frames = BodyTwist(), Frames(robot)

    def follow(self, snapshot: RobotSnapshot, *, subscribed: bool) -> None:
        """Take in every state before it is encoded; `subscribed` is whether the pose has subscribers."""
        self._frames.follow(snapshot, subscribed=subscribed)

    def description(self) -> bytes:
        """The URDF."""
        return telemetry.encode_string(self._urdf)

    def fixed_frames(self, stamp_ns: int) -> bytes:
        """Frames of the fixed links."""
        return self._fixed.encode(stamp_ns, self._fixed_numbers)

    def joint_states(self, snapshot: RobotSnapshot) -> bytes:
        """Angles, and torques and velocities if known."""
        state, stamp_ns = snapshot.state, measured_ns(snapshot)
        known = state.joint_torques_nm, state.joint_velocities_rad_s
        return encode_positions(state.joint_positions_rad, stamp_ns, *known)

    def moving_frames(self, snapshot: RobotSnapshot) -> bytes:
        """Frames of the moving links, of the body in `odom`, and of `odom` in `map`, if known."""
        links = link_transforms(self._robot, snapshot.state.joint_positions_rad).numbers
        pose, odom = self._frames.body_in_odom(snapshot), self._frames.odom_in_map(snapshot)
        stamp_ns = measured_ns(snapshot)
        if pose is None:
            return self._links.encode(stamp_ns, links)
        if odom is None:
            return self._all_links.encode(stamp_ns, np.concatenate([pose.numbers, links]))
        return self._on_map.encode(stamp_ns, np.concatenate([odom.numbers, pose.numbers, links]))

    def odometry(self, snapshot: RobotSnapshot) -> bytes | None:
        """Pose in `odom` and velocity in `base_link`, or None if unknown."""
        pose = self._frames.body_in_odom(snapshot)
        if pose is None:
            return None
        twist = self._twist.of(snapshot.state.stamp_s, pose.position_m, pose.quaternion)
        covariance, reckoned = self._frames.covariance(snapshot), snapshot.posed_at_s is not None
        numbers = [pose.numbers, twist, covariance, twist_covariance(twist, reckoned=reckoned)]
        return odometry().encode(measured_ns(snapshot), np.concatenate(numbers))

    def imu(self, snapshot: RobotSnapshot) -> bytes | None:
        """Orientation and angular velocity, or None if both are unknown."""
        orientation, rate_rad_s = snapshot.orientation, snapshot.state.angular_velocity_body_rad_s
        if orientation is None and rate_rad_s is None:
            return None
        return telemetry.encode_imu(measured_ns(snapshot), orientation, rate_rad_s)

    def sensor(self, topic: str, snapshot: RobotSnapshot) -> bytes | None:
        """Values of one of the `SENSORS`, or None if unknown."""
        column = SENSORS[topic]
        values = getattr(snapshot.state, column.source)
        return None if values is None else encode_sensor(column, measured_ns(snapshot), values)

    def battery(self, snapshot: RobotSnapshot) -> bytes:
        """Voltage and charge, NaN where unknown."""
        return encode_battery(snapshot.state.battery_v, snapshot.state.battery_share)

    def diagnostics(self, snapshot: RobotSnapshot) -> bytes:
        """Statuses of the robot and its servos."""
        found = statuses(snapshot, self._node)
        return telemetry.encode_diagnostics(found, self._robot.name, snapshot.stamp_ns)

    def silence(self) -> bytes:
        """Diagnostics of a robot with a silent control loop."""
        silent = DiagnosticStatus(Level.STALE, f"{self._node}: robot", "its control loop is silent")
        return telemetry.encode_diagnostics([silent], self._robot.name, time.time_ns())


def measured_ns(snapshot: RobotSnapshot) -> int:
    """Time of measurement of a state, nanoseconds since 1970."""
    age_s = snapshot.state.age_s
    return snapshot.stamp_ns - (round(age_s * 1e9) if 0 <= age_s < 1e6 else 0)


class RobotTopics:
    """Publishes the topics of a robot on an open session; only topics with subscribers are encoded."""

    def __init__(self, session: zenoh.Session, node: RosNode, messages: RobotMessages) -> None:
        self._session, self._node, self._messages = session, node, messages
        self._publishers = {
            topic: self._declared(topic) for topic in TOPICS if topic != "imu/data" and topic not in SENSORS
        }
        self._slow_at_s = -SLOW_S
        self._publishers["robot_description"].put(messages.description())
        self._publishers["tf_static"].put(messages.fixed_frames(time.time_ns()))

    def publish(self, snapshot: RobotSnapshot, now_s: float) -> None:
        """Publish a state, and once a second battery and diagnostics; `now_s` is on any monotonic clock."""
        turns = snapshot.orientation is not None or snapshot.state.angular_velocity_body_rad_s is not None
        if turns and "imu/data" not in self._publishers:
            self._publishers["imu/data"] = self._declared("imu/data")
        messages = self._messages
        messages.follow(
            snapshot, subscribed=any(self._publishers[topic].subscribed for topic in ("tf", "odom"))
        )
        self._put("joint_states", messages.joint_states, snapshot)
        self._put("tf", messages.moving_frames, snapshot)
        self._put("odom", messages.odometry, snapshot)
        if "imu/data" in self._publishers:
            self._put("imu/data", messages.imu, snapshot)
        for topic, column in SENSORS.items():
            if getattr(snapshot.state, column.source) is not None:
                if topic not in self._publishers:
                    self._publishers[topic] = self._declared(topic)
                self._put(topic, partial(messages.sensor, topic), snapshot)
        if now_s - self._slow_at_s >= SLOW_S:
            self._slow_at_s = now_s
            self._put("battery_state", messages.battery, snapshot)
            self._put("/diagnostics", messages.diagnostics, snapshot)

    def publish_silence(self, now_s: float) -> None:
        """Publish once a second that the robot is silent."""
        if now_s - self._slow_at_s >= SLOW_S:
            self._slow_at_s = now_s
            if self._publishers["/diagnostics"].subscribed:
                self._publishers["/diagnostics"].put(self._messages.silence())

    def _put(self, topic: str, encode: Encoder, snapshot: RobotSnapshot) -> None:
        publisher = self._publishers[topic]
        payload = encode(snapshot) if publisher.subscribed else None
        if payload is not None:
            publisher.put(payload)

    def _declared(self, topic: str) -> RosPublisher:
        return RosPublisher(self._session, publisher_endpoint(self._node, topic))


#: Age from which a servo's reading is stale.
STALE_S = 1.0


def statuses(snapshot: RobotSnapshot, node: str) -> list[DiagnosticStatus]:
    """Statuses of a robot and of its servos; `node` includes the namespace."""
    state = snapshot.state
    servos = state.servos
    joints = range(len(JOINT_NAMES))
    singles = [] if servos is None else [_servo(joint, state, servos, node) for joint in joints]
    return [_robot(snapshot, node), *singles]


def _robot(snapshot: RobotSnapshot, node: str) -> DiagnosticStatus:
    state = snapshot.state
    level, message = Level.OK, snapshot.posture
    if state.warnings:
        level, message = Level.WARN, "; ".join(state.warnings)
    if not state.age_s <= STALE_S:
        level, message = Level.STALE, state.fault or "nothing new was measured"
    if snapshot.stopped is not None:
        level, message = Level.ERROR, f"stopped: {reason_in_words(snapshot.stopped)}"
    if not state.healthy:
        level, message = Level.ERROR, state.fault or "fault"
    values = {
        "posture": snapshot.posture,
        "controller": snapshot.controller or "none",
        "joints": "measured" if state.measured else "echoed",
        **_known("battery", state.battery_v, "V"),
        **_known("charge", None if state.battery_share is None else 100 * state.battery_share, "%"),
        **_known("current", state.current_a, "A"),
    }
    return DiagnosticStatus(level, f"{node}: robot", message, values)


def _servo(joint: int, state: RobotState, servos: ServoReadings, node: str) -> DiagnosticStatus:
    temperature_c, error = float(servos.temperatures_c[joint]), servos.errors[joint]
    level, message = Level.OK, "ok"
    if temperature_c >= WARM_C:
        level, message = Level.WARN, f"warm: {temperature_c:.0f} C"
    stale = state.stale_joints is not None and bool(state.stale_joints[joint])
    if stale or not servos.ages_s[joint] <= STALE_S:
        level, message = Level.STALE, "silent"
    if temperature_c >= TOO_HOT_C:
        level, message = Level.ERROR, f"hot: {temperature_c:.0f} C"
    if error:
        level, message = Level.ERROR, error
    values = {
        **_known("temperature", temperature_c, "C"),
        **_known("voltage", float(servos.voltages_v[joint]), "V"),
        **_known("current", float(servos.currents_a[joint]), "A"),
        **_known("effort", 100 * float(servos.efforts[joint]), "%"),
    }
    return DiagnosticStatus(level, f"{node}: {JOINT_NAMES[joint]}", message, values)


def _known(name: str, value: float | None, unit: str) -> dict[str, str]:
    return {} if value is None or not math.isfinite(value) else {f"{name} ({unit})": f"{value:.4g}"}
