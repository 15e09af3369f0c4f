"""Landscapes for tests: made up in an instant, or really walked for a moment."""

from collections.abc import Sequence

import numpy as np

from hexctl.backends.sim.world import World
from hexctl.control.trial_plan import SelfRotation
from hexctl.study.landscape import NUMBERS, Landscape, LandscapeSpec
from hexctl.study.paper.paper_study import PaperStudy
from hexctl.study.paper.searches import Findings, search_all
from hexctl.study.walking import Silent
from hexctl.types import FloatArray
from tests.robots import shipped


def spec(
    leg: int = 5,
    self_rotation: SelfRotation = "none",
    duration_s: float = 0.4,
    codes: Sequence[int] = range(1, 121),
) -> LandscapeSpec:
    return LandscapeSpec(
        robot=shipped(),
        world=World(),
        leg=leg,
        self_rotation=self_rotation,
        duration_s=duration_s,
        seed=0,
        codes=tuple(codes),
    )


def made_up(
    leg: int, self_rotation: SelfRotation, signed_m: FloatArray, invalid: Sequence[int] = ()
) -> Landscape:
    """A landscape with these signed deviations; `invalid` are codes that made no progress."""
    return made_up_in(spec(leg, self_rotation, duration_s=1.0), signed_m, invalid)


def made_up_in(asked: LandscapeSpec, signed_m: FloatArray, invalid: Sequence[int] = ()) -> Landscape:
    """The landscape of a spec, made up likewise."""
    numbers = np.zeros((120, len(NUMBERS)))
    numbers[:, NUMBERS.index("signed_m")] = signed_m
    numbers[:, NUMBERS.index("distance_m")] = 4.0
    status = np.where(np.isin(asked.codes, list(invalid)), "no_progress", "ok").astype("<U16")
    paths = np.zeros((120, asked.n_points, 2), dtype=np.float32)
    paths[..., 0] = np.linspace(0, 4, asked.n_points)
    paths[..., 1] = signed_m[:, np.newaxis] * np.linspace(0, 1, asked.n_points)
    return Landscape(spec=asked, status=status, numbers=numbers, paths_m=paths)


def spread_out(worst_m: float, sign: FloatArray | float = 1.0) -> FloatArray:
    """120 deviations, evenly from 0 to the worst, in an order that no search finds smooth."""
    order = np.random.default_rng(1).permutation(120)
    return np.asarray(np.linspace(0.001, worst_m, 120)[order] * sign)


def made_up_findings(
    rotated_m: FloatArray,
    left: dict[int, float] | None = None,
    *,
    legs: tuple[int, ...] = (1, 2, 3, 4, 5, 6),
    optimizers: tuple[str, ...] = ("pso", "psosp", "dps", "debest", "derand", "random"),
    runs: int = 3,
    budget: int = 120,
    duration_s: float = 30.0,
) -> Findings:
    """Findings in which each leg has a share of its gaits on the left without self-rotation.

    Paths are those of a second, whatever the duration: no number depends on them.
    """
    left = left or {1: 0.5, 2: 1.0, 3: 1.0, 4: 0.5, 5: 0.0, 6: 0.0}
    plan = PaperStudy(
        robot=shipped(), legs=legs, optimizers=optimizers, runs=runs, budget=budget, duration_s=duration_s
    )
    landscapes = []
    for leg in legs:
        sign = np.where(np.arange(120) < 120 * left[leg], 1.0, -1.0)
        signed = (spread_out(2.0, sign), rotated_m)
        landscapes += [made_up(leg, "none", signed[0]), made_up(leg, "rear", signed[1])]
    return search_all(plan, landscapes)


class Remembering(Silent):
    """Remembers stages and notes, counts steps, and interrupts after some of the walks.

    Args:
        interrupt_after: number of steps after which it raises KeyboardInterrupt; None for never.
    """

    def __init__(self, interrupt_after: int | None = None) -> None:
        self.stages: list[tuple[str, int]] = []
        self.notes: list[str] = []
        self.steps, self._left = 0, interrupt_after

    def stage(self, name: str, steps: int) -> None:
        self.stages.append((name, steps))

    def step(self, steps: int = 1) -> None:
        self.steps += steps
        if self._left is not None and self.steps >= self._left:
            raise KeyboardInterrupt

    def note(self, text: str) -> None:
        self.notes.append(text)

    @property
    def walks(self) -> int:
        """Number of walks that were to be simulated."""
        return sum(steps for name, steps in self.stages if name.startswith("walks"))
