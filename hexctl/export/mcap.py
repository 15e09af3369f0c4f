"""A recorded trial as MCAP, in messages for ROS 2, Foxglove, PlotJuggler and Rerun."""

import heapq
import json
from collections.abc import Iterator
from dataclasses import replace
from operator import itemgetter
from pathlib import Path
from typing import Any, Final

import numpy as np

from hexctl.columns import READINGS, RECORDED, Column
from hexctl.recording.recorded_trial import RecordedTrial, Samples
from hexctl.robot.body_twist import BodyTwist
from hexctl.robot.formats.link_frames import BASE_LINK, fixed_transforms, link_transforms
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.rotations import xyzw
from hexctl.scratch import scratch_folder
from hexctl.types import JOINT_NAMES, FloatArray
from hexctl.wire import ros_cdr
from hexctl.wire.pose import WORLD_FRAME, odometry
from hexctl.wire.ros import telemetry
from hexctl.wire.ros.odometry_error import own_pose_covariance, twist_covariance
from hexctl.wire.ros.sensor_messages import encode_sensor, message_type
from hexctl.wire.ros.telemetry import DiagnosticStatus, Level
from hexctl.wire.zenoh_messages import encode_battery, encode_positions

#: Version of the bag's metadata. From 9 on QoS profiles are a list, and Humble, which reads a text, ends.
BAG_VERSION: Final = 8

#: Types of topics, and whether late subscribers get the last message. Names of commands are not those of a
#: robot: a replayed bag must not drive one.
TOPICS: dict[str, tuple[str, bool]] = {
    "/robot_description": (telemetry.STRING, True),
    "/tf_static": (telemetry.TRANSFORMS, True),
    "/tf": (telemetry.TRANSFORMS, False),
    "/joint_states": (ros_cdr.JOINT_STATE, False),
    "/recorded/joint_commands": (ros_cdr.JOINT_STATE, False),
    "/odom": (ros_cdr.ODOMETRY, False),
    "/imu/data": (ros_cdr.IMU, False),
    **{column.topic: (message_type(column), False) for column in RECORDED if column.topic is not None},
    "/battery_state": (ros_cdr.BATTERY_STATE, False),
    "/diagnostics": (telemetry.DIAGNOSTICS, False),
    "/rosout": ("rcl_interfaces/msg/Log", False),
}

#: Levels of rcl_interfaces/Log.
LOG_LEVELS = {"INFO": 20, "WARN": 30, "ERROR": 40}

#: Time in nanoseconds since 1970, topic and encoded message.
Stamped = tuple[int, str, bytes]


def write_mcap(trial: RecordedTrial, path: Path) -> None:
    """Write a trial to a new MCAP file if `path` ends in `.mcap`, else to a folder for `ros2 bag play`."""
    if path.suffix != ".mcap":
        _write_bag(trial, path)
        return
    with scratch_folder(path.parent, path.stem) as draft:
        bag = draft / path.stem
        _write_bag(trial, bag)
        (bag / f"{bag.name}.mcap").rename(path)


def _write_bag(trial: RecordedTrial, folder: Path) -> None:
    from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin, Writer

    writer = Writer(folder, version=BAG_VERSION, storage_plugin=StoragePlugin.MCAP)
    # The compression inside of the file is the only one that all readers support.
    writer.set_compression(CompressionMode.STORAGE, CompressionFormat.ZSTD)
    for name, value in trial.properties.items():
        writer.set_custom_data(name, json.dumps(value))
    with writer:
        connections: dict[str, Any] = {}
        for stamp_ns, topic, content in _messages(trial):
            if topic not in connections:
                kind, latched = TOPICS[topic]
                qos = [_latched_qos()] if latched else []
                connections[topic] = writer.add_connection(
                    topic, kind, typestore=ros_cdr.typestore(), offered_qos_profiles=qos
                )
            writer.write(connections[topic], stamp_ns, content)


def _messages(trial: RecordedTrial) -> Iterator[Stamped]:
    yield from _latched(trial)
    parts = (
        _transforms(trial),
        _joints(trial, "/joint_states", trial.measured_rad),
        _joints(trial, "/recorded/joint_commands", trial.commanded_rad),
        _odometry(trial),
        _imu(trial),
        *(_sensor(trial, column, column.topic) for column in RECORDED if column.topic is not None),
        _battery(trial),
        _diagnostics(trial),
        _log(trial),
    )
    yield from heapq.merge(*parts, key=itemgetter(0))


def _latched(trial: RecordedTrial) -> Iterator[Stamped]:
    start_ns, fixed = int(trial.stamps_ns[0]), fixed_transforms(trial.robot)
    yield start_ns, "/robot_description", telemetry.encode_string(urdf_of(trial.robot))
    yield start_ns, "/tf_static", telemetry.transforms(fixed.frames).encode(start_ns, fixed.numbers)


def _latched_qos() -> Any:
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


def _short(values: FloatArray) -> FloatArray:
    """Derived values to seven digits, which compress well."""
    return values.astype(np.float32).astype(np.float64)


