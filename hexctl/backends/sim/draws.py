"""Random quantities and failures in families of worlds."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal, TypeVar

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, field_validator, model_validator

from hexctl.backends.clock import PERIOD_S
from hexctl.backends.sim.flaws import Finite
from hexctl.errors import InputError
from hexctl.robot.configs import Number
from hexctl.robot.failure import FailureEvent
from hexctl.robot.failure_grammar import parse_coming_kind, parse_failure_event
from hexctl.types import JOINT_KINDS, N_LEGS, FloatArray

#: Numbers that the draw of one failure takes: whether it comes, when, which leg, how, torque, healing.
COLUMNS = 6

ValueT = TypeVar("ValueT")

Leg = Annotated[int, Field(ge=1, le=N_LEGS, strict=True)]


class Distribution(BaseModel):
    """Distribution of one randomized quantity between `low` and `high`.

    `scale` is `even` (uniform), `log` (uniform over ratios), or `normal`, with the bounds at two standard
    deviations.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    low: Finite
    high: Finite
    scale: Literal["even", "log", "normal"] = "even"

    @model_validator(mode="after")
    def _ordered(self) -> "Distribution":
        if not self.low <= self.high or (self.scale == "log" and self.low <= 0):
            raise ValueError(
                f"got {self.low:g} to {self.high:g}; allowed: low up to high, above 0 if the scale is log"
            )
        return self

    def at(self, share: FloatArray) -> FloatArray:
        """Inverse of the cumulative distribution function at shares 0..1, any shape."""
        if self.scale == "log":
            return np.asarray(self.low * (self.high / self.low) ** share)
        if self.scale == "normal":
            from scipy.special import ndtri

            middle, sigma = (self.low + self.high) / 2, (self.high - self.low) / 4
            return np.asarray(middle + sigma * ndtri(np.clip(share, 1e-6, 1 - 1e-6)))
        return self.low + (self.high - self.low) * share


class DrawnFailure(BaseModel):
    """A failure during a walk, drawn for each member of a family.

    A sticking joint sticks at its current angle, which thus depends on the time.

    Attributes:
        at_s: in seconds since the walk began.
        legs: of which one fails, with equal probabilities.
        failure: words of `parse_kind`, with equal probabilities; a repeated word is more likely.
        torque_share: part of its torque that a `weak` leg or joint keeps if its word has no number.
        heals_after_s: time from failure to healing, a control period or more; None for no healing.
        share: share of the members with this failure.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    at_s: Distribution
    legs: Annotated[tuple[Leg, ...], Field(min_length=1)] = tuple(range(1, N_LEGS + 1))
    failure: Annotated[tuple[str, ...], Field(min_length=1)] = ("locked", "limp", "missing")
    torque_share: Distribution = Distribution(low=0.05, high=0.6)
    heals_after_s: Distribution | None = None
    share: Annotated[Number, Field(gt=0, le=1, allow_inf_nan=False)] = 1.0

    @field_validator("legs")
    @classmethod
    def _different(cls, legs: tuple[int, ...]) -> tuple[int, ...]:
        if len(set(legs)) < len(legs):
            raise ValueError(f"got {', '.join(map(str, legs))}; allowed: each leg once")
        return legs

    @field_validator("failure")
    @classmethod
    def _can_come(cls, words: tuple[str, ...]) -> tuple[str, ...]:
        for word in words:
            try:
                parse_coming_kind(1, word)
            except InputError as error:
                _, _, allowed = str(error).partition("; allowed: ")
                raise ValueError(f"got {word}; allowed: {allowed}") from error
        return words

    @model_validator(mode="after")
    def _within(self) -> "DrawnFailure":
        bounds = {
            "at_s": (self.at_s, 0.0, np.inf, "0 s or more"),
            "torque_share": (self.torque_share, 0.0, 1.0, "0 to 1"),
            "heals_after_s": (
                self.heals_after_s,
                PERIOD_S,
                np.inf,
                f"{PERIOD_S:g} s, a control period, or more",
            ),
        }
        for name, (distribution, least, most, allowed) in bounds.items():
            if distribution is None:
                continue
            low, high = distribution.at(np.array([0.0, 1.0])).tolist()
            if not least <= low <= high <= most:
                raise ValueError(f"{name}: got {low:g} to {high:g}; allowed: {allowed}")
        return self

    def drawn(self, shares: FloatArray, whole: Sequence[int]) -> tuple[FailureEvent, ...]:
        """Failure and healing, if any, of one member by shares 0..1, (COLUMNS,); `whole` are intact legs."""
        comes, at, leg_at, how, torque, healing = shares.tolist()
        if comes >= self.share and self.share < 1:
            return ()
        leg = _one_of([each for each in self.legs if each in whole], leg_at)
        word = _one_of(self.failure, how)
        if word.startswith("weak") and word.rpartition(":")[2] in ("weak", *JOINT_KINDS):
            word += f":{float(self.torque_share.at(np.asarray(torque))):.3f}"
        at_s = float(self.at_s.at(np.asarray(at)))
        fails = parse_failure_event(f"{leg}:{word}@{at_s:.2f}")
        if self.heals_after_s is None:
            return (fails,)
        healed_s = at_s + float(self.heals_after_s.at(np.asarray(healing)))
        # Rounding brings the two times no nearer to each other than a control period.
        return fails, FailureEvent(at_s=round(max(healed_s, fails.at_s + PERIOD_S), 2), leg=leg)


def draw_failures(draws: Sequence[DrawnFailure], shares: FloatArray) -> dict[str, Any]:
    """The keys `failures` and `healings` of one member's world, if there are any.

    Args:
        shares: shares 0..1 of the distributions, (COLUMNS * draws or more,).
    """
    whole = list(range(1, N_LEGS + 1))
    events: list[FailureEvent] = []
    for index, draw in enumerate(draws):
        drawn = draw.drawn(shares[COLUMNS * index : COLUMNS * (index + 1)], whole)
        events += drawn
        whole = [leg for leg in whole if leg not in {event.leg for event in drawn}]
    found = {
        "failures": tuple(str(event) for event in events if event.failure is not None),
        "healings": tuple(str(event) for event in events if event.failure is None),
    }
    return {name: texts for name, texts in found.items() if texts}


def _one_of(values: Sequence[ValueT], share: float) -> ValueT:
    return values[min(int(share * len(values)), len(values) - 1)]
