"""Repertoires built from walks in plausible worlds: which situations, which candidates, and the walks."""

import hashlib
import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cache, cached_property
from itertools import combinations
from pathlib import Path
from typing import Any
from zlib import crc32

import numpy as np

from hexctl.adapt.prior.samples import Symmetries
from hexctl.backends.sim.world import DomainRandomization, World
from hexctl.control.assessment.crawl import crawl_on, gait_without
from hexctl.control.assessment.static_stability import STAND_UP, slots_by_stability
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.monitor.repertoire import (
    IDENTITY,
    INTACT_GAIT,
    SAFEST,
    WALK_ON,
    BodySymmetry,
    Candidate,
    FailedParts,
    Repertoire,
    Situation,
    moved_parts,
    parts_of,
)
from hexctl.control.monitor.repertoire_store import SUFFIX, save_repertoire
from hexctl.control.plan import GaitChange, TrialPlan
from hexctl.control.result import STATUSES, TrialResult
from hexctl.control.turning import check_plan
from hexctl.errors import InputError, LimitError, ReachError, argument, check_type
from hexctl.gait.gait import Gait, ideal_speed_m_s, make_gait
from hexctl.gait.posture import Posture
from hexctl.robot.failure import Failure, parse_failure
from hexctl.robot.failure_event import parse_coming_failure, parse_failure_event
from hexctl.robot.model import Robot
from hexctl.study.cache import LandscapeCache
from hexctl.study.evaluate import Progress, Silent, check_jobs
from hexctl.study.plan import check_robot
from hexctl.study.prior import TIME_STEP_S
from hexctl.study.recovery.episodes import ENDED, Track
from hexctl.study.recovery.plan import FAILURES
from hexctl.study.versions import code_versions, source_digest
from hexctl.study.walks import WalkCache, walk_all
from hexctl.types import N_LEGS

#: Members of the families from this one on are walked.
FIRST_WORLD = 100

#: How many, at most: no benchmark uses them.
MOST_WORLDS = 16

#: How both legs of a pair fail.
PAIR_FAILURES = ("locked", "limp", "missing")

#: Numbers of directions of travel that are allowed, evenly spread from straight ahead on.
DIRECTIONS = (1, 2, 4, 6, 8, 12)

#: When the gait changes, and the failure comes before it at the latest and the earliest, in cycles.
CHANGE_CYCLES, ALARM_CYCLES, PHASES_CYCLES = 2.6, 0.4, 1.0

#: From when after the change on the speed is measured, and for how long, in cycles.
SETTLES_CYCLES, MEASURED_CYCLES = 2.0, 3.0

#: Situations whose walks are simulated together in a world.
TOGETHER = 8


