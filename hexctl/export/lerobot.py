"""Recorded trials as a LeRobot dataset (v3) for imitation learning, one episode each."""

import json
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.errors import InputError, MissingExtraError
from hexctl.export.recordings import OnProgress, Trials, title_of
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.types import JOINT_NAMES, N_LEGS, FloatArray

#: Frames per second: one for each tick.
FPS = round(1 / PERIOD_S)

#: Paths of the frames and of the episodes' metadata.
DATA = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
EPISODES = "meta/episodes/chunk-000/file-000.parquet"

#: Quantiles in the statistics, by their names; policies scale actions and states by those at the ends.
QUANTILES = {"q01": 0.01, "q10": 0.1, "q50": 0.5, "q90": 0.9, "q99": 0.99}

POSE_NAMES = ("x", "y", "z", "qw", "qx", "qy", "qz")
#: Vectors of a frame, and the names of their components.
VECTORS: dict[str, tuple[str, ...]] = {
    "action": JOINT_NAMES,
    "observation.state": JOINT_NAMES,
    "observation.pose": POSE_NAMES,
    "observation.contacts": tuple(f"leg{leg}" for leg in range(1, N_LEGS + 1)),
}
#: Numbers of a frame.
SCALARS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


def write_lerobot(trials: Trials, folder: Path, on_progress: OnProgress) -> None:
    """Write trials of one robot as a LeRobot dataset into a new folder.

    `action` contains the commanded joint angles, `observation.state` the measured ones, both in rad. Pose and
    contacts are included if all trials have them. Frames are evenly spaced, with interpolated values. Raises
    InputError for trials of several robots, and MissingExtraError without pandas and pyarrow.
    """
    pa, pq, pandas = _libraries()
    robots, texts, names = set[str](), list[str](), list(VECTORS)
    for trial in trials:
        robots.add(trial.robot.name)
        texts.append(task_of(trial))
        known = {
            "observation.pose": trial.posed.all(),
            "observation.contacts": trial.foot_contacts is not None,
        }
        names = [name for name in names if known.get(name, True)]
    if len(robots) != 1:
        raise InputError(f"lerobot: got {len(robots)} robots, {', '.join(sorted(robots))}; allowed: one")
    tasks = list(dict.fromkeys(texts))
    (folder / "meta").mkdir(parents=True)
    schema = pa.schema(
        [pa.field(name, pa.list_(pa.float32(), len(VECTORS[name]))) for name in names]
        + [pa.field(name, pa.type_for_alias(kind)) for name, kind in SCALARS.items()]
    )
    data = folder / DATA.format(chunk_index=0, file_index=0)
    data.parent.mkdir(parents=True)
    episodes, done = [], 0
    with pq.ParquetWriter(data, schema, compression="zstd") as writer:
        for number, (text, trial) in enumerate(zip(texts, trials, strict=True)):
            columns = _frames(trial, names, number, done, tasks.index(text))
            length = len(columns["index"])
            arrays = [_arrow(pa, columns[field.name], field.type) for field in schema]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema), row_group_size=length)
            episodes.append(_episode(number, text, done, length, columns))
            done += length
            on_progress(number + 1, len(texts))
    (folder / EPISODES).parent.mkdir(parents=True)
    pq.write_table(pa.Table.from_pylist(episodes), folder / EPISODES)
    index = pandas.Index(tasks, name="task")
    pandas.DataFrame({"task_index": range(len(tasks))}, index=index).to_parquet(folder / "meta/tasks.parquet")
    _write_json(folder / "meta/stats.json", {name: _stats(_column(pq, data, name)) for name in schema.names})
    _write_json(folder / "meta/info.json", _info(robots.pop(), names, len(texts), done, len(tasks)))


def task_of(trial: RecordedTrial) -> str:
    """Text of a trial's task."""
    if "heading_deg" not in trial.properties:  # driven, or cut off: the task is unknown
        return title_of(trial)
    heading = float(trial.properties["heading_deg"])
    way = "walk ahead" if heading == 0 else f"walk at {heading:g} degrees"
    return f"{way} with {title_of(trial)}"


