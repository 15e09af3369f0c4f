"""Tables of recorded walks."""

import csv
import json
from pathlib import Path

import numpy as np
import pyarrow.parquet as pq

from hexctl.control.trace import PHASES
from hexctl.export.export import trial_columns, write_csv, write_parquet
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.types import JOINT_NAMES


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
