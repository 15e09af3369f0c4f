"""A recorded trial as a table, one row per tick: CSV and Parquet."""

import csv
import json
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.control.trace import PHASES
from hexctl.errors import MissingExtraError
from hexctl.record.recorded_trial import RecordedTrial
from hexctl.types import JOINT_NAMES, N_LEGS, FloatArray

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
    columns: dict[str, Any] = {
        "stamp_ns": trial.stamps_ns,
        "time_s": trial.time_s,
        "walk_s": trial.walk_s,
        "phase": np.array(PHASES)[trial.phases],
    }
    columns |= _named("commanded", JOINT_NAMES, "rad", trial.commanded_rad)
    columns |= _named("measured", JOINT_NAMES, "rad", trial.measured_rad)
    columns |= {f"base_{axis}_m": trial.base_position_world[:, place] for place, axis in enumerate("xyz")}
    columns |= {f"base_q{axis}": trial.base_quaternion_world[:, place] for place, axis in enumerate("wxyz")}
    legs = [f"leg{leg}" for leg in range(1, N_LEGS + 1)]
    contacts = np.full((ticks, N_LEGS), np.nan) if trial.foot_contacts is None else trial.foot_contacts
    columns |= {f"contact_{leg}": contacts[:, place] for place, leg in enumerate(legs)}
    columns |= _named("torque", JOINT_NAMES, "nm", trial.torques_nm.at_every_tick(ticks))
    velocity = trial.velocity_body.at_every_tick(ticks)
    for place, name in enumerate(("forward_m_s", "left_m_s", "turn_rad_s")):
        columns[f"commanded_{name}"] = velocity[:, place]
    columns |= _named("suspicion", legs, "", trial.leg_suspicion.at_every_tick(ticks))
    for name, samples in trial.servos.items():
        first, unit = READING_COLUMNS[name]
        columns |= _named(first, JOINT_NAMES, unit, samples.at_every_tick(ticks))
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


def _named(what: str, names: Any, unit: str, values: FloatArray) -> dict[str, FloatArray]:
    """Columns such as `measured_leg1_coxa_rad`."""
    return {"_".join(filter(None, (what, name, unit))): values[:, place] for place, name in enumerate(names)}


def _texts(column: Any) -> list[Any]:
    if column.dtype.kind == "b":
        return [int(value) for value in column.tolist()]
    return ["" if value != value else value for value in column.tolist()]