def _libraries() -> tuple[Any, Any, Any]:
    try:
        import pandas
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise MissingExtraError("LeRobot export", "data") from error
    return pa, pq, pandas


def _frames(trial: RecordedTrial, names: list[str], number: int, before: int, task: int) -> dict[str, Any]:
    length = round(float(trial.time_s[-1]) * FPS) + 1
    times_s = np.arange(length) / FPS
    pose = np.column_stack([trial.base_position_world, trial.base_quaternion_world])
    contacts = np.zeros((len(trial), N_LEGS)) if trial.foot_contacts is None else trial.foot_contacts
    values = {
        "action": trial.commanded_rad,
        "observation.state": trial.measured_rad,
        "observation.pose": pose,
        "observation.contacts": contacts.astype(float),
    }
    even = len(trial) == length and bool(np.allclose(trial.time_s, times_s, atol=1e-6))
    vectors = {name: values[name] if even else _resampled(trial, values[name], times_s) for name in names}
    if "observation.contacts" in vectors:
        vectors["observation.contacts"] = np.round(vectors["observation.contacts"])
    return {
        **{name: value.astype(np.float32) for name, value in vectors.items()},
        "timestamp": times_s.astype(np.float32),
        "frame_index": np.arange(length),
        "episode_index": np.full(length, number),
        "index": before + np.arange(length),
        "task_index": np.full(length, task),
    }


def _resampled(trial: RecordedTrial, values: FloatArray, times_s: FloatArray) -> FloatArray:
    return np.column_stack([np.interp(times_s, trial.time_s, column) for column in values.T])


def _arrow(pa: Any, values: Any, kind: Any) -> Any:
    if values.ndim == 1:
        return pa.array(values, type=kind)
    return pa.FixedSizeListArray.from_arrays(pa.array(values.ravel()), type=kind)


def _episode(number: int, text: str, before: int, length: int, columns: dict[str, Any]) -> dict[str, Any]:
    return {
        "episode_index": number,
        "tasks": [text],
        "length": length,
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": before,
        "dataset_to_index": before + length,
        **{
            f"stats/{name}/{key}": value
            for name, column in columns.items()
            for key, value in _stats(np.atleast_2d(column.T).T).items()
        },
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _stats(values: FloatArray) -> dict[str, list[float]]:
    """Statistics of each component of values, (frames, components)."""
    exact = values.astype(float)
    quantiles = np.quantile(exact, list(QUANTILES.values()), axis=0)
    return {
        "min": exact.min(axis=0).tolist(),
        "max": exact.max(axis=0).tolist(),
        "mean": exact.mean(axis=0).tolist(),
        "std": exact.std(axis=0).tolist(),
        "count": [len(values)],
        **dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
    }


def _column(pq: Any, path: Path, name: str) -> FloatArray:
    """Values of all episodes of one column, (frames, components)."""
    values = pq.read_table(path, columns=[name])[name].combine_chunks()
    flat = values.flatten() if hasattr(values, "flatten") and values.type.num_fields else values
    return np.asarray(flat.to_numpy(zero_copy_only=False).reshape(len(values), -1))


def _info(robot: str, names: list[str], episodes: int, frames: int, tasks: int) -> dict[str, Any]:
    vectors = {
        name: {"dtype": "float32", "shape": [len(VECTORS[name])], "names": list(VECTORS[name])}
        for name in names
    }
    scalars = {name: {"dtype": kind, "shape": [1], "names": None} for name, kind in SCALARS.items()}
    return {
        "codebase_version": "v3.0",
        "robot_type": robot,
        "total_episodes": episodes,
        "total_frames": frames,
        "total_tasks": tasks,
        "chunks_size": 1000,
        "data_files_size_in_mb": 100,
        "video_files_size_in_mb": 200,
        "fps": FPS,
        "splits": {"train": f"0:{episodes}"},
        "data_path": DATA,
        "video_path": None,
        "features": {**vectors, **scalars},
    }


def _write_json(path: Path, content: Any) -> None:
    path.write_text(json.dumps(content, indent=2), encoding="utf-8")
