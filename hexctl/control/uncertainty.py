"""The simulation's own uncertainty: how far a walk ends elsewhere when it is computed otherwise.

It is measured once for a robot, a time step, a friction cone and a duration, and kept: values of the shipped
robots come with hexctl, those of `hexctl check --physics` lie in the folder of sessions and recordings.
"""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import yaml
from pydantic import BaseModel, ConfigDict, Field

from hexctl.backends.base import as_robot
from hexctl.backends.sim.world import World, as_world
from hexctl.control.batch import SimTrial, run_sim_trials
from hexctl.control.plan import TrialPlan
from hexctl.errors import InputError
from hexctl.files import atomic_write
from hexctl.gait.gait import make_gait
from hexctl.robot.configs import Number, config_root, read_mapping, validate
from hexctl.robot.failure import Failure
from hexctl.robot.model import Robot
from hexctl.types import FloatArray

#: A looser tolerance of the solver: MuJoCo's own default.
LOOSE_TOLERANCE = 1e-8

#: By what the contact time is multiplied and divided: floor and feet a third softer or harder.
CONTACT_FACTOR = 4 / 3

#: Walks of these outcomes have no end.
ENDLESS = ("fell", "diverged")

#: The smallest time step of a world.
LEAST_STEP_S = 0.0005

#: Walks by which a robot's uncertainty is measured: ten gaits, with two failed legs that trail.
LEGS = (2, 5)
CODES = (5, 16, 29, 41, 54, 66, 79, 92, 103, 116)


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationUncertainty:
    """Root mean square change of where walks end across their line, in m.

    Attributes:
        step_m: with the time step halved.
        solver_m: with the solver's tolerance at MuJoCo's default.
        contact_m: with contacts that give way by `CONTACT_FACTOR` slower and faster. How soft floor and feet
            are is an assumption about the world, not an error of the computation: it is not in `numerical_m`.
        walks: number of walks.
        duration_s: how long each of them walked.
    """

    step_m: float
    solver_m: float
    contact_m: float
    walks: int
    duration_s: float

    @property
    def numerical_m(self) -> float:
        """Standard uncertainty of the computation: step and solver together."""
        return float(np.hypot(self.step_m, self.solver_m))

    def to_dict(self) -> dict[str, Any]:
        """JSON values, lengths rounded to 0.1 mm."""
        lengths = {name: round(getattr(self, name), 4) for name in ("step_m", "solver_m", "contact_m")}
        return {
            **lengths,
            "numerical_m": round(self.numerical_m, 4),
            "walks": self.walks,
            "duration_s": self.duration_s,
        }


def uncertainty_of_walks(trials: Sequence[SimTrial]) -> SimulationUncertainty:
    """Uncertainty of walks of one duration, by walking each of them five times.

    Walks that have no end, because the robot fell, are left out. Raises InputError for walks of several
    durations, for a time step that cannot be halved, and where no walk is left.
    """
    duration_s = _duration_s(trials)
    least_s = min(trial.world.time_step_s for trial in trials)
    if least_s / 2 < LEAST_STEP_S:
        raise InputError(f"time_step_s: got {least_s:g}; allowed: {2 * LEAST_STEP_S:g} or more, to halve it")
    plain = _ends_m(trials)
    step, solver, softer, harder = (
        _ends_m(
            [replace(trial, world=trial.world.model_copy(update=change(trial.world))) for trial in trials]
        )
        - plain
        for change in _CHANGES
    )
    known = np.isfinite(step + solver + softer + harder)
    if not known.any():
        raise InputError("walks: got none that walks to its end; allowed: at least one that does")
    return SimulationUncertainty(
        step_m=_rms(step[known]),
        solver_m=_rms(solver[known]),
        contact_m=_rms(np.concatenate([softer[known], harder[known]])),
        walks=int(known.sum()),
        duration_s=duration_s,
    )


#: What is changed of a world, in the order step, solver, softer, harder.
_CHANGES: tuple[Callable[[World], dict[str, float]], ...] = (
    lambda world: {"time_step_s": world.time_step_s / 2},
    lambda _: {"solver_tolerance": LOOSE_TOLERANCE},
    lambda world: {"contact_time_s": CONTACT_FACTOR * world.contact_time_s},
    lambda world: {"contact_time_s": world.contact_time_s / CONTACT_FACTOR},
)


def _duration_s(trials: Sequence[SimTrial]) -> float:
    """The one duration of all walks; raises InputError without any, or for several durations."""
    durations_s = sorted({trial.plan.duration_s for trial in trials})
    if len(durations_s) != 1:
        got = ", ".join(f"{duration_s:g}" for duration_s in durations_s) + " s" if durations_s else "none"
        raise InputError(f"duration_s of the walks: got {got}; allowed: walks of one duration")
    return durations_s[0]


def simulation_uncertainty(
    robot: Robot | str | Path,
    world: World | str | Path | None = None,
    *,
    duration_s: float = 30.0,
    codes: Sequence[int] = CODES,
) -> SimulationUncertainty:
    """Uncertainty of a robot's walks in a world, measured over some gaits and two failed legs.

    Args:
        robot: the robot, or the name or path of its file.
        world: where, or its name or path; flat unless given.
        duration_s: how long each walk takes.
        codes: the gaits, ten unless given; the more, the surer the result, and the longer it takes.

    Raises InputError as `uncertainty_of_walks` does, ReachError or LimitError for a robot that cannot walk.
    """
    model, place = as_robot(robot), as_world(world)
    trials = [_placed(model, place, leg, code, duration_s) for leg in LEGS for code in codes]
    return uncertainty_of_walks(trials)


