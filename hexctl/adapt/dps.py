"""`dps`: a differential particle scheme with successful parents. A reconstruction, not the original."""

from collections.abc import Sequence
from typing import ClassVar

import numpy as np

from hexctl.adapt.population import POPULATION, IntArray, PopulationOptimizer
from hexctl.adapt.pso import ParticleSwarm
from hexctl.types import BoolArray, FloatArray


class DifferentialSwarm(ParticleSwarm):
    """Particles moved by difference vectors, with parents from an archive of successes on stagnation.

    This is a RECONSTRUCTION. The paper names DPS (Parque, "differential particle scheme with successive
    parent selection", CEC 2021); its equations are in no source that was open to us. What stands here is put
    together from its title and two published parents:

        v ← ω v + c1 r1 (p_a - p_b) + c2 r2 (p_g - x),   x ← x + v

    The difference between the best positions of two other particles a and b takes the place of the particle's
    own best, as in PSO with differentially perturbed velocity (Das, Konar, Chakraborty, GECCO 2005). p_g is
    the best of all. When a particle has not improved its best for more than Q generations, p_a, p_b and p_g
    come from an archive of the last 10 successes instead, and its x becomes the archive's i-th; a success is
    a position that improved its particle's best. That is Guo, Yang, Hsu, Tsai, "Improving differential
    evolution with a successful-parent-selecting framework", IEEE TEVC 19(5), 2015, and as in its authors'
    code the archive starts as generation 1.

    Parameters: ω = 0.5, c1 = 0.5, c2 = 2, 10 particles (the paper's, for swarms), Q = 3.

    Assumed: the form of the velocity, that c1 weighs the difference, and Q. Guo's code has Q = 70, made for
    100 individuals and thousands of generations; in the paper's 12 it would never act. The original may
    differ in all of these, may choose its parents otherwise ("successive"), and may accept moves only when
    they improve, which this does not. Results of `dps` are not results of Parque's DPS.
    """

    patience: ClassVar[int] = 3

    arrays: ClassVar[tuple[str, ...]] = (*ParticleSwarm.arrays, "idle", "archive", "archive_scores")

    def __init__(
        self,
        low: Sequence[float] | FloatArray,
        high: Sequence[float] | FloatArray,
        random: np.random.Generator,
        size: int = POPULATION,
    ) -> None:
        super().__init__(low, high, random, size)
        self.idle: IntArray = np.zeros(size, dtype=np.int64)  # generations without success
        self.archive = self.positions.copy()
        self.archive_scores = np.zeros(size)

    def _move(self, better: BoolArray) -> None:
        self._remember(better)
        stuck = (self.idle > self.patience)[:, np.newaxis]
        plus, minus = (np.where(stuck, self.archive[i], self.kept[i]) for i in self._others(2))
        best_of_archive = self.archive[self.archive_scores.argmin()]
        best = np.where(stuck, best_of_archive, self.kept[self.kept_scores.argmin()])
        self.positions = np.where(stuck, self.archive, self.positions)
        self._fly(plus - minus, best - self.positions)

    def _remember(self, better: BoolArray) -> None:
        """Count generations without success and put the successes of this one into the archive."""
        self.idle = np.where(better, 0, self.idle + 1)
        self.archive = np.concatenate([self.archive, self.kept[better]])[-self.size :]
        scores = np.concatenate([self.archive_scores, self.kept_scores[better]])
        self.archive_scores = scores[-self.size :]


class Dps(PopulationOptimizer):
    """The reconstructed differential particle scheme over codes; see `DifferentialSwarm`."""

    name = "dps"
    core = DifferentialSwarm