@dataclass(frozen=True, kw_only=True)
class RepertoirePlan:
    """Settings of one repertoire.

    Attributes:
        robot: model of the robot.
        families: of plausible worlds, by name.
        worlds: number of worlds of each family.
        directions: number of directions of travel.
        failures: of single legs, in the words of `parse_failure`.
        pair_failures: of both legs of a pair.
        codes: how many next codes by the static margin are candidates, and as many drawn at random, as a
            check of that ranking.
    """

    robot: Robot
    families: dict[str, DomainRandomization]
    worlds: int = 4
    directions: int = 12
    failures: tuple[str, ...] = FAILURES
    pair_failures: tuple[str, ...] = PAIR_FAILURES
    codes: int = 2

    def __post_init__(self) -> None:
        check_robot(self.robot)
        check_type(self.families, dict, "plan.families", "families of worlds by name")
        for family in self.families.values():
            allowed = "a DomainRandomization, as load_randomization('transfer') gives"
            check_type(family, DomainRandomization, "plan.families", allowed)

    @property
    def gait(self) -> Gait:
        """The gait of the intact robot."""
        return make_gait(self.robot, INTACT_GAIT)

    @cached_property
    def symmetries(self) -> tuple[BodySymmetry, ...]:
        """Symmetries of the robot that move each direction of travel to another one."""
        found = [
            BodySymmetry(legs=one.legs, mirrored=one.mirrored, turn_deg=round(math.degrees(one.turn_rad), 6))
            for one in Symmetries(self.robot).all
        ]
        kept = [one for one in found if abs(math.remainder(one.turn_deg, self.step_deg)) < 1e-3]
        return (IDENTITY, *(one for one in kept if one.legs != IDENTITY.legs))

    @property
    def step_deg(self) -> float:
        """Angle between directions of travel."""
        return 360.0 / self.directions

    @cached_property
    def situations(self) -> tuple[tuple[tuple[Failure, ...], float], ...]:
        """Failures and directions of travel that are walked, of several that are alike one."""
        legs = range(1, N_LEGS + 1)
        single = [(parse_failure(leg, text),) for text in self.failures for leg in legs]
        pairs = [
            (parse_failure(one, text), parse_failure(other, text))
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

    def conditions(self) -> list["RepertoireConditions"]:
        """The worlds, those of all families by turns."""
        return [
            RepertoireConditions(
                robot=self.robot, family=name, number=number, world=_coarse(family, number, world)
            )
            for place in range(self.worlds)
            for name, family in self.families.items()
            for number, world in [(FIRST_WORLD + place, family.members(FIRST_WORLD + place, 1)[0])]
        ]

    @cached_property
    def cases(self) -> tuple["RepertoireCase", ...]:
        """What is walked in each of the worlds, situation by situation."""
        return tuple(
            RepertoireCase(failures=_texts(failures), heading_deg=heading_deg, candidate=candidate)
            for failures, heading_deg in self.situations
            for candidate in self.candidates(failures, heading_deg)
        )

    def walked(self) -> list[tuple["RepertoireConditions", tuple["RepertoireCase", ...]]]:
        """Conditions of all walks, and the cases under each."""
        return [(one, self.cases) for one in self.conditions()]

    def candidates(self, failures: Sequence[Failure], heading_deg: float) -> tuple[Candidate, ...]:
        """Candidates of a situation that the legs can walk, the safest gait first, none of them twice."""
        found: dict[Gait, Candidate] = {}
        for name, gait in self._gaits(failures, math.radians(heading_deg)):
            if gait not in found and (name == SAFEST or self._walkable(gait, heading_deg)):
                found[gait] = Candidate.of(name, gait)
        return tuple(found.values())

    def _gaits(self, failures: Sequence[Failure], heading_rad: float) -> Iterator[tuple[str, Gait]]:
        """Names and gaits that come into question."""
        legs = tuple(one.leg for one in failures)
        raised = replace(self.gait, posture=Posture(body_raise=STAND_UP))
        safest = gait_without(self.robot, raised, heading_rad=heading_rad, legs=legs)
        yield SAFEST, safest
        yield WALK_ON, self.gait
        yield "not raised", replace(safest, posture=replace(safest.posture, body_raise=0.0))
        if any(one.joint for one in failures):  # what a whole leg is told makes no difference
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
        random = np.random.default_rng(crc32(f"{_texts(failures)} {heading_rad:.6f}".encode()))
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
        """Raise InputError for anything that is not allowed, before anything runs."""
        if self.directions not in DIRECTIONS:
            allowed = ", ".join(map(str, DIRECTIONS))
            raise InputError(f"{argument('directions')}: got {self.directions}; allowed: {allowed}")
        if not 1 <= self.worlds <= MOST_WORLDS:
            raise InputError(f"{argument('worlds')}: got {self.worlds}; allowed: 1..{MOST_WORLDS}")
        for name, family in self.families.items():
            if family.failures:
                raise InputError(
                    f"{argument('family')}: got {name}, in which legs fail in mid-walk; allowed: families "
                    "without `failures`"
                )
        for text in (*self.failures, *self.pair_failures):
            parse_coming_failure(1, text)


@dataclass(frozen=True, slots=True, kw_only=True, order=True)
class RepertoireCase:
    """One walk under some conditions.

    Attributes:
        failures: leg and words of each failure, such as `5:stuck:femur`.
        heading_deg: direction of travel.
        candidate: gait and posture that the robot changes to.
    """

    failures: tuple[str, ...]
    heading_deg: float
    candidate: Candidate


@dataclass(frozen=True, kw_only=True)
class RepertoireConditions:
    """One robot in one world; a walk there is decided by this and its case.

    Attributes:
        robot: model of the robot.
        family: name of the world's family.
        number: of the world in its family, and the seed of what is drawn in it.
        world: the world.
    """

    robot: Robot
    family: str
    number: int
    world: World

    @property
    def title(self) -> str:
        """Name for progress and messages."""
        return f"{self.robot.name}, {self.family}:{self.number}"

    @property
    def change_s(self) -> float:
        """When the gait changes."""
        return round(CHANGE_CYCLES / self.robot.gait.pace_hz, 2)

    @property
    def measured_s(self) -> tuple[float, float]:
        """From when until when the speed is measured; the walk ends then."""
        first_s = self.change_s + SETTLES_CYCLES / self.robot.gait.pace_hz
        return first_s, first_s + MEASURED_CYCLES / self.robot.gait.pace_hz

    def trial(self, case: RepertoireCase) -> SimTrial:
        """Trial of a case: the failure comes at a random phase, and the gait changes an alarm later."""
        gait = make_gait(self.robot, INTACT_GAIT)
        text = f"{self.family} {case.failures} {case.heading_deg:g}"
        share = np.random.default_rng([self.number, crc32(text.encode())]).uniform()
        before_s = (ALARM_CYCLES + PHASES_CYCLES * share) / gait.pace_hz
        at_s = self.change_s - before_s
        plan = TrialPlan(
            gait=gait,
            heading_rad=math.radians(case.heading_deg),
            duration_s=self.measured_s[1],
            self_rotation="none",
            hold="line",
            changes=(GaitChange(gait=case.candidate.gait(gait), at_s=self.change_s),),
        )
        return SimTrial(
            robot=self.robot,
            plan=plan,
            failure=None,
            world=self.world,
            seed=self.number,
            events=[parse_failure_event(f"{text}@{at_s:.2f}") for text in case.failures],
        )

    @property
    def fingerprint(self) -> str:
        """Digest of all that decides a walk beside its case, 16 hexadecimal digits."""
        identity = {
            "robot": self.robot.fingerprint,
            "world": self.world.model_dump(mode="json"),
            "seed": self.number,
            "family": self.family,
            "code": _versions(),
        }
        return hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, slots=True, kw_only=True)
