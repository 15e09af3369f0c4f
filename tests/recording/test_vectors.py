"""Joint angles as vectors, by the rules of rerun-lerobot: a column each, an increasing time of day."""

from pathlib import Path
from typing import Any

import numpy as np
import pyarrow as pa
import pytest

from hexctl.recording import paths
from hexctl.recording.rrd_reader import read_chunks
from tests.recording.conftest import Trial, write


def column(path: Path, entity: str) -> tuple[np.ndarray, np.ndarray]:
    """Times of day in ns and values of a column, as the index of a query joins them."""
    found: list[tuple[Any, Any]] = []
    for batch in read_chunks(path):
        if {"Scalars:scalars", paths.WALL_TIMELINE} <= set(batch.schema.names):
            if batch.schema.metadata[b"rerun:entity_path"].decode() != f"/{entity}":
                continue
            index = batch.column(paths.WALL_TIMELINE)
            assert pa.types.is_timestamp(index.type), "rerun-lerobot reads no durations"
            assert index.type.unit == "ns"
            found.append((index.cast(pa.int64()).to_numpy(), batch.column("Scalars:scalars").to_pylist()))
    times, values = zip(*found, strict=True)
    return np.concatenate(times), np.array([one for part in values for one in part])


def test_action_and_state_are_vectors_at_every_tick(trial: Trial, tmp_path: Path) -> None:
    path = write(tmp_path / "trial.rrd", trial)
    times_ns, action = column(path, paths.ACTION)
    same_ns, state = column(path, paths.OBSERVATION)
    assert np.array_equal(times_ns, same_ns), "one row holds both"
    assert (np.diff(times_ns) > 0).all()
    assert np.diff(times_ns) / 1e9 == pytest.approx(np.diff(trial.log["time_s"]), abs=1e-6)
    for read, name in ((action, "commanded_rad"), (state, "measured_rad")):
        assert read.shape == (len(trial.log), 18)
        assert read == pytest.approx(trial.log[name], abs=np.radians(0.09)), "finer than servos resolve"
        assert np.can_cast(read.dtype, np.float32, "same_kind")
