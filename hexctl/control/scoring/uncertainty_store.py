"""Measured uncertainties of the simulation, shipped or kept in files, by robot, world and duration."""

import math
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

#: File of measured values, in the folder of sessions and in `configs`.
UNCERTAINTIES = "uncertainty.yaml"

#: Two ends differ with a confidence of 95 % if they are this many standard uncertainties apart: 1.96 times
#: the square root of 2, for two normally distributed ends.
DISTINCT = 2.8

#: Time step of trimmed walks, and of walks that confirm the end of a gait, in s.
CONFIRM_STEP_S = 0.0005

#: Fields of a world that belong to the computation: no measurement is lent across different values.
COMPUTATION = ("time_step_s", "friction_cone", "solver_tolerance")

#: Failure of the legs in the measured walks.
MEASURED_FAILURE = "locked"


_Metres = Annotated[Number, Field(ge=0, allow_inf_nan=False)]
_Seconds = Annotated[Number, Field(gt=0, allow_inf_nan=False)]


class SimulationUncertainty(BaseModel):
    """Root mean square change of the ends of walks across their line, in m.

    Attributes:
        step_m: with the time step halved.
        solver_m: with the solver's tolerance at MuJoCo's default, not in `numerical_m`.
        contact_m: with contacts a third softer and harder, not in `numerical_m`.
        confirmed_m: with half the time step `CONFIRM_STEP_S`, from walks at that step; None if unknown.
        borrowed: True if it was measured on the flat world for another one.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    step_m: _Metres
    solver_m: _Metres
    contact_m: _Metres
    confirmed_m: _Metres | None = None
    walks: Annotated[int, Field(ge=1)]
    duration_s: _Seconds
    borrowed: Annotated[bool, Field(exclude=True)] = False

    @property
    def numerical_m(self) -> float:
        """Standard uncertainty of the end of a walk: its change by half the time step, E(h) - E(h/2).

        For an integrator of first order the distance to the limit of small steps is twice that.
        """
        return self.step_m

    def caveat(self, failure: str) -> str:
        """How the measured walks differ from those with a failure, in words, or empty."""
        legs = [] if failure == MEASURED_FAILURE else [f"with {MEASURED_FAILURE} legs"]
        place = ["on the flat world"] if self.borrowed else []
        return f"measured {' '.join(legs + place)}" if legs or place else ""

    def to_dict(self) -> dict[str, Any]:
        """JSON values, lengths rounded to 0.1 mm."""
        return {
            name: round(value, 4) if name.endswith("_m") and value is not None else value
            for name, value in (dict(self) | {"numerical_m": self.numerical_m}).items()
        }


class _Entry(SimulationUncertainty):
    robot: str
    fingerprint: str
    world: World
    how: str = ""

    def is_for(self, robot: Robot, world: World, duration_s: float) -> bool:
        same_walks = self.fingerprint == robot.fingerprint and math.isclose(self.duration_s, duration_s)
        return same_walks and self.world == world

    @property
    def confirming(self) -> "_Entry":
        """The measurement at the time step of walks that confirm."""
        world = self.world.model_copy(update={"time_step_s": CONFIRM_STEP_S})
        return self.model_copy(update={"world": world, "step_m": self.confirmed_m, "confirmed_m": None})


class _Entries(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)

    measured: list[_Entry] = []


def known_uncertainty(
    robot: Robot | str | Path,
    world: World | str | Path | None = None,
    *,
    duration_s: float = 30.0,
    folder: Path | str = "runs",
) -> SimulationUncertainty | None:
    """Uncertainty of a robot's walks as measured before, or None; world None is flat.

    The measurement with the most walks counts. At the time step `CONFIRM_STEP_S` it is the one of walks that
    confirm. Another world borrows (`borrowed`) the value of the flat world
    with its time step, friction cone and solver tolerance. Raises InputError for a damaged file.
    """
    model, place = as_robot(robot), as_world(world)
    measured = [*_entries(Path(folder) / UNCERTAINTIES), *_entries(config_root() / UNCERTAINTIES)]
    entries = [*measured, *(entry.confirming for entry in measured if entry.confirmed_m is not None)]
    flat = World().model_copy(update={name: getattr(place, name) for name in COMPUTATION})
    for measured_in in (place, flat):
        fitting = [entry for entry in entries if entry.is_for(model, measured_in, duration_s)]
        if fitting:
            uncertainty = max(fitting, key=lambda entry: entry.walks)
            values = {name: getattr(uncertainty, name) for name in SimulationUncertainty.model_fields}
            return SimulationUncertainty(**values | {"borrowed": measured_in != place})
    return None


def keep_uncertainty(
    robot: Robot,
    world: World,
    uncertainty: SimulationUncertainty,
    *,
    folder: Path | str = "runs",
    how: str = "",
) -> Path:
    """Keep a measurement in the folder of sessions, unless it has a better one; raises InputError."""
    path = Path(folder) / UNCERTAINTIES
    kept = _entries(path)
    same = [entry for entry in kept if entry.is_for(robot, world, uncertainty.duration_s)]
    if any(entry.walks > uncertainty.walks for entry in same):
        return path
    values = {name: value for name, value in uncertainty.to_dict().items() if name in _Entry.model_fields}
    new = _Entry(robot=robot.name, fingerprint=robot.fingerprint, world=world, how=how, **values)
    entries = [entry for entry in kept if entry not in same] + [new]
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
    return validate(_Entries, read_mapping(path), path).measured if path.is_file() else []
