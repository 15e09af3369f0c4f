"""A family of worlds: ranges instead of numbers, and members drawn from them evenly."""

from collections.abc import Sequence
from functools import cached_property
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from hexctl.backends.sim.world import World, load_world
from hexctl.errors import InputError
from hexctl.robot.configs import Number, find_config, read_mapping, validate
from hexctl.types import N_JOINTS, FloatArray

#: Members of one family; a prior's legs take theirs from blocks far apart.
MAX_MEMBERS = 1 << 20

#: Quantities of a world that are lists: a family spreads their parts one by one.
_PARTS = {"body_mass_shift_m": 3, "payload_position_m": 3, "joint_offset_deg": N_JOINTS}

#: Quantities that know steps only; a kind may set them.
_IN_STEPS = ("time_step_s", "servo_delay_s", "friction_cone", "sensor_noise")

Finite = Annotated[Number, Field(allow_inf_nan=False)]


class Spread(BaseModel):
    """How one quantity is spread over a family.

    Attributes:
        low: the least value; for `normal`, two standard deviations below the middle.
        high: the greatest value; for `normal`, two standard deviations above the middle.
        scale: `even` between the bounds, `log` evenly over ratios, or `normal`.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    low: Finite
    high: Finite
    scale: Literal["even", "log", "normal"] = "even"

    @model_validator(mode="after")
    def _ordered(self) -> "Spread":
        if not self.low <= self.high or (self.scale == "log" and self.low <= 0):
            raise ValueError(
                f"got {self.low:g} to {self.high:g}; allowed: low up to high, above 0 where the scale is log"
            )
        return self

    def at(self, share: FloatArray) -> FloatArray:
        """Return the values that shares 0..1 of the family lie below, any shape."""
        if self.scale == "log":
            return np.asarray(self.low * (self.high / self.low) ** share)
        if self.scale == "normal":
            from scipy.special import ndtri

            middle, sigma = (self.low + self.high) / 2, (self.high - self.low) / 4
            return np.asarray(middle + sigma * ndtri(np.clip(share, 1e-6, 1 - 1e-6)))
        return self.low + (self.high - self.low) * share


class Kind(BaseModel):
    """Worlds of a family that have something in common which no range expresses.

    Attributes:
        name: for people.
        world: what is the same in all of them, by the keys of a world file.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    name: str
    world: dict[str, Any] = {}

    @field_validator("world")
    @classmethod
    def _is_a_world(cls, values: dict[str, Any]) -> dict[str, Any]:
        World.model_validate(values)
        return values


class WorldFamily(BaseModel):
    """Worlds by number, drawn with a quasi-random design, so that few of them cover the ranges well.

    Any aligned block of 2^n members is spread evenly by itself.

    Attributes:
        seed: tells families with the same ranges apart.
        ranges: what is spread, by the keys of a world file; of a list every part is, by itself.
        kinds: the members take turns in them; one plain kind unless given.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    seed: Annotated[int, Field(ge=0, strict=True)]
    ranges: dict[str, Spread]
    kinds: tuple[Kind, ...] = (Kind(name="plain"),)

    @model_validator(mode="after")
    def _makes_worlds(self) -> "WorldFamily":
        """Refuse ranges whose corners are no worlds."""
        unknown = [key for key in self.ranges if key not in World.model_fields or key in _IN_STEPS]
        if unknown or not self.kinds:
            raise ValueError(
                f"got {', '.join(unknown) or 'no kinds'}; allowed: quantities of a world file that have no "
                "steps, and kinds"
            )
        for share in (0.0, 1.0):
            self._world(np.full(self._dimensions, share), self.kinds[0])
        return self

    def members(self, first: int, count: int) -> list[World]:
        """Return worlds first .. first + count - 1 of the family."""
        shares = self._shares(first, count)
        return [self._world(row, self.kind(first + index)) for index, row in enumerate(shares)]

    def kind(self, number: int) -> Kind:
        """Return the kind of a member."""
        return self.kinds[number % len(self.kinds)]

    def spare(self, spread: Spread, first: int, count: int) -> FloatArray:
        """Return values of one more quantity that belongs to the members but is no part of a world."""
        return spread.at(self._shares(first, count)[:, -1])

    @cached_property
    def _dimensions(self) -> int:
        """Return how many numbers make a member, the spare one included."""
        return sum(_PARTS.get(key, 1) for key in self.ranges) + 1

    def _shares(self, first: int, count: int) -> FloatArray:
        if not (count >= 1 and first >= 0 and first + count <= MAX_MEMBERS):
            raise InputError(f"world: got member {first}; allowed: 0..{MAX_MEMBERS - 1}")
        from scipy.stats.qmc import Sobol

        sequence = Sobol(self._dimensions, scramble=True, rng=np.random.default_rng(self.seed))
        if first:
            sequence.fast_forward(first)
        # One at a time keeps SciPy from warning about the balance of what is left out.
        return np.asarray(np.concatenate([sequence.random(1) for _ in range(count)]))

    def _world(self, shares: Sequence[float] | FloatArray, kind: Kind) -> World:
        values: dict[str, Any] = {}
        at = 0
        for key, spread in self.ranges.items():
            parts = _PARTS.get(key, 1)
            drawn = spread.at(np.asarray(shares[at : at + parts])).tolist()
            values[key] = drawn if parts > 1 else drawn[0]
            at += parts
        return World.model_validate(values | kind.world)


def load_family(name_or_path: str | Path) -> WorldFamily:
    """Return the family of a shipped name (`randomised`, `transfer`) or of a YAML file.

    Raises InputError in one line.
    """
    path = find_config("worlds", name_or_path)
    content = read_mapping(path)
    if "ranges" not in content:
        raise InputError(f"{path}: has no `ranges`; allowed: a family of worlds")
    return validate(WorldFamily, content, path)


def load_any_world(name_or_path: str) -> World:
    """Return a world by name or path, or a member of a family, such as `randomised:7`.

    Raises InputError in one line.
    """
    family, colon, number = name_or_path.rpartition(":")
    if not colon or Path(name_or_path).is_file():
        return load_world(name_or_path)
    if not (number.isdecimal() and len(number) <= len(str(MAX_MEMBERS))):
        raise InputError(f"world: got {name_or_path!r}; allowed: the number of a member, as in {family}:7")
    return load_family(family).members(int(number), 1)[0]
