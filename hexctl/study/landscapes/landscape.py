"""Landscape: the outcome of every gait for one failed leg."""

import hashlib
import json
import math
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.world import World
from hexctl.control.assessment.static_stability import in_posture
from hexctl.control.batch import SimTrial
from hexctl.control.trial_plan import TrialPlan
from hexctl.control.trial_result import QUALITIES, TrialResult
from hexctl.gait.gait import Gait
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.robot.model import Robot
from hexctl.study.landscapes.versions import code_versions
from hexctl.types import ArrayFields, BoolArray, FloatArray

#: Ticks between the kept points of a path: 5 points per second.
PATH_STRIDE = 10

#: Numbers kept of each gait, named as in its result; NaN where unknown.
NUMBERS = (
    *("signed_m", "mean_m", "max_m", "distance_m", "yaw_change_rad", "turned_rad"),
    *QUALITIES,
)

N_CODES = 120


@dataclass(frozen=True, kw_only=True)
class LandscapeSpec:
    """Settings of a landscape: everything that decides its numbers except the code that computes them.

    Attributes:
        robot: model of the robot.
        world: the simulated world.
        leg: the failed leg, 1..6.
        self_rotation: where the failed leg points during the walk: `rear`, `front`, or `none`: no turn.
        duration_s: length of each walk.
        failure: of the leg, in the words of `parse_kind`, such as `limp` or `weak:0.5`.
        seed: of sensor noise, rough floors, and what an `unknown` failure breaks.
        placed: True to put the robot down as its self-rotation would leave it, instead of turning.
        miss_rad: yaw by which that self-rotation would have turned too far; only with `placed`.
        codes: the gaits, ascending.
        place: label of the world where there are several; decides no number.
        hold: what the walks hold by feedback, one of `hexctl.control.trial_plan.HOLDS`.
        posture: one of `hexctl.control.assessment.static_stability.POSTURES`.
    """

    robot: Robot
    world: World
    leg: int
    self_rotation: str
    duration_s: float = 30.0
    failure: str = "locked"
    seed: int = 0
    placed: bool = False
    miss_rad: float = 0.0
    codes: tuple[int, ...] = tuple(range(1, N_CODES + 1))
    place: str = ""
    hold: str = "none"
    posture: str = "stance"

    @property
    def leg_failure(self) -> Failure:
        """The failure of the leg, as the simulation is given it and the controller believes it."""
        return parse_kind(self.leg, self.failure)

    @cached_property
    def space(self) -> GaitSpace:
        """Gaits of the remaining legs."""
        return GaitSpace((self.leg,))

    @property
    def title(self) -> str:
        """Name of the landscape for reports and progress."""
        turned = {"none": "without self-rotation"}.get(self.self_rotation, "with self-rotation")
        return f"leg {self.leg} {turned}" + (f", {self.place}" if self.place else "")

    @property
    def n_points(self) -> int:
        """Number of points of a complete path."""
        return math.ceil(self.duration_s / PERIOD_S - 1e-9) // PATH_STRIDE

    def trial(self, code: int) -> SimTrial:
        """Trial of one gait."""
        default = self.robot.gait
        gait = Gait(
            slots=self.space.slots_of(code),
            pace_hz=default.pace_hz,
            amplitude=default.amplitude,
            height=default.height,
        )
        plan = TrialPlan(
            gait=gait,
            duration_s=self.duration_s,
            belief=self.leg_failure,
            self_rotation=self.self_rotation,
            hold=self.hold,
        )
        plan = in_posture(self.robot, plan, self.posture)
        trial = SimTrial(robot=self.robot, plan=plan, failure=plan.belief, world=self.world, seed=self.seed)
        return trial.put_down_turned(self.miss_rad) if self.placed else trial

    def identity(self) -> dict[str, Any]:
        """Plain JSON values that are equal for equal landscapes: settings and versions of the code."""
        failure = asdict(self.leg_failure)
        settings = {
            name: getattr(self, name)
            for name in ("self_rotation", "duration_s", "seed", "placed", "miss_rad")
        }
        settings |= {"hold": self.hold, "posture": self.posture}
        return {
            "robot": self.robot.fingerprint,
            "world": self.world.model_dump(mode="json"),
            "failure": failure,
            **settings,
            "codes": list(self.codes),
            "code": code_versions(),
        }

    @property
    def fingerprint(self) -> str:
        """Digest of the identity, 16 hexadecimal digits."""
        return hashlib.sha256(json.dumps(self.identity(), sort_keys=True).encode()).hexdigest()[:16]


