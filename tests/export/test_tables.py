"""Tables and LeRobot datasets of recorded walks, read back by pyarrow, pandas and Rerun."""

import csv
import json
import re
import subprocess
import sys
from collections import defaultdict
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest
import yaml
from mcap.reader import make_reader
from rosbags.typesys import Stores, get_typestore

from hexctl.columns import COLUMNS, RECORDED, SPARSE_TICKS
from hexctl.control.log import TickLog
from hexctl.control.trace import PHASES
from hexctl.control.trial_plan import TrialPlan
from hexctl.errors import HexctlError, InputError
from hexctl.export.export import trial_columns, write_csv, write_parquet
from hexctl.export.lerobot import DATA, FPS, QUANTILES, task_of, write_lerobot
from hexctl.export.mcap import TOPICS, write_mcap
from hexctl.gait.gait import make_gait
from hexctl.ik.legs import foot_positions_body
from hexctl.recording.recorded_trial import RecordedTrial, Samples, read_trial
from hexctl.recording.recording import Recording
from hexctl.recording.viewer import viewer_binary
from hexctl.robot.formats.urdf import urdf_of
from hexctl.types import JOINT_NAMES, N_JOINTS, FloatArray
from tests.robots import shipped
from tests.wire.ros.decoding import decoded as decoded_message


def test_columns_are_the_arrays_of_the_recording(walk: RecordedTrial) -> None:
    columns = trial_columns(walk)
    assert all(len(column) == len(walk) for column in columns.values())
    assert np.array_equal(columns["measured_leg5_tibia_rad"], walk.measured_rad[:, 14])
    assert np.array_equal(columns["commanded_leg1_coxa_rad"], walk.commanded_rad[:, 0])
    assert np.array_equal(columns["base_y_m"], walk.base_position_world[:, 1])
    assert np.array_equal(columns["base_qz"], walk.base_quaternion_world[:, 3])
    assert np.array_equal(columns["contact_leg6"], walk.sensors["foot_contacts"].values[:, 5])
    for column in RECORDED:
        known = np.isfinite(columns[column.fields[-1]])
        assert np.array_equal(np.flatnonzero(known), walk.sensors[column.name].rows), column.name
    assert set(columns["phase"]) <= set(PHASES)
    assert [text for text in columns["events"] if text][-1].startswith("trial over")


