"""Settings of a repertoire: which situations, which candidates, which worlds."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from pathlib import Path
from typing import Annotated, Literal
from zlib import crc32

import numpy as np

from hexctl.backends.sim.world import DomainRandomization
from hexctl.control.body_symmetry import BodySymmetry, body_symmetries
from hexctl.control.monitor.repertoire import (
    INTACT_GAIT,
    SAFEST,
    SUFFIX,
    WALK_ON,
    Candidate,
    FailedParts,
    Repertoire,
    Situation,
    moved_parts,
    parts_of,
    save_repertoire,
)
from hexctl.control.planning.crawl import crawl_on, gait_without
from hexctl.control.planning.static_stability import STAND_UP, slots_by_stability
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.walks.turning import check_plan
from hexctl.errors import LimitError, ReachError
from hexctl.gait.gait import Gait, make_gait
from hexctl.gait.posture import Posture
from hexctl.options import Range, Typed
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_coming_kind, parse_kind
from hexctl.robot.model import Robot
from hexctl.study.held_out import FAILURES, members
from hexctl.study.plan import Plan, check_families
from hexctl.study.priors.prior_building import TIME_STEP_S, begin_build, coarse_world
from hexctl.study.priors.prior_options import CODES
from hexctl.study.repertoire_walks import CandidateWalk, RepertoireCase, RepertoirePlace
from hexctl.study.versions import code_versions
from hexctl.study.walk_cache import Walked
from hexctl.study.walking import Work
from hexctl.types import N_LEGS

#: Number of the first world of each family.
FIRST_WORLD = 100

#: Maximum number of worlds; no benchmark uses these.
MOST_WORLDS = 16

#: How both legs of a pair fail.
PAIR_FAILURES = ("locked", "limp", "missing")


@dataclass(frozen=True, kw_only=True)
class RepertoirePlan(Plan):
    """Settings of one repertoire.

    Attributes:
        failures: of single legs, as `parse_kind` reads them.
        codes: number of candidate codes, next by static margin. As many are drawn at random, as a
            check of that ranking.
    """

    robot: Robot
    families: Annotated[dict[str, DomainRandomization], Typed(flag="family")]
    worlds: Annotated[int, Range(low=1, high=MOST_WORLDS, whole=True)] = 4
    directions: Literal[1, 2, 4, 6, 8, 12] = 12
    failures: tuple[str, ...] = FAILURES
    pair_failures: tuple[str, ...] = PAIR_FAILURES
    codes: Annotated[int, CODES] = 2

    @property
    def gait(self) -> Gait:
        """The gait of the intact robot."""
        return make_gait(self.robot, INTACT_GAIT)

    @cached_property
    def symmetries(self) -> tuple[BodySymmetry, ...]:
        """Symmetries of the robot that move each direction of travel to another one."""
        found = body_symmetries(self.robot)
        return tuple(one for one in found if abs(math.remainder(one.turn_deg, self.step_deg)) < 1e-3)

    @property
    def step_deg(self) -> float:
        """Angle between directions of travel."""
        return 360.0 / self.directions

    @cached_property
    def situations(self) -> tuple[tuple[tuple[Failure, ...], float], ...]:
        """Failures and directions of travel to walk, one of each group of equivalent ones."""
        legs = range(1, N_LEGS + 1)
        single = [(parse_kind(leg, text),) for text in self.failures for leg in legs]
        pairs = [
            (parse_kind(one, text), parse_kind(other, text))
            for text in self.pair_failures
            for one, other in combinations(legs, 2)
        ]
        headings_deg = [math.remainder(self.step_deg * k, 360.0) for k in range(self.directions)]
        found: list[tuple[tuple[Failure, ...], float]] = []
        known: set[tuple[FailedParts, float]] = set()
        for failures in (*single, *pairs):
            for heading_deg in headings_deg:
                parts = parts_of(failures)
                if (parts, _key_deg(heading_deg)) in known:
                    continue
                found.append((failures, heading_deg))
                known |= {
                    (moved_parts(parts, one.legs), _key_deg(one.heading_deg(heading_deg)))
                    for one in self.symmetries
                }
        return tuple(found)

    def places(self) -> list[RepertoirePlace]:
        """Return the worlds, those of all families by turns."""
        places = [
            RepertoirePlace(**one) for one in members([self.robot], self.families, FIRST_WORLD, self.worlds)
        ]
        coarse = [
            replace(one, world=coarse_world(self.families[one.family], one.number, one.world))
            for one in places
        ]
        return sorted(coarse, key=lambda one: one.number)

    @cached_property
    def cases(self) -> tuple[RepertoireCase, ...]:
        """Return the walks in each of the worlds, situation by situation."""
        return tuple(
            RepertoireCase(failures=texts_of(failures), heading_deg=heading_deg, candidate=candidate)
            for failures, heading_deg in self.situations
            for candidate in self.candidates(failures, heading_deg)
        )

    def walked(self) -> Walked:
        """Return the cases to walk, place by place."""
        return [(place, self.cases) for place in self.places()]

    def candidates(self, failures: Sequence[Failure], heading_deg: float) -> tuple[Candidate, ...]:
        """Candidates of a situation that the legs can walk, the safest gait first, none of them twice."""
        found: dict[Gait, Candidate] = {}
        for name, gait in self._gaits(failures, math.radians(heading_deg)):
            if gait not in found and (name == SAFEST or self._walkable(gait, heading_deg)):
                found[gait] = Candidate.of(name, gait)
        return tuple(found.values())

    def _gaits(self, failures: Sequence[Failure], heading_rad: float) -> Iterator[tuple[str, Gait]]:
        legs = tuple(one.leg for one in failures)
        raised = replace(self.gait, posture=Posture(body_raise=STAND_UP))
        safest = gait_without(self.robot, raised, heading_rad=heading_rad, legs=legs)
        yield SAFEST, safest
        yield WALK_ON, self.gait
        yield "not raised", replace(safest, posture=replace(safest.posture, body_raise=0.0))
        if any(one.joint for one in failures):  # targets of an entire failed leg change nothing
            standing = replace(safest.posture, body_raise=0.0, tucked_legs=())
            yield "not tucked", replace(safest, posture=standing)
        tucked = replace(self.gait, posture=Posture(body_raise=STAND_UP, tucked_legs=legs))
        lost = [Failure(leg=leg, kind="limp") for leg in legs]
        ranked = slots_by_stability(self.robot, heading_rad=heading_rad, failure=lost)
        if len(legs) > 1:
            crawl = crawl_on(self.robot, tucked, heading_rad=heading_rad)
            yield from [("crawl", crawl)] if crawl is not None else []
            yield "code 1", replace(tucked, slots=ranked[0])
        for rank in range(1, self.codes + 1):
            yield f"code {rank + 1}", replace(tucked, slots=ranked[rank])
        random = np.random.default_rng(crc32(f"{texts_of(failures)} {heading_rad:.6f}".encode()))
        for rank in sorted(random.choice(range(self.codes + 1, len(ranked)), self.codes, False).tolist()):
            yield f"code {rank + 1}", replace(tucked, slots=ranked[rank])

    def _walkable(self, gait: Gait, heading_deg: float) -> bool:
        plan = TrialPlan(gait=gait, heading_rad=math.radians(heading_deg), self_rotation="none", hold="line")
        try:
            check_plan(self.robot, plan)
        except (ReachError, LimitError):
            return False
        return True

    def check(self) -> None:
        """Raise InputError for invalid settings, before anything runs."""
        check_families(self.families, "family")
        for text in (*self.failures, *self.pair_failures):
            parse_coming_kind(1, text)


def _key_deg(heading_deg: float) -> float:
    """Direction in degrees as a key: rounded, and equal for -180 and 180."""
    return round(heading_deg % 360.0, 3) % 360.0


def texts_of(failures: Sequence[Failure]) -> tuple[str, ...]:
    """Failures as the events of a walk name them, without the angle at which a joint sticks."""
    kinds = [f"{one.kind}:{one.joint}" if one.joint else one.kind for one in failures]
    return tuple(f"{one.leg}:{kind}" for one, kind in zip(failures, kinds, strict=True))


def build_repertoire(plan: RepertoirePlan, path: Path, work: Work | None = None) -> Repertoire:
    """Simulate the candidates of all situations in the worlds of a plan, and write the repertoire to a file.

    Arguments and errors are those of `hexctl.study.priors.prior_building.build_prior`.
    """
    work = work or Work()
    begin_build(plan, path, SUFFIX, work)
    walks = work.walk(plan.walked())
    repertoire = repertoire_of(plan, [walk for some in walks for walk in some])
    save_repertoire(repertoire, path)
    return repertoire


def repertoire_of(plan: RepertoirePlan, walks: Sequence[CandidateWalk]) -> Repertoire:
    """Repertoire of a plan from its walks, world by world in the order of `plan.walked()`."""
    by_case: dict[RepertoireCase, list[CandidateWalk]] = {case: [] for case in plan.cases}
    for walk in walks:
        by_case[walk.case].append(walk)
    situations = []
    for failures, heading_deg in plan.situations:
        candidates = plan.candidates(failures, heading_deg)
        rows = [
            by_case[RepertoireCase(failures=texts_of(failures), heading_deg=heading_deg, candidate=candidate)]
            for candidate in candidates
        ]
        situations.append(
            Situation(
                failed=parts_of(failures),
                heading_deg=heading_deg,
                candidates=candidates,
                speeds=np.array([[walk.speed for walk in row] for row in rows]),
                costs=np.array([[walk.cost for walk in row] for row in rows]),
            )
        )
    gait = plan.gait
    return Repertoire(
        robot=plan.robot.name,
        robot_fingerprint=plan.robot.fingerprint,
        pace_hz=gait.pace_hz,
        amplitude=gait.amplitude,
        height=gait.height,
        direction_step_deg=plan.step_deg,
        symmetries=plan.symmetries,
        situations=tuple(situations),
        origin={
            "families": list(plan.families),
            "first_world": FIRST_WORLD,
            "worlds": plan.worlds,
            "time_step_s": TIME_STEP_S,
            "code": code_versions(),
        },
    )
