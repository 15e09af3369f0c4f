"""Quantiles in the statistics of LeRobot datasets: current policies scale by them."""

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest

from hexctl.export.lerobot import DATA, EPISODES, QUANTILES, _stats, write_lerobot
from hexctl.recording.recorded_trial import RecordedTrial
from hexctl.types import FloatArray


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
        assert len(stats[name]["min"]) == values.shape[1]


def test_episodes_have_their_own_quantiles(walk: RecordedTrial, tmp_path: Path) -> None:
    write_lerobot([walk], tmp_path / "set", lambda *_: None)
    episodes = pd.read_parquet(tmp_path / "set" / EPISODES)
    for key in ("q01", "q10", "q50", "q90", "q99"):
        assert len(episodes[f"stats/action/{key}"].iloc[0]) == 18


@pytest.mark.parametrize("values", [np.zeros((1, 2)), np.full((7, 1), 3.5), np.arange(200.0).reshape(100, 2)])
def test_quantiles_lie_between_minimum_and_maximum(values: FloatArray) -> None:
    stats = _stats(values)
    ordered = np.array([stats[key] for key in ("min", *QUANTILES, "max")])
    assert (np.diff(ordered, axis=0) >= 0).all()