class CandidateWalk:
    """The outcome of one walk; NaN where it is not known.

    Attributes:
        case: what failed, and how the robot walked on.
        status: as in `hexctl.control.result.STATUSES`.
        speed: along the line while it was measured, as a share of what was commanded before the failure; NaN
            for a walk that did not end on its feet.
        cost: of transport of the whole walk.
    """

    case: RepertoireCase
    status: str
    speed: float
    cost: float

    @classmethod
    def of(
        cls, conditions: RepertoireConditions, case: RepertoireCase, trial: SimTrial, result: TrialResult
    ) -> "CandidateWalk":
        """Walk of a case from its trial and the result."""
        gait, ended = trial.plan.gait, result.status in ENDED
        speed_m_s = Track.of(result, gait).speed(*conditions.measured_s) if ended else math.nan
        cost = result.cost_of_transport if ended else None
        return cls(
            case=case,
            status=result.status,
            speed=float(speed_m_s / ideal_speed_m_s(trial.robot, gait, trial.plan.motion(0.0))),
            cost=math.nan if cost is None else float(cost),
        )

    @classmethod
    def from_dict(cls, values: dict[str, Any]) -> "CandidateWalk":
        """Walk of its values in a file; raises ValueError for what no simulation gives."""
        case = values["case"]
        candidate = Candidate.from_dict(case["candidate"])
        known = case | {"failures": tuple(case["failures"]), "candidate": candidate}
        walk = cls(**values | {"case": RepertoireCase(**known)})
        if walk.status not in STATUSES or math.isfinite(walk.speed) != (walk.status in ENDED):
            raise ValueError("it has values that no simulation gives")
        return walk


