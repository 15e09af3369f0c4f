"""Landscape: the outcome of every gait for one failed leg."""

import math
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from functools import cached_property
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import NDArray

from hexctl.adapt.objectives import INVALID_SCORE
from hexctl.adapt.space import GaitSpace
from hexctl.backends.clock import PERIOD_S
from hexctl.control.batch import SimTrial
from hexctl.control.planning.static_stability import in_posture, usual_posture
from hexctl.control.trial_plan import Hold, SelfRotation
from hexctl.control.trial_result import QUALITIES, STATUSES, TrialResult
from hexctl.robot.failure import Failure
from hexctl.robot.failure_grammar import parse_kind
from hexctl.runs.run_spec import RunSpec
from hexctl.runs.walk_plan import plan_walk
from hexctl.study.walk_cache import Place, known
from hexctl.types import ArrayFields, BoolArray, FloatArray

#: Ticks between the kept points of a path: 5 points per second.
PATH_STRIDE = 10

#: Numbers kept of each gait, named as in its result; NaN where unknown.
NUMBERS = ("signed_m", "distance_m", "yaw_change_rad", *QUALITIES)

N_CODES = 120


@dataclass(frozen=True, slots=True, kw_only=True)
class GaitWalk:
    """Outcome of one gait; NaN if unknown.

    Attributes:
        case: code of the gait.
        signed_m: deviation at the end, positive to the left.
        path_m: progress and signed deviation, five points a second.
    """

    case: int
    status: Literal[STATUSES]  # type: ignore[valid-type]
    signed_m: float
    distance_m: float
    yaw_change_rad: float
    energy_j: float
    cost_of_transport: float
    tilt_deg: float
    steadiness: float
    path_m: tuple[tuple[float, float], ...]

    @classmethod
    def of(cls, case: int, _trial: SimTrial, result: TrialResult) -> "GaitWalk":
        """Return the outcome of a gait from the result of its trial."""
        return cls(
            case=case,
            status=result.status,
            signed_m=math.nan if result.deviation is None else float(result.deviation.signed),
            **{name: known(getattr(result, name)) for name in NUMBERS[1:]},
            path_m=tuple(
                map(tuple, result.path_m[PATH_STRIDE - 1 :: PATH_STRIDE].astype(np.float32).tolist())
            ),
        )


@dataclass(frozen=True, kw_only=True)
class LandscapeSpec(Place[int, GaitWalk]):
    """Settings of a landscape: everything that decides its numbers except the code that computes them.

    Attributes:
        leg: the failed leg, 1..6.
        self_rotation: where the failed leg points during the walk: `rear`, `front`, or `none`: no turn.
        failure: of the leg, in the words of `parse_kind`, such as `limp` or `weak:0.5`.
        seed: of sensor noise, rough floors, and what an `unknown` failure breaks.
        placed: True to put the robot down as its self-rotation would leave it, instead of turning.
        miss_rad: yaw by which that self-rotation would have turned too far; only with `placed`.
        codes: the gaits, ascending.
        place: label of the world where there are several; decides no number.
        hold: what the walks hold by feedback, one of `hexctl.control.trial_plan.HOLDS`.
    """

    WALK: ClassVar[type[GaitWalk]] = GaitWalk

    leg: int
    self_rotation: SelfRotation
    duration_s: float = 30.0
    failure: str = "locked"
    seed: int = 0
    placed: bool = False
    miss_rad: float = 0.0
    codes: tuple[int, ...] = tuple(range(1, N_CODES + 1))
    place: str = ""
    hold: Hold = "none"

    @property
    def leg_failure(self) -> Failure:
        """The failure of the leg, of the simulation, which the controller knows."""
        return parse_kind(self.leg, self.failure)

    @cached_property
    def space(self) -> GaitSpace:
        """Gaits of the remaining legs."""
        return GaitSpace((self.leg,))

    @property
    def stem(self) -> str:
        """First part of the cache file's name."""
        return f"leg{self.leg}-{self.self_rotation}"

    @property
    def title(self) -> str:
        """Name of the landscape for reports and progress."""
        turned = {"none": "without self-rotation"}.get(self.self_rotation, "with self-rotation")
        return f"leg {self.leg} {turned}" + (f", {self.place}" if self.place else "")

    @property
    def n_points(self) -> int:
        """Number of points of a complete path."""
        return math.ceil(self.duration_s / PERIOD_S - 1e-9) // PATH_STRIDE

    def trial(self, case: int) -> SimTrial:
        """Return the trial of a code."""
        walk = RunSpec(
            gait=case,
            duration_s=self.duration_s,
            failure=self.leg_failure,
            self_rotation=self.self_rotation,
            hold=self.hold,
        )
        plan = in_posture(self.robot, plan_walk(walk, self.robot), usual_posture(self.hold))
        trial = SimTrial(
            robot=self.robot, plan=plan, failures=plan.failures, world=self.world, seed=self.seed
        )
        return trial.put_down_turned(self.miss_rad) if self.placed else trial

    def settings(self) -> dict[str, Any]:
        """Settings that decide a walk."""
        names = ("self_rotation", "duration_s", "seed", "placed", "miss_rad", "hold")
        return {name: getattr(self, name) for name in names} | {
            "failure": asdict(self.leg_failure),
            "codes": list(self.codes),
        }

    def outcome(self, walks: Sequence[GaitWalk]) -> str:
        """Describe finished walks in few words."""
        return f"{sum(walk.status == 'ok' for walk in walks)} of {len(walks)} gaits valid"


