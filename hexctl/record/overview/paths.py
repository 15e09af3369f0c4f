"""Where things live in an overview recording."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.record.sdk import load_rerun

#: The only timeline: the index of the trial.
TIMELINE = "trial"

ABOVE = "above"
AXES = "above/axes"
BANDS = "above/bands"
LINE = "above/line_of_travel"
START = "above/start"
LEGEND = "above/legend"
BEST = "above/best"
BEST_END = "above/best/end"

#: What is there to read the rest by, and not to be touched.
SCENERY = (AXES, BANDS, LEGEND, LINE)

CURVE = "curve"
SCORE = "curve/score"
INVALID = "curve/invalid"
BEST_SO_FAR = "curve/best_so_far"
TARGETS = "curve/targets"
TABLE = "table"


def trial_path(index: int) -> str:
    """Return the entity of a trial's trajectory."""
    return f"{ABOVE}/trials/{index:03d}"


def at(indices: Sequence[int]) -> Any:
    """Return trials as a column of the timeline."""
    return load_rerun().TimeColumn(TIMELINE, sequence=np.asarray(indices, dtype=np.int64))