def walk_cases(
    conditions: RepertoireConditions, cases: Sequence[RepertoireCase], threads: int = 1
) -> list[CandidateWalk]:
    """Walks of some cases in one world, stepped together."""
    trials = [conditions.trial(case) for case in cases]
    results = run_sim_trials(trials, threads)
    return [
        CandidateWalk.of(conditions, case, trial, result)
        for case, trial, result in zip(cases, trials, results, strict=True)
    ]


def repertoire_cache(
    landscapes: LandscapeCache,
) -> WalkCache[RepertoireConditions, RepertoireCase, CandidateWalk]:
    """Walks on disk, a file for each robot and world, beside the landscapes of priors."""
    return WalkCache(landscapes, name="repertoire", read=CandidateWalk.from_dict)


def build_repertoire(
    plan: RepertoirePlan,
    path: Path,
    *,
    cache: LandscapeCache | None = None,
    jobs: int | None = None,
    dask: str | None = None,
    progress: Progress | None = None,
) -> Repertoire:
    """Simulate the candidates of all situations in the worlds of a plan, and write the repertoire to a file.

    Simulated walks are saved while this runs: a call that was interrupted is continued by the next one.

    Args:
        plan: robot, situations and worlds.
        path: of the file, ending in `.npz`; an existing file is replaced.
        cache: of landscapes, beside which the walks are kept; None is the one of the command line,
            `runs/study-cache`.
        jobs: threads that simulate; None is all cores here, one for each chunk on a Dask worker.
        dask: address of a Dask scheduler whose workers simulate; None simulates here.
        progress: observer.

    Raises InputError for a plan, a path or an address that cannot be used, RepertoireFileError or CacheError
    when the disk refuses a file.
    """
    cache, progress = cache or LandscapeCache(), progress or Silent()
    check_jobs(jobs)
    plan.check()
    if path.suffix != SUFFIX or path.is_dir():
        raise InputError(f"{argument('out')}: got {path}; allowed: a file whose name ends in {SUFFIX}")
    cache.probe()
    groups = {
        situation: place // TOGETHER
        for place, situation in enumerate(
            dict.fromkeys((case.failures, case.heading_deg) for case in plan.cases)
        )
    }
    walks = walk_all(
        plan.walked(),
        repertoire_cache(cache),
        walk_cases,
        lambda case: groups[case.failures, case.heading_deg],
        progress,
        jobs,
        dask=dask,
    )
    for note in cache.notes:
        progress.note(note)
    repertoire = repertoire_of(plan, [walk for _, walk in walks])
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
            by_case[RepertoireCase(failures=_texts(failures), heading_deg=heading_deg, candidate=candidate)]
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


def repertoire_file_name(plan: RepertoirePlan) -> str:
    """Name of a repertoire's file."""
    return plan.robot.name + SUFFIX


@cache
def _versions() -> dict[str, str]:
    return code_versions() | {"source": source_digest(__name__)}


def _key_deg(heading_deg: float) -> float:
    """A direction as a key: -180 and 180 are the same, and rounding is none."""
    return round(heading_deg % 360.0, 3) % 360.0


def _texts(failures: Sequence[Failure]) -> tuple[str, ...]:
    """Failures as the events of a walk name them, without the angle at which a joint sticks."""
    kinds = [f"{one.kind}:{one.joint}" if one.joint else one.kind for one in failures]
    return tuple(f"{one.leg}:{kind}" for one, kind in zip(failures, kinds, strict=True))


def _coarse(family: DomainRandomization, number: int, world: World) -> World:
    """A member of a family with the step of priors, unless its kind sets one."""
    if "time_step_s" in family.kind(number).world:
        return world
    return world.model_copy(update={"time_step_s": TIME_STEP_S})
