"""A recorded trial as a table, one row per tick: CSV and Parquet."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.log import frame_columns, joint_fields
from hexctl.errors import MissingExtraError
from hexctl.recording.recorded_trial import RecordedTrial

#: Columns of readings of single servos: what is before and behind the name of the joint.
READING_COLUMNS = {
    "temperatures_c": ("temperature", "c"),
    "voltages_v": ("voltage", "v"),
    "currents_a": ("current", "a"),
    "ages_s": ("age", "s"),
}


def trial_columns(trial: RecordedTrial) -> dict[str, Any]:
    """Columns of a trial by name, (T,) each; NaN, or an empty text, where nothing was recorded."""
    ticks = len(trial)
    columns: dict[str, Any] = {"stamp_ns": trial.stamps_ns}
    contacts = {} if trial.foot_contacts is None else {"foot_contacts": trial.foot_contacts}
    columns |= frame_columns(
        {
            "time_s": trial.time_s,
            "walk_s": trial.walk_s,
            "phase": trial.phases,
            "commanded_rad": trial.commanded_rad,
            "measured_rad": trial.measured_rad,
            "base_position_world": trial.base_position_world,
            "base_quaternion_world": trial.base_quaternion_world,
            "joint_torques_nm": trial.torques_nm.at_every_tick(ticks),
            "velocity_body": trial.velocity_body.at_every_tick(ticks),
            "leg_suspicion": trial.leg_suspicion.at_every_tick(ticks),
            **contacts,
        }
    )
    for name, samples in trial.servos.items():
        fields = joint_fields(*READING_COLUMNS[name])
        columns |= dict(zip(fields, samples.at_every_tick(ticks).T, strict=True))
    texts = [""] * ticks
    for event in trial.events:
        texts[event.row] = "; ".join(filter(None, (texts[event.row], event.text)))
    columns["events"] = np.array(texts, dtype=object)
    return columns


def write_csv(trial: RecordedTrial, path: Path) -> None:
    """Write a trial as CSV; numbers have all their digits, and what is unknown is empty."""
    columns = trial_columns(trial)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(_texts(column) for column in columns.values()), strict=True))


def write_parquet(trial: RecordedTrial, path: Path) -> None:
    """Write a trial as Parquet; the plan and the outcome are metadata of the table, as JSON in `hexctl`."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise MissingExtraError("Parquet export", "data") from error
    arrays = {name: pa.array(column, from_pandas=True) for name, column in trial_columns(trial).items()}
    table = pa.table(arrays).replace_schema_metadata({"hexctl": json.dumps(trial.properties)})
    pq.write_table(table, path, compression="zstd")


def _texts(column: Any) -> list[Any]:
    if column.dtype.kind == "b":
        return [int(value) for value in column.tolist()]
    return ["" if value != value else value for value in column.tolist()]
