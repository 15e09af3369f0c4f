"""A recorded trial as MCAP, in messages for ROS 2, Foxglove, PlotJuggler and Rerun."""

import heapq
import json
import shutil
from collections.abc import Iterable, Iterator
from contextlib import suppress
from functools import cache
from pathlib import Path
from typing import Any, Final

import numpy as np

from hexctl.recording.recorded_trial import RecordedTrial, Samples
from hexctl.robot.body_twist import body_twists
from hexctl.robot.formats.link_frames import BASE_LINK, LinkTransforms, fixed_transforms, link_transforms
from hexctl.robot.formats.urdf import urdf_of
from hexctl.scratch import scratch_folder
from hexctl.types import JOINT_NAMES, N_LEGS, FloatArray

#: Version of the bag's metadata. From 9 on QoS profiles are a list, and Humble, which reads a text, ends.
BAG_VERSION: Final = 8

#: The frame of the base's pose.
ODOM = "odom"

#: Types of topics, and whether late subscribers get the last message. Names of commands are not those of a
#: robot: a replayed bag must not drive one.
TOPICS: dict[str, tuple[str, bool]] = {
    "/robot_description": ("std_msgs/msg/String", True),
    "/tf_static": ("tf2_msgs/msg/TFMessage", True),
    "/tf": ("tf2_msgs/msg/TFMessage", False),
    "/joint_states": ("sensor_msgs/msg/JointState", False),
    "/recorded/joint_commands": ("sensor_msgs/msg/JointState", False),
    "/recorded/velocity_command": ("geometry_msgs/msg/TwistStamped", False),
    "/joint_torques": ("sensor_msgs/msg/JointState", False),
    "/odom": ("nav_msgs/msg/Odometry", False),
    "/imu/data": ("sensor_msgs/msg/Imu", False),
    "/foot_contacts": ("std_msgs/msg/UInt8MultiArray", False),
    "/battery_state": ("sensor_msgs/msg/BatteryState", False),
    "/diagnostics": ("diagnostic_msgs/msg/DiagnosticArray", False),
    "/rosout": ("rcl_interfaces/msg/Log", False),
}

#: Levels of rcl_interfaces/Log.
LOG_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40}

#: Covariance of an unmeasured quantity (REP 145).
UNMEASURED = np.array([-1.0, *[0.0] * 8])

#: Names of servo readings in diagnostics.
READING_NAMES = {
    "temperatures_c": "temperature (C)",
    "voltages_v": "voltage (V)",
    "currents_a": "current (A)",
    "ages_s": "age of the angle (s)",
}

NS = 1_000_000_000

#: Time, topic and message.
Stamped = tuple[int, str, Any]


