"""Options of a study, and of what simulates it."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.robot_options import SEED
from hexctl.control.trial_plan import DURATION_S, SelfRotation
from hexctl.errors import InputError, argument
from hexctl.options import RARE, Panel, Range, Typed, check_fields, check_used, listed
from hexctl.robot.failure_grammar import parse_legs
from hexctl.types import N_LEGS

ALL_LEGS = tuple(range(1, N_LEGS + 1))

JOBS = Range(low=1, high=1024, whole=True)
RUNS = Range(low=1, high=999, whole=True)
BUDGET = Range(low=1, high=10_000, whole=True)
WORLDS = Range(low=1, high=1000, whole=True)

#: Seeds of studies with searches, which make seeds of their own from it.
STUDY_SEED = Range(low=0, high=10_000, whole=True)

TIME_STEP_MS = Range(low=0.5, high=5, unit="ms")

#: Length of a tick; a whole number of physics steps.
TICK_MS = round(1000 * PERIOD_S)

#: Kinds of studies, by the option that selects each; without one it is `PAPER`.
PAPER, TRANSFER, MATRIX, HOLD, RECOVERY = "paper", "transfer", "matrix", "hold", "recovery"
ASKED_KINDS = (TRANSFER, MATRIX, HOLD, RECOVERY)

#: Kinds of studies that take an option; the options not listed are for all.
TAKEN_BY = {
    "self_rotation": (PAPER, MATRIX, HOLD),
    "optimizers": (PAPER, TRANSFER, MATRIX),
    "runs": (PAPER, TRANSFER, MATRIX, RECOVERY),
    "budget": (PAPER, TRANSFER, MATRIX),
    "seed": (PAPER, TRANSFER, MATRIX, RECOVERY),
    "prior": (TRANSFER,),
    "one_leg": (TRANSFER,),
    "time_steps_ms": (MATRIX,),
    "holds": (HOLD,),
    "gaits": (RECOVERY,),
    "methods": (RECOVERY,),
    "protocols": (RECOVERY,),
    "exact_sensors": (HOLD, RECOVERY),
    "dask": (PAPER, TRANSFER, MATRIX),
}

EXPERIMENT, SEARCHES, WALK, ONE_KIND = map(Panel, ("Experiment", "Searches", "Walk", "One kind of study"))


def _time_steps(text: str) -> tuple[float, ...]:
    """Steps of the physics in ms; raises ValueError unless a tick is a whole number of each."""
    steps_ms = tuple(float(TIME_STEP_MS.parse(part)) for part in listed(text))
    for step_ms in steps_ms:
        if abs(round(TICK_MS / step_ms) * step_ms - TICK_MS) > 1e-6:
            raise ValueError(f"got {step_ms:g}; allowed: {TICK_MS} ms divided by a whole number")
    return steps_ms


@dataclass(frozen=True, slots=True, kw_only=True)
class ComputeOptions:
    """Options for the computation of studies and priors."""

    PANEL: ClassVar = "Computer"

    jobs: Annotated[int | None, JOBS, RARE] = None
    """Threads that simulate, {}. (default: all cores; with --dask 1)"""

    dask: Annotated[str | None, RARE] = None
    """Address of a Dask scheduler whose workers simulate: tcp://HOST:PORT. (default: this computer)"""


