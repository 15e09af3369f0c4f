"""Tables and LeRobot datasets of recorded walks, read back by pyarrow, pandas and Rerun."""

import csv
import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pyarrow.parquet as pq
import pytest

from hexctl.control.trace import PHASES
from hexctl.errors import InputError
from hexctl.export.export import trial_columns, write_csv, write_parquet
from hexctl.export.lerobot import DATA, FPS, QUANTILES, task_of, write_lerobot
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.types import JOINT_NAMES
from tests.robots import shipped


def test_columns_are_the_arrays_of_the_recording(walk: RecordedTrial) -> None:
    columns = trial_columns(walk)
    assert all(len(column) == len(walk) for column in columns.values())
    assert np.array_equal(columns["measured_leg5_tibia_rad"], walk.measured_rad[:, 14])
    assert np.array_equal(columns["commanded_leg1_coxa_rad"], walk.commanded_rad[:, 0])
    assert np.array_equal(columns["base_y_m"], walk.base_position_world[:, 1])
    assert np.array_equal(columns["base_qz"], walk.base_quaternion_world[:, 3])
    assert walk.foot_contacts is not None
    assert np.array_equal(columns["contact_leg6"], walk.foot_contacts[:, 5])
    assert set(columns["phase"]) <= set(PHASES)
    known = np.isfinite(columns["torque_leg2_femur_nm"])
    assert np.array_equal(np.flatnonzero(known), walk.torques_nm.rows)
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
    assert table["torque_leg1_coxa_nm"].null_count == len(walk) - len(walk.torques_nm.rows)
    assert str(table.schema.field("contact_leg1").type) == "bool"
    properties = json.loads(table.schema.metadata[b"hexctl"])
    assert properties["status"] == walk.properties["status"]


@pytest.fixture(scope="module")
def dataset(tmp_path_factory: Any, walk: RecordedTrial) -> Path:
    """Two episodes of the same task, the second without its last second."""
    shorter = cut(walk, len(walk) - FPS)
    folder: Path = tmp_path_factory.mktemp("lerobot") / "walks"
    told: list[tuple[int, int]] = []
    write_lerobot([walk, shorter], folder, lambda done, total: told.append((done, total)))
    assert told == [(1, 2), (2, 2)]
    return folder


def cut(walk: RecordedTrial, ticks: int) -> RecordedTrial:
    names = ("stamps_ns", "time_s", "walk_s", "phases", "commanded_rad", "measured_rad")
    more = ("base_position_world", "base_quaternion_world", "foot_contacts")
    changes: dict[str, Any] = {
        name: getattr(walk, name)[:ticks] for name in (*names, *more, "leg_conditions")
    }
    return replace(walk, **changes)


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
    assert walk.foot_contacts is not None
    assert np.array_equal(np.stack(first["observation.contacts"]), walk.foot_contacts)
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
    write_lerobot([walk, replace(walk, foot_contacts=None)], tmp_path / "some", lambda *_: None)
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