def test_csv_has_every_digit_and_leaves_out_what_is_unknown(walk: RecordedTrial, tmp_path: Path) -> None:
    write_csv(walk, tmp_path / "a.csv")
    with (tmp_path / "a.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert len(rows) == len(walk)
    for index, name in enumerate(JOINT_NAMES):
        values = [float(row[f"measured_{name}_rad"]) for row in rows]
        assert np.array_equal(values, walk.measured_rad[:, index])
    assert rows[1]["torque_leg1_coxa_nm"] == ""
    assert rows[5]["torque_leg1_coxa_nm"] != ""
    assert {row["contact_leg1"] for row in rows} == {"0", "1"}


def test_parquet_has_nulls_types_and_the_outcome(walk: RecordedTrial, tmp_path: Path) -> None:
    write_parquet(walk, tmp_path / "a.parquet")
    table = pq.read_table(tmp_path / "a.parquet")
    assert table.num_rows == len(walk)
    assert np.array_equal(table["measured_leg1_femur_rad"].to_numpy(), walk.measured_rad[:, 1])
    assert table["torque_leg1_coxa_nm"].null_count == len(walk) - len(walk.sensors["joint_torques_nm"].rows)
    assert str(table.schema.field("contact_leg1").type) == "bool"
    properties = json.loads(table.schema.metadata[b"hexctl"])
    assert properties["status"] == walk.properties["status"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: Any, walk: RecordedTrial) -> Path:
    """Two episodes of the same task, the second without its last second."""
    arrays = (
        *("stamps_ns", "time_s", "walk_s", "phases", "commanded_rad", "measured_rad", "leg_conditions"),
        *("base_position_world", "base_quaternion_world"),
    )
    ticks = len(walk) - FPS
    sensors = {
        name: Samples(one.rows[one.rows < ticks], one.values[one.rows < ticks])
        for name, one in walk.sensors.items()
    }
    cut = {name: getattr(walk, name)[:ticks] for name in arrays}
    shorter: RecordedTrial = replace(walk, **cut, sensors=sensors)
    folder: Path = tmp_path_factory.mktemp("lerobot") / "walks"
    told: list[tuple[int, int]] = []
    write_lerobot([walk, shorter], folder, lambda done, total: told.append((done, total)))
    assert told == [(1, 2), (2, 2)]
    return folder


def test_frames_are_those_of_the_walks(dataset: Path, walk: RecordedTrial) -> None:
    table = pq.read_table(dataset / "data/chunk-000/file-000.parquet")
    frames = table.to_pandas()
    first = frames[frames["episode_index"] == 0]
    state, action = (np.stack(first[name]) for name in ("observation.state", "action"))
    assert np.array_equal(state, walk.measured_rad.astype(np.float32))
    assert np.array_equal(action, walk.commanded_rad.astype(np.float32))
    assert np.allclose(np.diff(first["timestamp"]), 1 / FPS, atol=1e-5)
    assert np.array_equal(frames["index"], np.arange(len(frames)))
    assert len(frames) == 2 * len(walk) - FPS
    for column in (one for one in RECORDED if one.feature is not None):
        values = np.stack(first[column.feature])
        assert np.array_equal(values, walk.sensors[column.name].values.astype(np.float32)), column.name
    parts = pq.ParquetFile(dataset / "data/chunk-000/file-000.parquet")
    assert parts.metadata.num_row_groups == 2


def test_what_is_said_of_the_dataset_is_so(dataset: Path, walk: RecordedTrial) -> None:
    info = json.loads((dataset / "meta/info.json").read_text())
    assert info["codebase_version"] == "v3.0"
    assert (info["total_episodes"], info["total_tasks"], info["fps"]) == (2, 1, FPS)
    assert info["features"]["action"]["names"] == list(JOINT_NAMES)
    columns = pq.read_schema(dataset / "data/chunk-000/file-000.parquet").names
    assert columns == list(info["features"])
    tasks = pd.read_parquet(dataset / "meta/tasks.parquet")
    assert tasks.index.tolist() == [task_of(walk)]
    assert "leg 5 locked" in tasks.index[0]
    episodes = pd.read_parquet(dataset / "meta/episodes/chunk-000/file-000.parquet")
    assert episodes["length"].tolist() == [len(walk), len(walk) - FPS]
    assert episodes["dataset_from_index"].tolist() == [0, len(walk)]
    assert (dataset / info["data_path"].format(chunk_index=0, file_index=0)).is_file()


def test_rerun_reads_it_back(dataset: Path, walk: RecordedTrial) -> None:
    from rerun.experimental import LeRobotReader

    reader = LeRobotReader(dataset)
    episodes = list(reader.episodes())
    assert len(episodes) == 2
    chunks = list(reader.stream(episodes[0]).to_chunks())
    rows = {chunk.entity_path: chunk.to_record_batch().num_rows for chunk in chunks}
    assert any("action" in path and count == len(walk) for path, count in rows.items()), rows


def test_late_ticks_are_made_even(walk: RecordedTrial, tmp_path: Path) -> None:
    late_s = walk.time_s.copy()
    late_s[50:] += 0.013
    write_lerobot([replace(walk, time_s=late_s)], tmp_path / "late", lambda *_: None)
    frames = pd.read_parquet(tmp_path / "late/data/chunk-000/file-000.parquet")
    assert np.allclose(np.diff(frames["timestamp"]), 1 / FPS, atol=1e-5)
    femur = np.stack(frames["observation.state"])[:, 1]
    expected = np.interp(frames["timestamp"], late_s, walk.measured_rad[:, 1])
    assert femur == pytest.approx(expected, abs=1e-5)


def test_robots_are_not_mixed_and_what_one_lacks_none_has(walk: RecordedTrial, tmp_path: Path) -> None:
    with pytest.raises(InputError, match="2 robots"):
        write_lerobot([walk, replace(walk, robot=shipped("ant"))], tmp_path / "mixed", lambda *_: None)
    left_out: list[HexctlError] = []
    write_lerobot([walk, replace(walk, sensors={})], tmp_path / "some", lambda *_: None, left_out.append)
    assert any("observation.contacts" in str(error) for error in left_out)
    assert not any("observation.pose" in str(error) for error in left_out)
    names = pq.read_schema(tmp_path / "some/data/chunk-000/file-000.parquet").names
    assert "observation.contacts" not in names
    assert "observation.pose" in names


def test_statistics_of_all_episodes_are_those_of_all_frames(walk: RecordedTrial, tmp_path: Path) -> None:
    """Quantiles of episodes cannot be averaged: the second episode stands elsewhere."""
    elsewhere = replace(walk, measured_rad=walk.measured_rad + 0.5)
    write_lerobot([walk, elsewhere, walk], tmp_path / "set", lambda *_: None)
    stats = json.loads((tmp_path / "set/meta/stats.json").read_text())
    frames = pd.read_parquet(tmp_path / "set" / DATA.format(chunk_index=0, file_index=0))
    assert stats.keys() == set(frames.columns)
    for name in ("action", "observation.state", "timestamp", "index"):
        values = np.stack(frames[name].to_list()).astype(float).reshape(len(frames), -1)
        for key, share in QUANTILES.items():
            assert stats[name][key] == pytest.approx(np.quantile(values, share, axis=0))
        assert stats[name]["mean"] == pytest.approx(values.mean(axis=0), abs=1e-9)
        assert stats[name]["std"] == pytest.approx(values.std(axis=0), abs=1e-6)
        assert stats[name]["max"] == pytest.approx(values.max(axis=0))
        assert (stats[name]["count"], len(stats[name]["min"])) == ([len(values)], values.shape[1])


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
    for topic, field, name in (
        ("/joint_torques", "effort", "joint_torques_nm"),
        ("/joint_velocities", "velocity", "joint_velocities_rad_s"),
    ):
        numbers = np.array([list(getattr(message, field)) for _, message in found[topic]])
        assert np.array_equal(numbers, walk.sensors[name].values)
    turns = [message.angular_velocity for _, message in found["/imu/data"]]
    rates = np.array([[one.x, one.y, one.z] for one in turns])
    assert np.array_equal(rates, walk.sensors["angular_velocity_body_rad_s"].values)
    commands = [message.twist for _, message in found["/recorded/velocity_command"]]
    velocities = np.array([[one.linear.x, one.linear.y, one.angular.z] for one in commands])
    assert np.array_equal(velocities, walk.sensors["velocity_body"].values)


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
    feet = walk.sensors["foot_contacts"].values
    assert [time for time, _ in found["/foot_contacts"]] == walk.stamps_ns.tolist()
    assert [list(message.data) for _, message in found["/foot_contacts"]] == feet.tolist()
    texts = [message.msg for _, message in found["/rosout"]]
    assert texts == [event.text for event in walk.events]


TICKS, PARTLY, WHOLLY = 60, 20, 30


def gapped(folder: Path, *, partly: int = PARTLY, wholly: int = WHOLLY) -> tuple[TickLog, RecordedTrial]:
    """A log of random numbers and its recording: one of each sensor is unknown at a tick, and all at another.

    Foot contacts are only unknown together.
    """
    random, log, robot = np.random.default_rng(1), TickLog(), shipped("ant")
    rows: dict[str, Any] = {
        one.name: random.uniform(-9, 9, (TICKS, *one.shape)).astype(one.kind) for one in COLUMNS
    }
    rows |= {"time_s": np.arange(TICKS) / FPS, "phase": np.full(TICKS, PHASES.index("walk"))}
    rows |= {"base_quaternion_world": np.tile([0.6, 0.0, 0.0, 0.8], (TICKS, 1))}
    rows["foot_contacts"] = rows["foot_contacts"].astype(float) * (random.random((TICKS, 6)) < 0.5)
    for column in RECORDED:
        rows[column.name][wholly : wholly + 1] = np.nan
        if column.kind is float:
            rows[column.name][partly : partly + 1, 1] = np.nan
    log.extend(rows)
    with Recording(folder / "a.rrd", robot, TrialPlan(gait=make_gait(robot, "demo")), title="a") as recording:
        recording.write_block(log, 0, TICKS)
    return log, read_trial(folder / "a.rrd")


def test_files_know_what_the_log_knows(tmp_path: Path) -> None:
    log, read = gapped(tmp_path)
    frame = log.to_frame()
    write_csv(read, tmp_path / "a.csv")
    write_parquet(read, tmp_path / "a.parquet")
    assert frame["suspicion_leg1"].max() > 5
    for table in (pd.read_csv(tmp_path / "a.csv"), pd.read_parquet(tmp_path / "a.parquet")):
        for column in COLUMNS:
            ticks = SPARSE_TICKS if column.name == "leg_suspicion" else column.ticks
            for name in (one for one in column.fields if one in table and one != "phase"):
                logged, stored = (one[name].astype(float).to_numpy()[::ticks] for one in (frame, table))
                np.testing.assert_allclose(stored, logged, atol=2e-3, err_msg=name)
    assert frame["velocity_leg1_femur_rad_s"].isna().sum() == 2
    assert frame["velocity_leg1_coxa_rad_s"].isna().sum() == 1


def test_types_of_columns_do_not_depend_on_what_is_unknown(tmp_path: Path) -> None:
    schemas, dtypes, texts = [], [], []
    for name, wholly in (("some", WHOLLY), ("all", TICKS)):
        (tmp_path / name).mkdir()
        log, read = gapped(tmp_path / name, wholly=wholly)
        write_parquet(read, tmp_path / name / "a.parquet")
        write_csv(read, tmp_path / name / "a.csv")
        schemas.append(pq.read_schema(tmp_path / name / "a.parquet"))
        dtypes.append(log.to_frame().dtypes.to_dict())
        texts.append({row["contact_leg2"] for row in csv.DictReader((tmp_path / name / "a.csv").open())})
    assert schemas[0] == schemas[1]
    assert dtypes[0] == dtypes[1]
    assert texts == [{"0", "1", ""}, {"0", "1"}]


def test_messages_are_missing_only_if_unknown(tmp_path: Path) -> None:
    _, read = gapped(tmp_path)
    write_mcap(read, tmp_path / "a.mcap")
    found = decoded(tmp_path / "a.mcap")
    known = np.delete(read.stamps_ns, WHOLLY).tolist()
    for topic in ("/foot_contacts", "/joint_velocities", "/imu/data"):
        assert [time for time, _ in found[topic]] == known, topic
    unknown = np.isnan(found["/joint_velocities"][PARTLY][1].velocity)
    assert np.flatnonzero(unknown).tolist() == [1]


def test_a_dataset_lacks_only_the_numbers_that_are_unknown(tmp_path: Path) -> None:
    _, read = gapped(tmp_path, wholly=TICKS)
    left_out: list[HexctlError] = []
    write_lerobot([read], tmp_path / "set", lambda *_: None, left_out.append)
    features = json.loads((tmp_path / "set/meta/info.json").read_text())["features"]
    name = "observation.joint_velocities"
    assert features[name]["names"] == [one for one in JOINT_NAMES if one != "leg1_femur"]
    assert [str(error).split(", which")[0] for error in left_out] == [
        "observation.angular_velocity (y)",
        f"{name} (leg1_femur)",
    ]
    frames = pd.read_parquet(tmp_path / "set" / DATA.format(chunk_index=0, file_index=0))
    stored = read.sensors["joint_velocities_rad_s"].values
    assert np.array_equal(np.stack(frames[name]), np.delete(stored, 1, axis=1).astype(np.float32))
    assert features["observation.contacts"]["shape"] == [6]


def test_topics_have_the_rate_that_the_page_gives(found: Messages, walk: RecordedTrial) -> None:
    page = (Path(__file__).parents[2] / "docs/reference/recording-formats.md").read_text(encoding="utf-8")
    table = page.partition("## MCAP")[2].partition("## LeRobot")[0]
    rates: dict[str, str] = dict(re.findall(r"`(/[\w/]+)`(?: \((.*?)\))?(?=[,| ])", table))
    assert rates.keys() == TOPICS.keys()
    counts = {"latched": 1, "": len(walk), "10 Hz": len(walk) // SPARSE_TICKS + 1}
    for topic, messages in found.items():
        if rates[topic] in counts and topic != "/recorded/velocity_command":
            assert len(messages) == counts[rates[topic]], topic


NEW_SENSORS = """
import json
import sys
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from hexctl import columns

known = {"source": "current_a", "topic": "/current", "feature": "observation.current"}
scalar = columns.Column("current_a", optional=True, entity="current", title="current (A)", **known)
many = columns.Column("skin", (24,), parts=tuple(f"s{i}" for i in range(24)), optional=True, entity="skin")
for name, more in (("COLUMNS", (scalar, many)), ("RECORDED", (scalar, many)), ("SENSED", (scalar,))):
    setattr(columns, name, getattr(columns, name) + more)
columns.COLUMN_NAMES = tuple(column.name for column in columns.COLUMNS)

from hexctl.backends.clock import Tick
from hexctl.control.log import TickLog
from hexctl.control.trial_plan import TrialPlan
from hexctl.export.export import trial_columns
from hexctl.export.lerobot import write_lerobot
from hexctl.export.mcap import write_mcap
from hexctl.gait.gait import make_gait
from hexctl.recording.recorded_trial import read_trial
from hexctl.recording.recording import Recording
from hexctl.recording.series import SENSORS
from hexctl.robot.loader import load_robot
from hexctl.server.ros.topics import RobotMessages
from hexctl.server.snapshot import RobotSnapshot
from hexctl.testing.servo_conformance import arrays_of, check_state
from hexctl.types import JointTargets, RobotState

folder, robot, log = Path(sys.argv[1]), load_robot("ant"), TickLog()
stance = robot.stance_angles_rad
for index in range(3):
    state = RobotState(stance, 0.02 * index, True, current_a=None if index == 1 else 0.5 * index)
    log.record(Tick(index, 0.02 * index), state, stance, JointTargets(stance, 0.02 * index))
with Recording(folder / "a.rrd", robot, TrialPlan(gait=make_gait(robot, "demo")), title="a") as recording:
    recording.write_block(log, 0, 3)
read = read_trial(folder / "a.rrd")
write_mcap(read, folder / "a.mcap")
read.sensors["current_a"] = type(read.sensors["current_a"])(np.arange(3), np.array([[0.0], [0.5], [1.0]]))
write_lerobot([read], folder / "set", lambda *_: None)
check_state(state, SimpleNamespace(clock=SimpleNamespace(now_s=1.0)))
assert [array.shape for array in arrays_of(state) if array is not None] == [(18,), (1,)]
message = RobotMessages(robot, "", "hexctl").sensor("current", RobotSnapshot(state=state))
print(json.dumps({
    "colors": {one.source: len(one.colors) for one in SENSORS},
    "frame": log.to_frame()["current_a"].tolist(),
    "columns": trial_columns(read_trial(folder / "a.rrd"))["current_a"].tolist(),
    "ros": message.hex(),
}))
"""


@pytest.mark.slow
def test_a_sensor_of_one_number_or_many_is_one_entry(tmp_path: Path) -> None:
    done = subprocess.run(
        [sys.executable, "-c", NEW_SENSORS, str(tmp_path)], capture_output=True, text=True, timeout=120
    )
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert (told["colors"]["current_a"], told["colors"]["skin"]) == (1, 24)
    for name in ("frame", "columns"):
        np.testing.assert_array_equal(told[name], [0, np.nan, 1])
    array = "std_msgs/msg/Float64MultiArray"
    assert list(decoded_message(array, bytes.fromhex(told["ros"])).data) == [1.0]
    assert [list(message.data) for _, message in decoded(tmp_path / "a.mcap")["/current"]] == [[0.0], [1.0]]
    frames = pq.read_table(tmp_path / "set" / DATA.format(chunk_index=0, file_index=0))
    assert frames["observation.current"].to_pylist() == [[0.0], [0.5], [1.0]]
    features = json.loads((tmp_path / "set/meta/info.json").read_text())["features"]
    assert features["observation.current"] == {"dtype": "float32", "shape": [1], "names": ["current_a"]}


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
