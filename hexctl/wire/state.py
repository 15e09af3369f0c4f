"""A robot's state on the wire: joint angles, pose and battery as ROS 2 messages, flags in the tag."""

import math
import time

import numpy as np

from hexctl.errors import MessageError
from hexctl.types import N_LEGS, BoolArray, FloatArray, RobotState
from hexctl.wire import ros
from hexctl.wire.tags import StateTag

WORLD_FRAME = "odom"
BODY_FRAME = "base_link"

MAX_AGE_US = 0xFFFFFFFF

_NO_COVARIANCE = np.zeros(36)
_NAN = math.nan


def tag_of(state: RobotState, *, sequence: int, stamp_ns: int, command_sequence: int) -> StateTag:
    """Return the tag that travels beside a state.

    Args:
        state: of the robot.
        sequence: of this state.
        stamp_ns: of the sender's clock.
        command_sequence: of the newest command that reached the servos.
    """
    return StateTag(
        sequence=sequence,
        stamp_ns=stamp_ns,
        age_us=_microseconds(state.age_s),
        command_sequence=command_sequence,
        measured=state.measured,
        healthy=state.healthy,
        contacts=None if state.foot_contacts is None else _bits(state.foot_contacts),
        fault=state.fault,
        stopped=state.stopped,
    )


def contacts_of(tag: StateTag) -> BoolArray | None:
    """Return which feet touch the floor, (6,), or None where unknown."""
    if tag.contacts is None:
        return None
    return np.array([bool(tag.contacts >> leg & 1) for leg in range(N_LEGS)])


def encode_pose(position_world: FloatArray, quaternion_world: FloatArray) -> bytes:
    """Return a pose as nav_msgs/Odometry without a twist.

    Args:
        position_world: (3,) in m.
        quaternion_world: (w, x, y, z).
    """
    x, y, z = position_world.tolist()
    w, i, j, k = quaternion_world.tolist()
    none = ros.make("geometry_msgs/msg/Vector3", x=0.0, y=0.0, z=0.0)
    pose = ros.make(
        "geometry_msgs/msg/Pose",
        position=ros.make("geometry_msgs/msg/Point", x=x, y=y, z=z),
        orientation=ros.make("geometry_msgs/msg/Quaternion", x=i, y=j, z=k, w=w),
    )
    twist = ros.make("geometry_msgs/msg/Twist", linear=none, angular=none)
    return ros.encode(
        ros.make(
            ros.ODOMETRY,
            header=ros.header(time.time_ns(), WORLD_FRAME),
            child_frame_id=BODY_FRAME,
            pose=ros.make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=_NO_COVARIANCE),
            twist=ros.make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=_NO_COVARIANCE),
        )
    )


def decode_pose(payload: bytes) -> tuple[FloatArray, FloatArray]:
    """Return position (3,) and unit quaternion (w, x, y, z) of a nav_msgs/Odometry, all finite.

    Raises MessageError for anything else.
    """
    pose = ros.decode(ros.ODOMETRY, payload).pose.pose
    position = np.array([pose.position.x, pose.position.y, pose.position.z])
    turned = pose.orientation
    quaternion = np.array([turned.w, turned.x, turned.y, turned.z])
    norm = math.hypot(*quaternion.tolist())
    if not (np.isfinite(position).all() and math.isfinite(norm) and abs(norm - 1) < 0.01):
        raise MessageError("pose: got numbers that are no pose; allowed: finite metres and a unit quaternion")
    return position, quaternion / norm


def encode_battery(voltage_v: float | None, share: float | None) -> bytes:
    """Return the battery as sensor_msgs/BatteryState; what is unknown is NaN, as that message wants."""
    return ros.encode(
        ros.make(
            ros.BATTERY_STATE,
            header=ros.header(time.time_ns()),
            voltage=_NAN if voltage_v is None else voltage_v,
            temperature=_NAN,
            current=_NAN,
            charge=_NAN,
            capacity=_NAN,
            design_capacity=_NAN,
            percentage=_NAN if share is None else share,
            power_supply_status=0,
            power_supply_health=0,
            power_supply_technology=0,
            present=voltage_v is not None or share is not None,
            cell_voltage=np.zeros(0, np.float32),
            cell_temperature=np.zeros(0, np.float32),
            location="",
            serial_number="",
        )
    )


def decode_battery(payload: bytes) -> tuple[float | None, float | None]:
    """Return voltage in V and what is left, 0 to 1, of a sensor_msgs/BatteryState; None where unknown.

    Raises MessageError for anything else.
    """
    message = ros.decode(ros.BATTERY_STATE, payload)
    voltage, share = float(message.voltage), float(message.percentage)
    return voltage if math.isfinite(voltage) else None, share if math.isfinite(share) else None


def _microseconds(age_s: float) -> int:
    """Return an age as it fits into the tag; one that is no number is as old as can be."""
    return min(max(0, round(age_s * 1e6)), MAX_AGE_US) if math.isfinite(age_s) else MAX_AGE_US


def _bits(contacts: BoolArray) -> int:
    return sum(1 << leg for leg, touches in enumerate(contacts.tolist()) if touches)