def write_mcap(trial: RecordedTrial, path: Path) -> None:
    """Write a trial to a new MCAP file if `path` ends in `.mcap`, else to a folder for `ros2 bag play`."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with scratch_folder(path.parent, path.stem) as draft:
        bag = draft / path.stem
        _write_bag(trial, bag)
        source = bag / f"{bag.name}.mcap" if path.suffix == ".mcap" else bag
        with suppress(FileNotFoundError):
            shutil.move(source, path)


def _write_bag(trial: RecordedTrial, folder: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
    # The compression inside of the file is the only one that all readers support.
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    for name, value in trial.properties.items():
        writer.set_custom_data(name, json.dumps(value))
    store = _store()
    with writer:
        connections: dict[str, Any] = {}
        for stamp_ns, topic, content in _contents(trial):
            if topic not in connections:
                kind, kept = TOPICS[topic]
                qos = [_kept_qos()] if kept else []
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=store, offered_qos_profiles=qos
                )
            writer.write(connections[topic], stamp_ns, content)


def _contents(trial: RecordedTrial) -> Iterator[tuple[int, str, bytes]]:
    yield from _serialized(_kept(trial))
    parts = (
        _tf(trial),
        _joints(trial, "/joint_states", trial.measured_rad),
        _joints(trial, "/recorded/joint_commands", trial.commanded_rad),
        _odometry(trial),
        _imu(trial),
        _commands(trial),
        _torques(trial),
        _contacts(trial),
        _battery(trial),
        _diagnostics(trial),
        _log(trial),
    )
    yield from heapq.merge(*map(_serialized, parts), key=lambda one: one[0])


def _serialized(part: Iterator[Stamped]) -> Iterator[tuple[int, str, bytes]]:
    store = _store()
    for stamp_ns, topic, message in part:
        yield stamp_ns, topic, store.serialize_cdr(message, message.__msgtype__)


def _kept(trial: RecordedTrial) -> Iterator[Stamped]:
    start_ns, static = int(trial.stamps_ns[0]), fixed_transforms(trial.robot)
    yield start_ns, "/robot_description", _make("std_msgs/msg/String", data=urdf_of(trial.robot))
    yield start_ns, "/tf_static", _transforms(list(_links(_stamp(start_ns), static, static.quaternions)))


@cache
def _store() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def _make(kind: str, **fields: Any) -> Any:
    return _store().types[kind](**fields)


def _kept_qos() -> Any:
    """Reliable and transient local, with a depth of one: late subscribers get the last message."""
    from rosbags.interfaces import (
        Qos,
        QosDurability,
        QosHistory,
        QosLiveliness,
        QosReliability,
        QosTime,
    )

    forever = QosTime(9223372036, 854775807)
    return Qos(
        history=QosHistory.KEEP_LAST,
        depth=1,
        reliability=QosReliability.RELIABLE,
        durability=QosDurability.TRANSIENT_LOCAL,
        deadline=forever,
        lifespan=forever,
        liveliness=QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )


def _header(stamp: Any, frame: str = "") -> Any:
    return _make("std_msgs/msg/Header", stamp=stamp, frame_id=frame)


def _stamp(stamp_ns: int) -> Any:
    seconds, rest = divmod(stamp_ns, NS)
    return _make("builtin_interfaces/msg/Time", sec=seconds, nanosec=rest)


def _vector(values: Iterable[float]) -> Any:
    x, y, z = values
    return _make("geometry_msgs/msg/Vector3", x=x, y=y, z=z)


def _quaternion(wxyz: Iterable[float]) -> Any:
    w, x, y, z = wxyz
    return _make("geometry_msgs/msg/Quaternion", x=x, y=y, z=z, w=w)


def _short(values: FloatArray) -> FloatArray:
    """Derived values to seven digits, which compress well."""
    return values.astype(np.float32).astype(np.float64)


def _tf(trial: RecordedTrial) -> Iterator[Stamped]:
    """Parts of the message are reused from tick to tick, because 30 s have 30,000."""
    links = link_transforms(trial.robot, trial.measured_rad)
    stamp, at, turn = _stamp(0), _vector((0.0, 0.0, 0.0)), _quaternion((1.0, 0.0, 0.0, 0.0))
    base = _placed(_header(stamp, ODOM), BASE_LINK, at, turn)
    moving = list(_links(stamp, links, links.quaternions[0]))
    turns = [one.transform.rotation for one in moving]
    poses = zip(trial.posed, trial.base_position_world, trial.base_quaternion_world, strict=True)
    for stamp_ns, quaternions, (posed, position_m, orientation) in zip(
        trial.stamps_ns.tolist(), _short(links.quaternions), poses, strict=True
    ):
        stamp.sec, stamp.nanosec = divmod(stamp_ns, NS)
        at.x, at.y, at.z = position_m.tolist()
        turn.w, turn.x, turn.y, turn.z = orientation.tolist()
        for one, (w, x, y, z) in zip(turns, quaternions.tolist(), strict=True):
            one.w, one.x, one.y, one.z = w, x, y, z
        yield stamp_ns, "/tf", _transforms([base, *moving] if posed else moving)


def _links(stamp: Any, links: LinkTransforms, quaternions: FloatArray) -> Iterator[Any]:
    headers = {parent: _header(stamp, parent) for parent in set(links.parents)}
    places = zip(links.translations_m.tolist(), quaternions.tolist(), strict=True)
    for parent, child, (at, turn) in zip(links.parents, links.children, places, strict=True):
        yield _placed(headers[parent], child, _vector(at), _quaternion(turn))


def _placed(header: Any, child: str, at: Any, turn: Any) -> Any:
    transform = _make("geometry_msgs/msg/Transform", translation=at, rotation=turn)
    return _make(
        "geometry_msgs/msg/TransformStamped", header=header, child_frame_id=child, transform=transform
    )


def _transforms(transforms: list[Any]) -> Any:
    return _make("tf2_msgs/msg/TFMessage", transforms=transforms)


def _joints(trial: RecordedTrial, topic: str, angles_rad: FloatArray) -> Iterator[Stamped]:
    names, none = list(JOINT_NAMES), np.empty(0)
    for stamp_ns, angles in zip(trial.stamps_ns.tolist(), angles_rad, strict=True):
        yield stamp_ns, topic, _joint_state(stamp_ns, names, angles, none)


def _joint_state(stamp_ns: int, names: list[str], angles_rad: FloatArray, torques_nm: FloatArray) -> Any:
    return _make(
        "sensor_msgs/msg/JointState",
        header=_header(_stamp(stamp_ns)),
        name=names,
        position=angles_rad,
        velocity=np.empty(0),
        effort=torques_nm,
    )


def _torques(trial: RecordedTrial) -> Iterator[Stamped]:
    names, none = list(JOINT_NAMES), np.empty(0)
    for stamp_ns, torques_nm in _stamped(trial, trial.torques_nm):
        yield stamp_ns, "/joint_torques", _joint_state(stamp_ns, names, none, torques_nm)


def _odometry(trial: RecordedTrial) -> Iterator[Stamped]:
    """Pose in `odom` as recorded; the twist in `base_link` is its derivative."""
    rows = np.flatnonzero(trial.posed)
    if rows.size < 2:
        return
    times_s, positions_world = trial.time_s[rows], trial.base_position_world[rows]
    linear, angular = map(_short, body_twists(times_s, positions_world, trial.base_quaternion_world[rows]))
    unknown = np.zeros(36)
    for index, row in enumerate(rows.tolist()):
        stamp_ns = int(trial.stamps_ns[row])
        x, y, z = trial.base_position_world[row].tolist()
        pose = _make(
            "geometry_msgs/msg/Pose",
            position=_make("geometry_msgs/msg/Point", x=x, y=y, z=z),
            orientation=_quaternion(trial.base_quaternion_world[row].tolist()),
        )
        twist = _make(
            "geometry_msgs/msg/Twist",
            linear=_vector(linear[index].tolist()),
            angular=_vector(angular[index].tolist()),
        )
        message = _make(
            "nav_msgs/msg/Odometry",
            header=_header(_stamp(stamp_ns), ODOM),
            child_frame_id=BASE_LINK,
            pose=_make("geometry_msgs/msg/PoseWithCovariance", pose=pose, covariance=unknown),
            twist=_make("geometry_msgs/msg/TwistWithCovariance", twist=twist, covariance=unknown),
        )
        yield stamp_ns, "/odom", message


def _imu(trial: RecordedTrial) -> Iterator[Stamped]:
    """For a robot without a position, whose orientation has no other topic."""
    if trial.posed.any():
        return
    known = np.isfinite(trial.base_quaternion_world).all(axis=-1)
    if not (trial.base_quaternion_world[known] != (1.0, 0.0, 0.0, 0.0)).any():
        return
    nothing, unknown = _vector((0.0, 0.0, 0.0)), np.zeros(9)
    for row in np.flatnonzero(known).tolist():
        stamp_ns = int(trial.stamps_ns[row])
        message = _make(
            "sensor_msgs/msg/Imu",
            header=_header(_stamp(stamp_ns), BASE_LINK),
            orientation=_quaternion(trial.base_quaternion_world[row].tolist()),
            orientation_covariance=unknown,
            angular_velocity=nothing,
            angular_velocity_covariance=UNMEASURED,
            linear_acceleration=nothing,
            linear_acceleration_covariance=UNMEASURED,
        )
        yield stamp_ns, "/imu/data", message


def _commands(trial: RecordedTrial) -> Iterator[Stamped]:
    for stamp_ns, (forward, left, turn) in _stamped(trial, trial.velocity_body):
        twist = _make(
            "geometry_msgs/msg/Twist",
            linear=_vector((float(forward), float(left), 0.0)),
            angular=_vector((0.0, 0.0, float(turn))),
        )
        message = _make(
            "geometry_msgs/msg/TwistStamped", header=_header(_stamp(stamp_ns), BASE_LINK), twist=twist
        )
        yield stamp_ns, "/recorded/velocity_command", message


def _contacts(trial: RecordedTrial) -> Iterator[Stamped]:
    """Feet that touch the floor, leg 1 to 6, when they change."""
    if trial.foot_contacts is None:
        return
    dimension = _make("std_msgs/msg/MultiArrayDimension", label="leg", size=N_LEGS, stride=N_LEGS)
    layout = _make("std_msgs/msg/MultiArrayLayout", dim=[dimension], data_offset=0)
    changed = (trial.foot_contacts[1:] != trial.foot_contacts[:-1]).any(axis=-1)
    for row in (0, *(np.flatnonzero(changed) + 1).tolist()):
        feet = trial.foot_contacts[row].astype(np.uint8)
        message = _make("std_msgs/msg/UInt8MultiArray", layout=layout, data=feet)
        yield int(trial.stamps_ns[row]), "/foot_contacts", message


def _battery(trial: RecordedTrial) -> Iterator[Stamped]:
    """The median of the servos' voltages."""
    nan, none = float("nan"), np.empty(0, dtype=np.float32)
    for stamp_ns, volts in _stamped(trial, trial.servos.get("voltages_v")):
        if not np.isfinite(volts).any():
            continue
        message = _make(
            "sensor_msgs/msg/BatteryState",
            header=_header(_stamp(stamp_ns)),
            voltage=float(np.nanmedian(volts)),
            temperature=nan,
            current=nan,
            charge=nan,
            capacity=nan,
            design_capacity=nan,
            percentage=nan,
            power_supply_status=0,
            power_supply_health=0,
            power_supply_technology=0,
            present=True,
            cell_voltage=none,
            cell_temperature=none,
            location="",
            serial_number="",
        )
        yield stamp_ns, "/battery_state", message