@dataclass(frozen=True, slots=True, kw_only=True)
class StudyOptions(ComputeOptions):
    """Options of `hexctl study`.

    Raises InputError for an invalid value, and for an option of another kind of study.
    """

    PANEL: ClassVar = "Kind of study"

    transfer: bool = False
    """Compare the optimizers in held-out worlds."""

    matrix: bool = False
    """Test the claims in several settings: lists of --failure, --world, --robot and --time-steps. Each
    setting varies one of them from the first of each list.
    """

    hold: bool = False
    """Compare open loop, yaw feedback and pose feedback in held-out worlds. --failure, --world and --robot
    take lists.
    """

    recovery: bool = False
    """Compare reactions to a leg that fails during a walk. --failure, --world and --robot take lists."""

    robot: Annotated[str | None, Typed(words="robots"), EXPERIMENT] = None
    """Robot: a name that hexctl robot list prints, or a YAML file. (default: ant; with --matrix
    ant,phantomx,pexod)
    """

    world: Annotated[str | None, Typed(words="worlds"), EXPERIMENT] = None
    """Simulated world: flat, slippery, slope, rough, a YAML file, or one of a family such as randomised:7.
    With --transfer, --hold and --recovery: a family, transfer or real. (default: flat; with --transfer and
    --hold transfer, with --recovery both)
    """

    legs: Annotated[Sequence[int], Typed(parse=parse_legs), EXPERIMENT] = ALL_LEGS
    """Legs that fail, with commas."""

    failure: Annotated[str | None, Typed(words="failures"), EXPERIMENT] = None
    """How they fail: locked (stiff), limp, missing, weak:FRACTION of the torque, stuck:JOINT:DEGREES, or
    unknown to the controller. (default: locked; with --hold, --recovery and --matrix several)
    """

    worlds: Annotated[int | None, WORLDS, EXPERIMENT] = None
    """Number of worlds, {}. With --transfer, --hold and --recovery they are held out (default: 30; 10 of each
    family). Otherwise --world and up to 99 similar ones (default: 1; with --matrix 3).
    """

    duration_s: Annotated[float, DURATION_S, EXPERIMENT] = 30.0
    """Seconds that each gait walks, {}."""

    self_rotation: Annotated[SelfRotation | None, RARE, EXPERIMENT] = None
    """Turn before the walk until the failed leg points to the rear or the front, or none: no turn. (default:
    rear; with --hold rear for heading, otherwise none)
    """

    exact_sensors: Annotated[bool, RARE, EXPERIMENT] = False
    """With --hold and --recovery, simulate sensors without delay, noise and losses."""

    seed: Annotated[int, SEED, RARE, EXPERIMENT] = 0
    """Seed of everything random, a whole number, {}."""

    optimizers: Annotated[Sequence[str] | None, Typed(parse=listed, words="searches"), SEARCHES] = None
    """Optimizers, with commas: {}, or a custom package.module:Class; with --transfer also bayes and
    bayes-early. (default: the paper's five and random)
    """

    runs: Annotated[int | None, RUNS, SEARCHES] = None
    """Runs of each optimizer on each leg, {}; with --recovery, of each set of legs. (default: 30; with
    --transfer 5, with --recovery 10)
    """

    budget: Annotated[int | None, BUDGET, SEARCHES] = None
    """Trials per run, {}. (default: 120; with --transfer 60)"""

    prior: Annotated[str | None, Typed(words="priors"), RARE, ONE_KIND] = None
    """With --transfer, the prior of bayes: auto or a file. (default: auto)"""

    one_leg: Annotated[bool, RARE, ONE_KIND] = False
    """With --transfer, only one leg fails in each world, by turns, in a sixth of the time."""

    time_steps_ms: Annotated[
        Sequence[float] | None, Typed(flag="time-steps", parse=_time_steps), RARE, ONE_KIND
    ] = None
    """With --matrix, time steps of the physics in ms, with commas. (default: 2,4)"""

    holds: Annotated[Sequence[str] | None, Typed(parse=listed), RARE, ONE_KIND] = None
    """With --hold, the holds to compare, with commas: none, heading, line. (default: all)"""

    gaits: Annotated[Sequence[str] | None, Typed(parse=listed), RARE, ONE_KIND] = None
    """With --recovery, gaits before the failure, with commas: names, or auto. (default: tripod)"""

    methods: Annotated[Sequence[str] | None, Typed(parse=listed), RARE, ONE_KIND] = None
    """With --recovery, the reactions, with commas: nothing (always), told, recover, stop-diagnose,
    decentralised, open-loop-best, ppo, trial-and-error, cma-es, or a custom package.module:Class. (default:
    nothing,told,recover)
    """

    protocols: Annotated[Sequence[str] | None, Typed(parse=listed), RARE, ONE_KIND] = None
    """With --recovery, protocols, with commas: line (a leg or joint fails after 8 s of --duration, in
    held-out worlds), hexaheal (one or two legs lose torque after 4 s of 14 s), second (one leg after 8 s of
    36 s, another 10 s later). (default: line,hexaheal)
    """

    out: Annotated[Path | None, Panel("Output")] = None
    """Folder for the report: new, empty, or of an earlier study, which is replaced. (default:
    runs/study-TIME)
    """

    def __post_init__(self) -> None:
        check_fields(self)
        asked = [kind for kind in ASKED_KINDS if getattr(self, kind)]
        if len(asked) > 1:
            one, other = map(argument, asked[:2])
            raise InputError(f"{other} cannot be combined with {one}")
        for name, kinds in TAKEN_BY.items():
            if self.kind not in kinds:
                check_used(self, (name,), self._where(kinds))

    @property
    def kind(self) -> str:
        """Kind of the study: `paper`, or one of `ASKED_KINDS`."""
        return next((kind for kind in ASKED_KINDS if getattr(self, kind)), PAPER)

    def _where(self, kinds: Sequence[str]) -> str:
        """Condition under which an option of other kinds of study is allowed."""
        if PAPER in kinds:
            return f"without {argument(self.kind)}"
        return "with " + " or ".join(map(argument, kinds))