def _transforms(trial: RecordedTrial) -> Iterator[Stamped]:
    links = link_transforms(trial.robot, trial.measured_rad)
    numbers = replace(links, quaternions=_short(links.quaternions)).numbers
    of_links = telemetry.transforms(links.frames)
    of_all = telemetry.transforms(((WORLD_FRAME, BASE_LINK), *links.frames))
    all_numbers = np.concatenate([_poses(trial), numbers], axis=-1)
    for row, stamp_ns in enumerate(trial.stamps_ns.tolist()):
        if trial.posed[row]:
            yield stamp_ns, "/tf", of_all.encode(stamp_ns, all_numbers[row])
        else:
            yield stamp_ns, "/tf", of_links.encode(stamp_ns, numbers[row])


def _poses(trial: RecordedTrial) -> FloatArray:
    """Position and quaternion (x, y, z, w), (T, 7)."""
    return np.concatenate([trial.base_position_world, xyzw(trial.base_quaternion_world)], axis=-1)


def _joints(trial: RecordedTrial, topic: str, angles_rad: FloatArray) -> Iterator[Stamped]:
    for stamp_ns, angles in zip(trial.stamps_ns.tolist(), angles_rad, strict=True):
        yield stamp_ns, topic, encode_positions(angles, stamp_ns)


def _odometry(trial: RecordedTrial) -> Iterator[Stamped]:
    """Pose in `odom` as recorded, with the covariance of a robot's own pose; the twist is its derivative."""
    twists, covariance, poses = BodyTwist(), own_pose_covariance(), _poses(trial)
    for row in np.flatnonzero(trial.posed).tolist():
        stamp_ns = int(trial.stamps_ns[row])
        pose = trial.base_position_world[row], trial.base_quaternion_world[row]
        twist = _short(twists.of(float(trial.time_s[row]), *pose))
        numbers = [poses[row], twist, covariance, twist_covariance(twist, reckoned=False)]
        yield stamp_ns, "/odom", odometry().encode(stamp_ns, np.concatenate(numbers))


def _imu(trial: RecordedTrial) -> Iterator[Stamped]:
    """Angular velocity, and the orientation of a robot without a position, which has no other topic."""
    quaternions = trial.base_quaternion_world
    turned = np.flatnonzero(np.isfinite(quaternions).all(axis=-1)).tolist()
    if trial.posed.any() or not (quaternions[turned] != (1.0, 0.0, 0.0, 0.0)).any():
        turned = []
    rates = trial.sensors.get("angular_velocity_body_rad_s")
    rates_rad_s = {} if rates is None else dict(zip(rates.rows.tolist(), rates.values, strict=True))
    known = dict(zip(turned, quaternions[turned], strict=True))
    for row in sorted({*known, *rates_rad_s}):
        stamp_ns = int(trial.stamps_ns[row])
        yield stamp_ns, "/imu/data", telemetry.encode_imu(stamp_ns, known.get(row), rates_rad_s.get(row))


def _sensor(trial: RecordedTrial, column: Column, topic: str) -> Iterator[Stamped]:
    """Recorded values of a column; truths, which have no number for unknown ones, only if all are known."""
    for stamp_ns, values in _stamped(trial, trial.sensors.get(column.name)):
        if column.kind is not bool or np.isfinite(values).all():
            yield stamp_ns, topic, encode_sensor(column, stamp_ns, values)


def _battery(trial: RecordedTrial) -> Iterator[Stamped]:
    """The median of the servos' voltages."""
    for stamp_ns, volts in _stamped(trial, trial.servos.get("voltages_v")):
        if np.isfinite(volts).any():
            yield stamp_ns, "/battery_state", encode_battery(float(np.nanmedian(volts)), None, stamp_ns)


def _diagnostics(trial: RecordedTrial) -> Iterator[Stamped]:
    rows = sorted({row for samples in trial.servos.values() for row in samples.rows.tolist()})
    spread = {
        reading.title: dict(zip(samples.rows.tolist(), samples.values, strict=True))
        for reading in READINGS
        if (samples := trial.servos.get(reading.name)) is not None
    }
    for row in rows:
        stamp_ns = int(trial.stamps_ns[row])
        readings = {name: values[row] for name, values in spread.items() if row in values}
        statuses = [
            DiagnosticStatus(Level.OK, f"{trial.robot.name}: {joint}", "", _known(readings, index))
            for index, joint in enumerate(JOINT_NAMES)
        ]
        yield (
            stamp_ns,
            "/diagnostics",
            telemetry.encode_diagnostics(statuses, trial.robot.name, stamp_ns),
        )


def _known(readings: dict[str, FloatArray], joint: int) -> dict[str, str]:
    return {name: f"{values[joint]:g}" for name, values in readings.items() if np.isfinite(values[joint])}


def _log(trial: RecordedTrial) -> Iterator[Stamped]:
    for event in trial.events:
        stamp_ns = int(trial.stamps_ns[event.row])
        message = ros_cdr.make(
            "rcl_interfaces/msg/Log",
            stamp=ros_cdr.header(stamp_ns).stamp,
            level=LOG_LEVELS.get(event.level, LOG_LEVELS["INFO"]),
            name="hexctl",
            msg=event.text,
            file="",
            function="",
            line=0,
        )
        yield stamp_ns, "/rosout", ros_cdr.encode(message)


def _stamped(trial: RecordedTrial, samples: Samples | None) -> Iterator[tuple[int, FloatArray]]:
    if samples is not None:
        yield from zip(trial.stamps_ns[samples.rows].tolist(), samples.values, strict=True)
