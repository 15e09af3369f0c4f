"""Policies: their files, their numbers, and the shipped one."""

from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest

from hexctl.learning.learned_walk import ACTION_SIZE, OBSERVATION_SIZE
from hexctl.learning.policy import NetworkPolicy, load_policy


def small_policy() -> NetworkPolicy:
    """Two layers with weights that single precision holds."""
    first = np.array([[1.0, -0.5], [0.25, 2.0]]), np.array([0.5, -0.25])
    last = np.array([[1.0], [-1.5]]), np.array([0.125])
    return NetworkPolicy(layers=(first, last), robot_fingerprint="ant", origin={"steps": 3})


def test_its_action_is_that_of_the_network() -> None:
    (action,) = small_policy()(np.array([0.5, -1.0]))
    assert action == pytest.approx(np.tanh(0.75) - 1.5 * np.tanh(-2.5) + 0.125)


def test_a_file_keeps_it(tmp_path: Path) -> None:
    small_policy().save(tmp_path / "small.npz")
    found = load_policy(tmp_path / "small.npz")
    assert (found.robot_fingerprint, found.origin) == ("ant", {"steps": 3})
    for one, other in zip(found.layers, small_policy().layers, strict=True):
        np.testing.assert_array_equal(one[0], other[0])
        np.testing.assert_array_equal(one[1], other[1])


@pytest.mark.slow
def test_it_equals_torch() -> None:
    torch = pytest.importorskip("torch", reason="only with the extra `train`")
    random = np.random.default_rng(0)
    sizes = (OBSERVATION_SIZE, 64, 64, ACTION_SIZE)
    layers = tuple(
        (random.normal(size=(before, after)) / 8, random.normal(size=after))
        for before, after in pairwise(sizes)
    )
    policy = NetworkPolicy(layers=layers, robot_fingerprint="", origin={})
    values = torch.tensor(random.normal(size=(5, OBSERVATION_SIZE)), dtype=torch.float32)
    expected = values.double()
    for place, (weights, biases) in enumerate(layers):
        expected = expected @ torch.tensor(weights) + torch.tensor(biases)
        expected = torch.tanh(expected) if place < len(layers) - 1 else expected
    np.testing.assert_allclose(policy(values.numpy()), expected.numpy(), atol=1e-12)