@dataclass(frozen=True, kw_only=True, eq=False)
class Rows(ArrayFields):
    """The outcomes of some gaits, one row each.

    Attributes:
        codes: (n,).
        status: one of `hexctl.control.trial_result.STATUSES`; empty for a gait without a simulation, (n,).
        numbers: one column for each of `NUMBERS`, (n, 10).
        paths_m: progress and signed deviation, five points a second, the last one at the end; NaN where the
            walk was over, (n, P, 2).
    """

    codes: NDArray[np.int64]
    status: NDArray[np.str_]
    numbers: FloatArray
    paths_m: NDArray[np.float32]


@dataclass(frozen=True, kw_only=True, eq=False)
class Landscape(Rows):
    """The outcomes of all gaits of a spec; row i belongs to `spec.codes[i]`."""

    spec: LandscapeSpec

    def number(self, name: str) -> FloatArray:
        """One column of `NUMBERS`, (n,)."""
        return self.numbers[:, NUMBERS.index(name)]

    @property
    def done(self) -> BoolArray:
        """Which gaits were simulated, (n,)."""
        return np.asarray(self.status != "")

    @property
    def complete(self) -> bool:
        """Whether all gaits were simulated."""
        return bool(self.done.all())

    @property
    def missing(self) -> tuple[int, ...]:
        """Codes that were not simulated yet."""
        return tuple(self.codes[~self.done].tolist())

    @property
    def valid(self) -> BoolArray:
        """Which gaits are valid, (n,)."""
        return np.asarray(self.status == "ok")

    @property
    def final_m(self) -> FloatArray:
        """Final deviation in m, the paper's F, (n,); NaN where unknown."""
        return np.abs(self.number("signed_m"))

    @property
    def scores(self) -> FloatArray:
        """Scores by the objective `final`, as an optimizer is told, (n,)."""
        return np.where(self.valid, self.final_m, INVALID_SCORE)

    @property
    def best_m(self) -> float:
        """Smallest final deviation of all valid gaits in m; NaN without any."""
        return float(self.final_m[self.valid].min()) if self.valid.any() else math.nan

    def row_of(self, code: int) -> int:
        """Row of a code."""
        return self.spec.codes.index(code)


def empty_landscape(spec: LandscapeSpec) -> Landscape:
    """Landscape of a spec before any gait was simulated."""
    n = len(spec.codes)
    return Landscape(
        spec=spec,
        codes=np.array(spec.codes, dtype=np.int64),
        status=np.full(n, "", dtype="<U16"),
        numbers=np.full((n, len(NUMBERS)), np.nan),
        paths_m=np.full((n, spec.n_points, 2), np.nan, dtype=np.float32),
    )


def rows_of(spec: LandscapeSpec, codes: tuple[int, ...], results: list[TrialResult]) -> Rows:
    """Rows of the results of some codes, in their order."""
    paths = np.full((len(codes), spec.n_points, 2), np.nan, dtype=np.float32)
    for path, result in zip(paths, results, strict=True):
        points = result.path_m[PATH_STRIDE - 1 :: PATH_STRIDE]
        path[: len(points)] = points
    return Rows(
        codes=np.array(codes, dtype=np.int64),
        status=np.array([result.status for result in results], dtype="<U16"),
        numbers=np.array([_numbers_of(result) for result in results]).reshape(-1, len(NUMBERS)),
        paths_m=paths,
    )


def with_rows(landscape: Landscape, rows: Rows) -> Landscape:
    """Landscape with some rows filled in; raises ValueError for a code that is not in it."""
    at = np.searchsorted(landscape.codes, rows.codes)
    if not np.array_equal(landscape.codes[at.clip(max=len(landscape.codes) - 1)], rows.codes):
        raise ValueError(f"codes: got {rows.codes.tolist()}; allowed: those of the landscape")
    status, numbers, paths = landscape.status.copy(), landscape.numbers.copy(), landscape.paths_m.copy()
    status[at], numbers[at], paths[at] = rows.status, rows.numbers, rows.paths_m
    return Landscape(
        spec=landscape.spec, codes=landscape.codes, status=status, numbers=numbers, paths_m=paths
    )


def _numbers_of(result: TrialResult) -> list[float]:
    """Values of `NUMBERS`."""
    deviation = result.deviation
    signed, mean, most = (
        (deviation.signed, deviation.mean, deviation.max) if deviation is not None else (math.nan,) * 3
    )
    known = [
        math.nan if value is None else value
        for value in (
            *(result.distance_m, result.yaw_change_rad, result.turned_rad),
            *(getattr(result, name) for name in QUALITIES),
        )
    ]
    return [signed, mean, most, *known]
