"""What an optimizer expects of a gait before it walks."""

import math
from dataclasses import dataclass
from typing import Any

#: A normal value lies within so many standard deviations of its mean in nine cases of ten.
NINETY_PERCENT = 1.6449


@dataclass(frozen=True, slots=True, kw_only=True)
class Expectation:
    """A forecast of a trial.

    Attributes:
        signed_m: expected signed final deviation.
        sd_m: its standard deviation for the gait itself, on average over trials.
        trial_sd_m: its standard deviation for one trial.
        chance: probability that the gait is valid and within the target.
        target_m: the target.
    """

    signed_m: float
    sd_m: float
    trial_sd_m: float
    chance: float
    target_m: float

    @property
    def interval_m(self) -> tuple[float, float]:
        """Return where nine trials of ten should end."""
        reach_m = NINETY_PERCENT * self.trial_sd_m
        return self.signed_m - reach_m, self.signed_m + reach_m

    def holds(self, signed_m: float) -> bool:
        """Return whether an outcome lies in the interval."""
        low_m, high_m = self.interval_m
        return math.isfinite(signed_m) and low_m <= signed_m <= high_m

    def as_json(self) -> dict[str, Any]:
        """Return the expectation as plain JSON values."""
        low_m, high_m = self.interval_m
        return {
            "signed_m": self.signed_m,
            "low_m": low_m,
            "high_m": high_m,
            "chance": self.chance,
            "target_m": self.target_m,
        }