def _diagnostics(trial: RecordedTrial) -> Iterator[Stamped]:
    rows = sorted({row for samples in trial.servos.values() for row in samples.rows.tolist()})
    spread = {
        READING_NAMES[name]: dict(zip(samples.rows.tolist(), samples.values, strict=True))
        for name, samples in trial.servos.items()
    }
    for row in rows:
        stamp_ns = int(trial.stamps_ns[row])
        readings = {name: values[row] for name, values in spread.items() if row in values}
        statuses = [
            _make(
                "diagnostic_msgs/msg/DiagnosticStatus",
                level=0,
                name=f"{trial.robot.name}: {joint}",
                message="",
                hardware_id=joint,
                values=[
                    _make("diagnostic_msgs/msg/KeyValue", key=name, value=f"{values[index]:g}")
                    for name, values in readings.items()
                    if np.isfinite(values[index])
                ],
            )
            for index, joint in enumerate(JOINT_NAMES)
        ]
        message = _make(
            "diagnostic_msgs/msg/DiagnosticArray", header=_header(_stamp(stamp_ns)), status=statuses
        )
        yield stamp_ns, "/diagnostics", message


def _log(trial: RecordedTrial) -> Iterator[Stamped]:
    for event in trial.events:
        stamp_ns = int(trial.stamps_ns[event.row])
        message = _make(
            "rcl_interfaces/msg/Log",
            stamp=_stamp(stamp_ns),
            level=LOG_LEVELS.get(event.level, LOG_LEVELS["INFO"]),
            name="hexctl",
            msg=event.text,
            file="",
            function="",
            line=0,
        )
        yield stamp_ns, "/rosout", message


def _stamped(trial: RecordedTrial, samples: Samples | None) -> Iterator[tuple[int, FloatArray]]:
    if samples is not None:
        yield from zip(trial.stamps_ns[samples.rows].tolist(), samples.values, strict=True)
