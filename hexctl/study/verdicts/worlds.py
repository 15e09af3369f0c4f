"""Worlds like a given one: the repeated measurements over which a study gives intervals."""

from collections.abc import Sequence

import numpy as np

from hexctl.backends.sim.distribution import Distribution
from hexctl.backends.sim.world import World
from hexctl.errors import InputError, argument

#: What the paper leaves open and no leg is favoured by, as factors on the world's own values: floor, servos,
#: contacts. Neither joint offsets nor a shifted trunk are among them: legs that are one experiment stay one.
FACTORS = {
    "friction": Distribution(low=1 / 1.3, high=1.3, scale="log"),
    "servo_stiffness": Distribution(low=1 / 1.3, high=1.3, scale="log"),
    "contact_time_s": Distribution(low=1 / 1.5, high=1.5, scale="log"),
}

#: Seed of the design, so that the same world always has the same neighbours.
SEED = 13

#: More neighbours than this narrow no interval worth the time.
MAX_WORLDS = 100


def nearby_worlds(world: World, count: int) -> list[World]:
    """The world itself and `count` - 1 others like it.

    The others differ in friction, stiffness of the servos and contact time, by `FACTORS`, in a quasi-random
    design of which any beginning covers the ranges. Raises InputError for a count outside 1..`MAX_WORLDS`.
    """
    if not 1 <= count <= MAX_WORLDS:
        raise InputError(f"{argument('worlds')}: got {count}; allowed: 1..{MAX_WORLDS}")
    if count == 1:
        return [world]
    shares = _design(count - 1)
    return [world, *(_varied(world, row) for row in shares)]


def _design(count: int) -> list[list[float]]:
    """Points of a Sobol design in the unit cube, one row per world."""
    from scipy.stats.qmc import Sobol

    sequence = Sobol(len(FACTORS), scramble=True, rng=np.random.default_rng(SEED))
    # One at a time keeps SciPy from warning about the balance of what is left out.
    return [sequence.random(1)[0].tolist() for _ in range(count)]


def _varied(world: World, shares: Sequence[float]) -> World:
    values = world.model_dump()
    for (name, factor), share in zip(FACTORS.items(), shares, strict=True):
        values[name] = float(values[name] * factor.at(np.array(share)))
    return World.model_validate(values)
