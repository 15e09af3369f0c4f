"""Speciation: who follows whom, crowded species, and niches that last."""

from typing import ClassVar

import numpy as np

from hexctl.adapt.pso import ParticleSwarm
from hexctl.adapt.psosp import SpeciatedSwarm
from hexctl.types import FloatArray
from tests.adapt.continuous import make, sphere


class Boundless(SpeciatedSwarm):
    radius: ClassVar[float] = 2.0


class Small(SpeciatedSwarm):
    most_per_species: ClassVar[int] = 3
    radius: ClassVar[float] = 2.0


def scored(core: type[SpeciatedSwarm], places: list[float]) -> SpeciatedSwarm:
    """Return a swarm in the box [1, 101] that remembers these places, best first."""
    swarm = core([1.0], [101.0], np.random.default_rng(0), len(places))
    swarm.kept = np.array(places)[:, np.newaxis]
    swarm.kept_scores = np.arange(len(places), dtype=float)
    swarm.known[:] = True
    return swarm


def test_a_particle_joins_the_first_seed_within_a_tenth_of_the_range() -> None:
    #                               seed  near  seed  seed  near both: joins the fitter  at r    beyond
    swarm = scored(SpeciatedSwarm, [50.0, 57.0, 64.0, 10.0, 58.0, 20.0, 30.5])
    np.testing.assert_array_equal(swarm.species(), [0, 0, 2, 3, 0, 3, 6])


def test_species_follow_the_best_scores_not_the_order_of_particles() -> None:
    swarm = scored(SpeciatedSwarm, [50.0, 57.0, 64.0])
    swarm.kept_scores = np.array([3.0, 2.0, 1.0])
    np.testing.assert_array_equal(swarm.species(), [0, 2, 2])


def test_in_a_box_of_unequal_sides_each_side_counts_alike() -> None:
    swarm = SpeciatedSwarm([0.0, 0.0], [1.0, 1000.0], np.random.default_rng(0), 4)
    swarm.kept = np.array([[0.5, 500.0], [0.5, 590.0], [0.59, 500.0], [0.5, 610.0]])
    swarm.kept_scores = np.arange(4.0)
    np.testing.assert_array_equal(swarm.species(), [0, 0, 0, 3])


def test_one_species_over_the_whole_box_is_the_plain_swarm() -> None:
    plain, speciated = make(ParticleSwarm, 7), make(Boundless, 7)
    for _ in range(40):
        np.testing.assert_array_equal(speciated.positions, plain.positions)
        plain.advance(sphere(plain.positions))
        speciated.advance(sphere(speciated.positions))


def test_ten_particles_are_never_too_many() -> None:
    swarm = make(SpeciatedSwarm, 8)
    for _ in range(60):
        swarm.advance(sphere(swarm.positions))
        assert swarm.known.all()


def test_a_crowded_species_keeps_its_best_and_draws_the_rest_anew() -> None:
    swarm = make(Small, 9)
    best = np.inf
    for _ in range(20):
        scores = sphere(swarm.positions)
        better = np.where(swarm.known, np.minimum(scores, swarm.kept_scores), scores)
        best = min(best, scores.min())
        swarm.advance(scores)
        np.testing.assert_array_equal(swarm.kept_scores, better)  # the redrawn have forgotten
        np.testing.assert_array_equal(np.flatnonzero(swarm.known), np.sort(np.argsort(better)[:3]))
        assert swarm.kept_scores.min() == best


def two_valleys(points: FloatArray) -> FloatArray:
    """Minima 0 at (-3, -3) and 0.1 at (3, 3)."""
    return np.minimum(sphere(points + 3.0), sphere(points - 3.0) + 0.1)


def test_the_species_keep_both_valleys_where_the_plain_swarm_ends_in_one() -> None:
    both = {}
    for core in (ParticleSwarm, SpeciatedSwarm):
        both[core] = 0
        for seed in range(20):
            swarm = core([-5.0, -5.0], [5.0, 5.0], np.random.default_rng(seed), 30)
            for _ in range(40):
                swarm.advance(two_valleys(swarm.positions))
            ends = swarm.positions[sphere(np.abs(swarm.positions) - 3.0) < 0.1]
            both[core] += bool((ends[:, 0] < 0).any() and (ends[:, 0] > 0).any())
    assert both[SpeciatedSwarm] >= 18
    assert both[ParticleSwarm] <= 2
