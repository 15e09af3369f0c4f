"""Distributions of randomized quantities."""

from typing import Literal

import numpy as np
from pydantic import BaseModel, ConfigDict, model_validator

from hexctl.backends.sim.flaws import Finite
from hexctl.types import FloatArray


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
