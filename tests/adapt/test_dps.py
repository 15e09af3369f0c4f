"""The reconstructed differential particle scheme: its equation, its archive, and what stagnation does."""

import numpy as np
import pytest

from hexctl.adapt.dps import DifferentialSwarm
from hexctl.types import FloatArray
from tests.adapt.continuous import make, minimum, sphere


def swarm_of(seed: int, dimension: int = 2) -> DifferentialSwarm:
    swarm = make(DifferentialSwarm, seed, dimension)
    assert isinstance(swarm, DifferentialSwarm)
    return swarm


def test_the_archive_holds_the_last_ten_successes_and_starts_as_generation_1() -> None:
    swarm = swarm_of(0)
    successes: list[tuple[float, ...]] = []
    idle = np.zeros(10, dtype=int)
    best = np.full(10, np.inf)
    for _ in range(30):
        positions, scores = swarm.positions.copy(), sphere(swarm.positions)
        for particle in range(10):
            if scores[particle] < best[particle]:
                best[particle], idle[particle] = scores[particle], 0
                successes.append(tuple(positions[particle]))
            else:
                idle[particle] += 1
        swarm.advance(scores)
        np.testing.assert_array_equal(swarm.archive, successes[-10:])
        np.testing.assert_array_equal(swarm.archive_scores, sphere(np.array(successes[-10:])))
        np.testing.assert_array_equal(swarm.idle, idle)


def moved(idle: int, seed: int = 1) -> tuple[DifferentialSwarm, FloatArray]:
    """Return a swarm after one fruitless generation at rest, and where it stood; it was idle before.

    Memories lie at -1, the best one at -2; the archive at 3, its best at 4.
    """
    swarm = swarm_of(seed, 1)
    swarm.kept = np.full((10, 1), -1.0)
    swarm.kept[9] = -2.0
    swarm.kept_scores = np.array([1.0] * 9 + [0.0])
    swarm.archive = np.full((10, 1), 3.0)
    swarm.archive[0] = 4.0
    swarm.archive_scores = np.array([0.5] + [1.0] * 9)
    swarm.known[:] = True
    swarm.velocities[:] = 0.0
    swarm.idle[:] = idle
    before = swarm.positions.copy()
    swarm.advance(np.full(10, 1e9))
    return swarm, before


def test_a_particle_follows_the_best_and_a_difference_of_memories() -> None:
    swarm, before = moved(idle=2)  # now 3: not more than Q
    # v = 0.5 r1 (p_a - p_b) + 2 r2 (-2 - x), and memories differ by at most 1.
    pulled = 2.0 * (-2.0 - before)
    reach = 0.5
    low, high = np.minimum(pulled, 0.0) - reach, np.maximum(pulled, 0.0) + reach
    assert ((swarm.velocities >= low - 1e-12) & (swarm.velocities <= high + 1e-12)).all()
    assert len(np.unique(swarm.velocities / pulled)) > 5


def test_a_stagnating_particle_takes_its_parents_from_the_archive() -> None:
    for seed in range(20):
        swarm, _ = moved(idle=3, seed=seed)  # now 4: more than Q = 3
        # From 3, its place in the archive, toward 4, and aside by half a difference of at most 1.
        assert (swarm.positions >= 2.5 - 1e-12).all()
        # The first starts at 4, where there is nothing to go toward.
        assert abs(swarm.positions[0, 0] - 4.0) <= 0.5


def test_without_stagnation_it_is_not_the_archive() -> None:
    swarm, _ = moved(idle=0)
    assert (swarm.positions < 2.5).any()


def test_a_success_ends_the_stagnation() -> None:
    swarm = swarm_of(2)
    swarm.advance(np.full(10, 1.0))
    for _ in range(5):
        swarm.advance(np.full(10, 1.0))
    assert (swarm.idle == 5).all()
    swarm.advance(np.array([0.5] + [1.0] * 9))
    np.testing.assert_array_equal(swarm.idle, [0] + [6] * 9)


def test_it_converges_on_the_sphere() -> None:
    found = [minimum(DifferentialSwarm, sphere, 100, seed) for seed in range(30)]
    assert np.median(found) < 1e-4


def test_its_docstring_says_that_it_is_a_reconstruction() -> None:
    assert "RECONSTRUCTION" in str(DifferentialSwarm.__doc__)
    assert DifferentialSwarm.patience == pytest.approx(3)