@dataclass(frozen=True, kw_only=True, eq=False)
class Landscape(ArrayFields):
    """The outcomes of all gaits of a spec; row i belongs to `spec.codes[i]`.

    Attributes:
        status: one of `hexctl.control.trial_result.STATUSES`, (n,).
        numbers: one column for each of `NUMBERS`, (n, 7).
        paths_m: progress and signed deviation, five points a second, the last one at the end; NaN after the
            end of the walk, (n, P, 2).
    """

    spec: LandscapeSpec
    status: NDArray[np.str_]
    numbers: FloatArray
    paths_m: NDArray[np.float32]

    @classmethod
    def of(cls, spec: LandscapeSpec, walks: Sequence[GaitWalk]) -> "Landscape":
        """Return the landscape of the walks of all its codes."""
        paths = np.full((len(walks), spec.n_points, 2), np.nan, dtype=np.float32)
        for path, walk in zip(paths, walks, strict=True):
            path[: len(walk.path_m)] = np.reshape(walk.path_m, (-1, 2))
        return cls(
            spec=spec,
            status=np.array([walk.status for walk in walks], dtype="<U16"),
            numbers=np.array([[getattr(walk, name) for name in NUMBERS] for walk in walks]),
            paths_m=paths,
        )

    @property
    def codes(self) -> NDArray[np.int64]:
        """Codes of the gaits, (n,)."""
        return np.array(self.spec.codes, dtype=np.int64)

    def number(self, name: str) -> FloatArray:
        """One column of `NUMBERS`, (n,)."""
        return self.numbers[:, NUMBERS.index(name)]

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
        """Scores by the objective `final`, as optimizers get them, (n,)."""
        return np.where(self.valid, self.final_m, INVALID_SCORE)

    @property
    def ends(self) -> tuple[int, int]:
        """Number of gaits that end on the left and on the right, valid or not."""
        signed = self.number("signed_m")
        return int((signed > 0).sum()), int((signed <= 0).sum())

    @property
    def left_share(self) -> float:
        """Share of gaits that end on the left, among those with an end; NaN without any."""
        left, right = self.ends
        return left / (left + right) if left + right else math.nan

    def within(self, limit_m: float) -> int:
        """Return the number of valid gaits that end within a distance of the line."""
        return int((self.final_m[self.valid] <= limit_m).sum())

    @property
    def best_m(self) -> float:
        """Smallest final deviation of all valid gaits in m; NaN without any."""
        return float(self.final_m[self.valid].min()) if self.valid.any() else math.nan

    @property
    def worst_m(self) -> float:
        """Largest final deviation of all valid gaits in m, of which there has to be one."""
        return float(self.final_m[self.valid].max())

    def row_of(self, code: int) -> int:
        """Row of a code."""
        return self.spec.codes.index(code)
