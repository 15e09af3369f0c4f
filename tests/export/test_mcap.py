"""MCAP of a recorded walk, decoded by programs of others."""

import subprocess
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from hexctl.export.mcap import TOPICS, write_mcap
from hexctl.ik.legs import foot_positions_body
from hexctl.recording.recorded_trial import RecordedTrial, Samples
from hexctl.recording.viewer import viewer_binary
from hexctl.robot.formats.urdf import urdf_of
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray

Messages = dict[str, list[tuple[int, Any]]]


def decoded(path: Path) -> Messages:
    """Times and messages by topic, by a decoder that shares no code with the writer."""
    from mcap_ros2.decoder import DecoderFactory

    found: Messages = defaultdict(list)
    with path.open("rb") as file:
        for _, channel, message, content in make_reader(
            file, decoder_factories=[DecoderFactory()]
        ).iter_decoded_messages():
            found[channel.topic].append((message.log_time, content))
    return found


@pytest.fixture(scope="module")
def bag(tmp_path_factory: Any, walk: RecordedTrial) -> Path:
    folder: Path = tmp_path_factory.mktemp("bags") / "walk"
    write_mcap(walk, folder)
    return folder


@pytest.fixture(scope="module")
def found(bag: Path) -> Messages:
    return decoded(bag / "walk.mcap")


def positions(messages: list[tuple[int, Any]]) -> FloatArray:
    return np.array([list(message.position) for _, message in messages])


def test_angles_and_poses_are_the_recordings_bit_for_bit(found: Messages, walk: RecordedTrial) -> None:
    assert np.array_equal(positions(found["/joint_states"]), walk.measured_rad)
    assert np.array_equal(positions(found["/recorded/joint_commands"]), walk.commanded_rad)
    assert list(found["/joint_states"][0][1].name) == list(JOINT_NAMES)
    poses = [message.pose.pose for _, message in found["/odom"]]
    at_m = np.array([[p.position.x, p.position.y, p.position.z] for p in poses])
    assert np.array_equal(at_m, walk.base_position_world)
    turn = np.array([[p.orientation.w, p.orientation.x, p.orientation.y, p.orientation.z] for p in poses])
    assert np.array_equal(turn, walk.base_quaternion_world)
    odometry = found["/odom"][-1][1]
    assert min(odometry.pose.covariance[::7]) > 0
    assert min(odometry.twist.covariance[::7]) > 0
    torques = np.array([list(message.effort) for _, message in found["/joint_torques"]])
    assert np.array_equal(torques, walk.torques_nm.values)
    commands = [message.twist for _, message in found["/recorded/velocity_command"]]
    velocities = np.array([[one.linear.x, one.linear.y, one.angular.z] for one in commands])
    assert np.array_equal(velocities, walk.velocity_body.values)


def test_stamps_and_times_are_those_of_the_ticks(found: Messages, walk: RecordedTrial) -> None:
    for topic in ("/joint_states", "/odom", "/tf"):
        assert [time for time, _ in found[topic]] == walk.stamps_ns.tolist()
    for time_ns, message in found["/joint_states"]:
        assert message.header.stamp.sec * 10**9 + message.header.stamp.nanosec == time_ns


def test_transforms_put_the_feet_where_they_were(found: Messages, walk: RecordedTrial) -> None:
    import mujoco

    static = {one.child_frame_id: one for one in found["/tf_static"][0][1].transforms}
    for row in (0, 70, len(walk) - 1):
        moving = {one.child_frame_id: one for one in found["/tf"][row][1].transforms}
        assert len(moving) == 1 + N_JOINTS
        for leg, foot_body in enumerate(foot_positions_body(walk.robot, walk.measured_rad[row]), start=1):
            frame, point = f"leg{leg}_foot", np.zeros(3)
            while frame != "base_link":
                one = (moving | static)[frame]
                q, t = one.transform.rotation, one.transform.translation
                turned = np.empty(3)
                mujoco.mju_rotVecQuat(turned, point, np.array([q.w, q.x, q.y, q.z]))
                point, frame = turned + np.array([t.x, t.y, t.z]), one.header.frame_id
            assert point == pytest.approx(foot_body, abs=1e-6)
        assert moving["base_link"].header.frame_id == "odom"


def test_late_listeners_get_the_model_and_what_is_fixed_and_no_robot_obeys(
    bag: Path, found: Messages, walk: RecordedTrial
) -> None:
    from rosbags.interfaces import QosDurability
    from rosbags.rosbag2 import Reader

    with Reader(bag) as reader:
        qos = {one.topic: one.ext.offered_qos_profiles for one in reader.connections}  # type: ignore[union-attr]
        kinds = {one.topic: one.msgtype for one in reader.connections}
    assert all(kinds[topic] == TOPICS[topic][0] for topic in kinds)
    for topic in ("/robot_description", "/tf_static"):
        assert [one.durability for one in qos[topic]] == [QosDurability.TRANSIENT_LOCAL]
    assert found["/robot_description"][0][1].data == urdf_of(walk.robot)
    assert set(found) <= set(TOPICS)
    for topic in TOPICS:
        assert topic.rpartition("/")[2] not in ("cmd_vel", "robot_joint_command", "joint_command"), "obeyed"


