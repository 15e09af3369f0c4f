"""Measured uncertainties of the simulation, kept in files and looked up by robot, world and duration.

Values of the shipped robots come with hexctl, those of `hexctl check --physics` lie in the folder of sessions
and recordings. Nothing is simulated here; `hexctl.control.assessment.uncertainty` measures.
"""

import math
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Annotated, Any

import yaml
from pydantic import BaseModel, ConfigDict, Field

from hexctl.backends.base import as_robot
from hexctl.backends.sim.world import World, as_world
from hexctl.errors import InputError
from hexctl.files import atomic_write
from hexctl.robot.configs import Number, config_root, read_mapping, validate
from hexctl.robot.model import Robot

#: File of the values that were measured, in the folder of sessions and recordings; `configs` has one too.
UNCERTAINTIES = "uncertainty.yaml"

#: Two ends differ with a confidence of 95 % when they lie this many standard uncertainties apart: 1.96 for a
#: normal distribution, times the square root of 2 for two ends.
DISTINCT = 2.8

#: Time step of the walks that confirm the end of a gait, in s.
CONFIRM_STEP_S = 0.0005

#: What of a world is part of the computation: no measurement is lent from one to another of these.
COMPUTATION = ("time_step_s", "friction_cone", "solver_tolerance")

#: The failure of the legs of the walks by which a robot is measured.
MEASURED_FAILURE = "locked"


@dataclass(frozen=True, slots=True, kw_only=True)
class SimulationUncertainty:
    """Root mean square change of where walks end across their line, in m.

    Attributes:
        step_m: with the time step halved.
        solver_m: with the solver's tolerance at MuJoCo's default, which no shipped world uses: it is not in
            `numerical_m`.
        contact_m: with contacts that give way by a third slower and faster. How soft floor and feet are is an
            assumption about the world, not an error of the computation: it is not in `numerical_m` either.
        confirmed_m: with half the time step `CONFIRM_STEP_S`, from walks at that step; None if unknown.
        walks: number of walks.
        duration_s: how long each of them walked.
        low_m: lower bound of `numerical_m` with 95 % confidence, by resampling the walks; None if unknown.
        high_m: upper bound, likewise.
        borrowed: True where it was measured on the flat world and stands in for another one.
    """

    step_m: float
    solver_m: float
    contact_m: float
    confirmed_m: float | None = None
    walks: int
    duration_s: float
    low_m: float | None = None
    high_m: float | None = None
    borrowed: bool = False

    @property
    def numerical_m(self) -> float:
        """Standard uncertainty of the end of a walk by its computation: the change by half the time step.

        It is the difference between two computations, E(h) - E(h/2). For an integrator of first order the
        distance to the limit of small steps is twice that.
        """
        return self.step_m

    def caveat(self, failure: str) -> str:
        """How the walks that were measured differ from those with a failure, in words; empty if they do not.

        Args:
            failure: of the leg, as `parse_failure` reads it.
        """
        legs = [] if failure == MEASURED_FAILURE else [f"with {MEASURED_FAILURE} legs"]
        place = ["on the flat world"] if self.borrowed else []
        return f"measured {' '.join(legs + place)}" if legs or place else ""

    def to_dict(self) -> dict[str, Any]:
        """JSON values, lengths rounded to 0.1 mm."""
        return {
            name: round(value, 4) if name.endswith("_m") and value is not None else value
            for name, value in (asdict(self) | {"numerical_m": self.numerical_m}).items()
        }


_Metres = Annotated[Number, Field(ge=0, allow_inf_nan=False)]
_Seconds = Annotated[Number, Field(gt=0, allow_inf_nan=False)]


class _Entry(BaseModel):
    """A measurement in a file."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    robot: str
    fingerprint: str
    world: World
    duration_s: _Seconds
    step_m: _Metres
    solver_m: _Metres
    contact_m: _Metres
    confirmed_m: _Metres | None = None
    low_m: _Metres | None = None
    high_m: _Metres | None = None
    walks: Annotated[int, Field(ge=1)]
    how: str = ""

    @classmethod
    def of(cls, robot: Robot, world: World, found: SimulationUncertainty, how: str) -> "_Entry":
        """Entry of a measurement."""
        values = {name: value for name, value in found.to_dict().items() if name in cls.model_fields}
        return cls(robot=robot.name, fingerprint=robot.fingerprint, world=world, how=how, **values)

    def is_for(self, robot: Robot, world: World, duration_s: float) -> bool:
        """Whether this is the uncertainty of a robot's walks in a world."""
        same_walks = self.fingerprint == robot.fingerprint and math.isclose(self.duration_s, duration_s)
        return same_walks and self.world == world

    @property
    def uncertainty(self) -> SimulationUncertainty:
        """What was measured."""
        return SimulationUncertainty(
            step_m=self.step_m,
            solver_m=self.solver_m,
            contact_m=self.contact_m,
            confirmed_m=self.confirmed_m,
            walks=self.walks,
            duration_s=self.duration_s,
            low_m=self.low_m,
            high_m=self.high_m,
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

    It is known by the robot's fingerprint, the whole world and the duration; of several measurements the one
    of the most walks counts. A world that was not measured borrows the value of the flat world with its time
    step, friction cone and solver tolerance, which then is `borrowed`.

    Args:
        robot: the robot, or the name or path of its file.
        world: where, or its name or path; flat unless given.
        duration_s: how long the walks take.
        folder: of sessions and recordings, with what was measured here.

    Raises InputError for a file of measurements that is damaged.
    """
    model, place = as_robot(robot), as_world(world)
    entries = [*_entries(Path(folder) / UNCERTAINTIES), *_entries(config_root() / UNCERTAINTIES)]
    for measured_in in (place, _flat_like(place)):
        fitting = [entry for entry in entries if entry.is_for(model, measured_in, duration_s)]
        if fitting:
            found = max(fitting, key=lambda entry: entry.walks).uncertainty
            return replace(found, borrowed=measured_in != place)
    return None


def _flat_like(world: World) -> World:
    """The flat world, computed as another one is."""
    return World().model_copy(update={name: getattr(world, name) for name in COMPUTATION})


def keep_uncertainty(
    robot: Robot, world: World, found: SimulationUncertainty, *, folder: Path | str = "runs", how: str = ""
) -> Path:
    """Keep a measurement for `known_uncertainty`; path of its file.

    It takes the place of an earlier one of the same in that file, unless that one has more walks.

    Args:
        robot: the robot that walked.
        world: where.
        found: what was measured.
        folder: of sessions and recordings.
        how: how it was measured, for people.

    Raises InputError for a file that is damaged or cannot be written.
    """
    path = Path(folder) / UNCERTAINTIES
    kept = _entries(path)
    same = [entry for entry in kept if entry.is_for(robot, world, found.duration_s)]
    if any(entry.walks > found.walks for entry in same):
        return path
    entries = [entry for entry in kept if entry not in same] + [_Entry.of(robot, world, found, how)]
    content = {"measured": [entry.model_dump(mode="json", exclude_none=True) for entry in entries]}
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