def _placed(robot: Robot, world: World, leg: int, code: int, duration_s: float) -> SimTrial:
    """A walk with a locked leg that trails, put down turned instead of turning first."""
    failure = Failure(leg=leg)
    gait = make_gait(robot, str(code), failed_legs=(leg,))
    plan = TrialPlan(gait=gait, belief=failure, duration_s=duration_s)
    return SimTrial(robot=robot, plan=plan, failure=failure, world=world).put_down_turned()


def _ends_m(trials: Sequence[SimTrial]) -> FloatArray:
    """Signed deviation at the end of each walk; NaN for one that has no end."""
    ended = [result.deviation if result.status not in ENDLESS else None for result in run_sim_trials(trials)]
    return np.array([np.nan if deviation is None else deviation.signed for deviation in ended])


def _rms(values: FloatArray) -> float:
    return float(np.sqrt(np.mean(values**2)))


#: File of the values that were measured, in the folder of sessions and recordings; `configs` has one too.
UNCERTAINTIES = "uncertainty.yaml"

_Metres = Annotated[Number, Field(ge=0, allow_inf_nan=False)]
_Seconds = Annotated[Number, Field(gt=0, allow_inf_nan=False)]


class _Entry(BaseModel):
    """A measurement in a file; the ± of results is `numerical_m`, step and solver together."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: str
    fingerprint: str
    time_step_s: _Seconds
    friction_cone: Literal["elliptic", "pyramidal"]
    duration_s: _Seconds
    step_m: _Metres
    solver_m: _Metres
    contact_m: _Metres
    numerical_m: _Metres
    walks: Annotated[int, Field(ge=1)]
    how: str = ""

    @classmethod
    def of(cls, robot: Robot, world: World, found: SimulationUncertainty, how: str) -> "_Entry":
        """Entry of a measurement."""
        return cls(
            robot=robot.name,
            fingerprint=robot.fingerprint,
            time_step_s=world.time_step_s,
            friction_cone=world.friction_cone,
            how=how,
            **found.to_dict(),
        )

    def is_for(self, robot: Robot, world: World, duration_s: float) -> bool:
        """Whether this is the uncertainty of a robot's walks in a world."""
        return (
            self.fingerprint == robot.fingerprint
            and self.friction_cone == world.friction_cone
            and math.isclose(self.time_step_s, world.time_step_s)
            and math.isclose(self.duration_s, duration_s)
        )

    @property
    def uncertainty(self) -> SimulationUncertainty:
        """What was measured."""
        return SimulationUncertainty(
            step_m=self.step_m,
            solver_m=self.solver_m,
            contact_m=self.contact_m,
            walks=self.walks,
            duration_s=self.duration_s,
        )


class _Entries(BaseModel):
    """A file of measurements."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    measured: list[_Entry] = []


def known_uncertainty(
    robot: Robot | str | Path,
    world: World | str | Path | None = None,
    *,
    duration_s: float = 30.0,
    folder: Path | str = "runs",
) -> SimulationUncertainty | None:
    """Uncertainty of a robot's walks as it was measured before, or None where it was not.

    It is known by the robot's fingerprint, the world's time step and friction cone, and the duration; floor,
    load and servos of the world it was measured in may be others. What was measured here goes before what
    comes with hexctl.

    Args:
        robot: the robot, or the name or path of its file.
        world: where, or its name or path; flat unless given.
        duration_s: how long the walks take.
        folder: of sessions and recordings, with what was measured here.

    Raises InputError for a file of measurements that is damaged.
    """
    model, place = as_robot(robot), as_world(world)
    for path in (Path(folder) / UNCERTAINTIES, config_root() / UNCERTAINTIES):
        for entry in _entries(path):
            if entry.is_for(model, place, duration_s):
                return entry.uncertainty
    return None


def keep_uncertainty(
    robot: Robot, world: World, found: SimulationUncertainty, *, folder: Path | str = "runs", how: str = ""
) -> Path:
    """Keep a measurement for `known_uncertainty`, in place of an earlier one of the same; path of its file.

    Args:
        robot: the robot that walked.
        world: where.
        found: what was measured.
        folder: of sessions and recordings.
        how: how it was measured, for people.

    Raises InputError for a file that is damaged or cannot be written.
    """
    path = Path(folder) / UNCERTAINTIES
    others = [entry for entry in _entries(path) if not entry.is_for(robot, world, found.duration_s)]
    entries = [*others, _Entry.of(robot, world, found, how)]
    content = {"measured": [entry.model_dump() for entry in entries]}
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        atomic_write(path, yaml.safe_dump(content, sort_keys=False, allow_unicode=True))
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({error.strerror}); allowed: a writable folder"
        ) from error
    return path


def _entries(path: Path) -> list[_Entry]:
    """Measurements in a file; none where there is no file."""
    return validate(_Entries, read_mapping(path), path).measured if path.is_file() else []