def test_contacts_and_events(found: Messages, walk: RecordedTrial) -> None:
    assert walk.foot_contacts is not None
    contacts = dict(zip(walk.stamps_ns.tolist(), walk.foot_contacts.tolist(), strict=True))
    assert len(found["/foot_contacts"]) > 5
    for time_ns, message in found["/foot_contacts"]:
        assert [bool(foot) for foot in message.data] == contacts[time_ns]
    texts = [message.msg for _, message in found["/rosout"]]
    assert texts == [event.text for event in walk.events]


@pytest.mark.slow
def test_servos_battery_and_a_robot_that_knows_no_place(walk: RecordedTrial, tmp_path: Path) -> None:
    volts, warm = np.full((2, N_JOINTS), np.nan), np.full((2, N_JOINTS), 31.0)
    volts[:, :3] = [[11.0, 11.2, 11.4], [10.0, 10.2, 10.9]]
    rows = np.array([0, 50])
    servos = {"voltages_v": Samples(rows, volts), "temperatures_c": Samples(rows, warm)}
    nowhere = np.full_like(walk.base_position_world, np.nan)
    write_mcap(replace(walk, servos=servos, base_position_world=nowhere), tmp_path / "a.mcap")
    found = decoded(tmp_path / "a.mcap")
    assert [message.voltage for _, message in found["/battery_state"]] == pytest.approx([11.2, 10.2])
    statuses = found["/diagnostics"][1][1].status
    assert [status.name for status in statuses] == [f"phantomx: {joint}" for joint in JOINT_NAMES]
    assert {one.key: one.value for one in statuses[0].values} == {
        "voltage (V)": "10",
        "temperature (C)": "31",
    }
    assert {one.key for one in statuses[17].values} == {"temperature (C)"}
    assert "/odom" not in found
    assert len(found["/tf"][0][1].transforms) == N_JOINTS
    imu = found["/imu/data"][-1][1]
    assert imu.orientation.w == walk.base_quaternion_world[-1, 0]
    assert imu.linear_acceleration_covariance[0] == -1


def test_rerun_opens_it_and_a_file_alone_is_that_of_the_folder(
    bag: Path, walk: RecordedTrial, tmp_path: Path
) -> None:
    import rerun as rr

    converted = tmp_path / "converted.rrd"
    command = [str(viewer_binary()), "mcap", "convert", str(bag / "walk.mcap"), "-o", str(converted)]
    subprocess.run(command, check=True, capture_output=True)
    entities = {chunk.entity_path for chunk in rr.chunk.RrdReader(converted).stream().to_chunks()}
    assert "/tf" in entities
    assert any("leg1_tibia" in entity for entity in entities)  # of the URDF
    write_mcap(walk, tmp_path / "walk.mcap")
    assert (tmp_path / "walk.mcap").read_bytes() == (bag / "walk.mcap").read_bytes()
    assert sorted(path.name for path in bag.iterdir()) == ["metadata.yaml", "walk.mcap"]


@pytest.mark.parametrize(
    "change", [{}, {"base_position_world": np.full((301, 3), np.nan)}, {"properties": {}}]
)
def test_humble_reads_the_metadata(walk: RecordedTrial, tmp_path: Path, change: dict[str, Any]) -> None:
    write_mcap(replace(walk, **change), tmp_path / "bag")
    bag = yaml.safe_load((tmp_path / "bag/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert bag["version"] < 9
    topics = [one["topic_metadata"] for one in bag["topics_with_message_count"]]
    assert {one["name"] for one in topics} <= set(TOPICS)
    for one in topics:
        profiles = one["offered_qos_profiles"]
        assert isinstance(profiles, str)  # a list is a "bad conversion" there
        for profile in yaml.safe_load(profiles) or []:
            numbers = ("history", "depth", "reliability", "durability", "liveliness")
            assert all(isinstance(profile[name], int) for name in numbers)
    assert sum("durability: 1" in one["offered_qos_profiles"] for one in topics) == 2
    assert (bag["compression_mode"], bag["files"][0]["path"]) == ("", "bag.mcap")


def test_messages_are_the_same_in_humble() -> None:
    humble, jazzy = get_typestore(Stores.ROS2_HUMBLE), get_typestore(Stores.ROS2_JAZZY)
    for kind, _ in TOPICS.values():
        assert humble.hash_rihs01(kind) == jazzy.hash_rihs01(kind)
