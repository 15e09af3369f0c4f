"""Recorded trials as a LeRobot dataset (v3) for imitation learning, one episode each."""

import json
from itertools import compress
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.backends.clock import PERIOD_S
from hexctl.columns import RECORDED
from hexctl.errors import InputError, MissingExtraError, RecordingError
from hexctl.export.recordings import OnProgress, Trials, title_of
from hexctl.files import OnDamage, log_damage
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.types import JOINT_NAMES, FloatArray

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
    **{column.feature: column.parts for column in RECORDED if column.feature is not None},
}
#: Numbers of a frame.
SCALARS = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}


def write_lerobot(
    trials: Trials, folder: Path, on_progress: OnProgress, on_damage: OnDamage = log_damage
) -> None:
    """Write trials of one robot as a LeRobot dataset into a new folder.

    `action` contains the commanded joint angles, `observation.state` the measured ones, both in rad. Each
    number of pose and sensors is included if all trials have it throughout; `on_damage` takes others. Frames
    are evenly spaced, with interpolated values. Raises InputError for trials of several robots, and
    MissingExtraError without pandas and pyarrow.
    """
    pa, pq, pandas = _libraries()
    robots, texts, episodes, done = set[str](), list[str](), list[dict[str, Any]](), 0
    ever = {name: np.zeros(len(parts), dtype=bool) for name, parts in VECTORS.items()}
    always = {name: ~known for name, known in ever.items()}
    for number, trial in enumerate(trials):
        robots.add(trial.robot.name)
        texts.append(task_of(trial))
        vectors = _vectors(trial)
        for name, values in vectors.items():
            ever[name] |= np.isfinite(values).any(axis=0)
            always[name] &= np.isfinite(values).all(axis=0)
        episodes.append(_frames(trial, vectors, number, done, list(dict.fromkeys(texts)).index(texts[-1])))
        done += len(episodes[-1]["index"])
        on_progress(number + 1, len(trials))
    if len(robots) != 1:
        raise InputError(f"lerobot: got {len(robots)} robots, {', '.join(sorted(robots))}; allowed: one")
    parts = {name: list(compress(VECTORS[name], known)) for name, known in always.items() if known.any()}
    names = [*parts, *SCALARS]
    for columns in episodes:
        columns.update({name: columns[name][:, always[name]] for name in parts})
    for name in sorted(VECTORS):
        if lost := list(compress(VECTORS[name], ever[name] & ~always[name])):
            of = f" ({', '.join(lost)})" if name in parts else ""
            on_damage(RecordingError(f"{name}{of}, which is not known in all ticks of all recordings"))
    tasks = list(dict.fromkeys(texts))
    data, episodes_file = folder / DATA.format(chunk_index=0, file_index=0), folder / EPISODES
    for parent in (data.parent, episodes_file.parent):
        parent.mkdir(parents=True)
    vector_types = {name: pa.list_(pa.float32(), len(kept)) for name, kept in parts.items()}
    scalar_types = {name: pa.type_for_alias(kind) for name, kind in SCALARS.items()}
    schema = pa.schema(vector_types | scalar_types)
    with pq.ParquetWriter(data, schema, compression="zstd") as writer:
        for columns in episodes:
            arrays = [_arrow(pa, columns[field.name], field.type) for field in schema]
            writer.write_table(pa.Table.from_arrays(arrays, schema=schema), row_group_size=len(arrays[-1]))
    rows = [
        _episode(text, {name: one[name] for name in names}) for text, one in zip(texts, episodes, strict=True)
    ]
    pq.write_table(pa.Table.from_pylist(rows), episodes_file)
    index = pandas.Index(tasks, name="task")
    pandas.DataFrame({"task_index": range(len(tasks))}, index=index).to_parquet(folder / "meta/tasks.parquet")
    stats = {name: _stats(np.concatenate([one[name] for one in episodes])) for name in names}
    _write_json(folder / "meta/stats.json", stats)
    _write_json(folder / "meta/info.json", _info(robots.pop(), parts, len(texts), done, len(tasks)))


def task_of(trial: RecordedTrial) -> str:
    """Text of a trial's task: all of its plan; only its title if it was driven, or if the end is missing."""
    title, task = title_of(trial), trial.properties.get("task")
    return title if task is None or task in title else f"{task} with {title}"


def _libraries() -> tuple[Any, Any, Any]:
    try:
        import pandas
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise MissingExtraError("LeRobot export", "data") from error
    return pa, pq, pandas


def _vectors(trial: RecordedTrial) -> dict[str, FloatArray]:
    """The `VECTORS` of a trial at its ticks, (T, components), NaN where unknown."""
    sensors = {
        column.feature: trial.sensors[column.name].at_every_tick(len(trial))
        if column.name in trial.sensors
        else np.full((len(trial), len(column.parts)), np.nan)
        for column in RECORDED
        if column.feature is not None
    }
    return {
        "action": trial.commanded_rad,
        "observation.state": trial.measured_rad,
        "observation.pose": np.column_stack([trial.base_position_world, trial.base_quaternion_world]),
        **sensors,
    }


def _frames(
    trial: RecordedTrial, vectors: dict[str, FloatArray], number: int, before: int, task: int
) -> dict[str, Any]:
    """Columns of an episode by name."""
    length = round(float(trial.time_s[-1]) * FPS) + 1
    times_s = np.arange(length) / FPS
    if len(trial) != length or not np.allclose(trial.time_s, times_s, atol=1e-6):
        vectors = {name: _resampled(trial, values, times_s) for name, values in vectors.items()}
        for column in RECORDED:
            if column.kind is bool and column.feature is not None:
                vectors[column.feature] = np.round(vectors[column.feature])
    return {
        **{name: values.astype(np.float32) for name, values in vectors.items()},
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


def _episode(text: str, columns: dict[str, Any]) -> dict[str, Any]:
    index = columns["index"]
    return {
        "episode_index": int(columns["episode_index"][0]),
        "tasks": [text],
        "length": len(index),
        "data/chunk_index": 0,
        "data/file_index": 0,
        "dataset_from_index": int(index[0]),
        "dataset_to_index": int(index[-1]) + 1,
        **{
            f"stats/{name}/{key}": value
            for name, column in columns.items()
            for key, value in _stats(column).items()
        },
        "meta/episodes/chunk_index": 0,
        "meta/episodes/file_index": 0,
    }


def _stats(values: FloatArray) -> dict[str, list[float]]:
    """Statistics of each component of values, (frames,) or (frames, components)."""
    exact = values.astype(float).reshape(len(values), -1)
    quantiles = np.quantile(exact, list(QUANTILES.values()), axis=0)
    return {
        "min": exact.min(axis=0).tolist(),
        "max": exact.max(axis=0).tolist(),
        "mean": exact.mean(axis=0).tolist(),
        "std": exact.std(axis=0).tolist(),
        "count": [len(values)],
        **dict(zip(QUANTILES, quantiles.tolist(), strict=True)),
    }


def _info(robot: str, parts: dict[str, list[str]], episodes: int, frames: int, tasks: int) -> dict[str, Any]:
    vectors = {
        name: {"dtype": "float32", "shape": [len(kept)], "names": kept} for name, kept in parts.items()
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
