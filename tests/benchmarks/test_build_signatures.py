"""The builder of leg signatures: frames of legs, mirror images, and what it learns."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks import build_signatures
from benchmarks.build_signatures import BATCHES, Examples, learned, mirrored, to_legs, walks_of
from hexctl.control.monitor.leg_signatures import SENSORS
from hexctl.gait.gait import make_gait
from tests.robots import shipped


@pytest.mark.parametrize("seen", SENSORS)
def test_frames_of_legs_and_mirror_images_keep_sizes(seen: str) -> None:
    turns = to_legs(shipped(), make_gait(shipped(), "ripple"), seen)
    assert turns @ np.swapaxes(turns, 1, 2) == pytest.approx(np.stack([np.eye(turns.shape[-1])] * 6))
    some = np.random.default_rng(0).standard_normal((6, turns.shape[-1] + 3))
    assert (mirrored(mirrored(some, seen), seen) == some).all()
    assert (mirrored(some, seen) != some).any()


def test_it_learns_which_leg_leans(monkeypatch: pytest.MonkeyPatch) -> None:
    for name, value in {"NETWORKS": 1, "PASSES": 60, "UNITS": 4}.items():
        monkeypatch.setattr(build_signatures, name, value)
    random = np.random.default_rng(0)
    legs = random.integers(0, 7, 2000)
    features = 0.3 * random.standard_normal((2000, 6, 27)).astype(np.float32)
    features[legs > 0, legs[legs > 0] - 1, :12] += 1.0
    found = learned(Examples(features, legs), "lean")
    weights = np.concatenate([found.patterns.reshape(len(found.biases), -1), found.sizes], axis=1)
    odds = np.tanh(features @ weights.T + found.biases) @ found.outputs[:-1] + found.outputs[-1]
    said = np.where(odds.max(axis=1) > 0, odds.argmax(axis=1) + 1, 0)
    assert (said == legs).mean() > 0.95


@pytest.mark.slow
def test_batches_have_a_name_each_and_draw_what_they_say() -> None:
    assert len({batch.name for batch in BATCHES}) == len(BATCHES)
    walks = walks_of(replace(next(batch for batch in BATCHES if batch.at_s == 6.5), worlds=1))
    assert len(walks) == 6
    assert all(walk.trial.events[0].leg == walk.leg and walk.at_s >= 6.5 for walk in walks)
