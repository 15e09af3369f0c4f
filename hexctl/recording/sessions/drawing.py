"""Draw into a session's overview, static or from a trial on."""

from collections.abc import Sequence
from typing import Any

import numpy as np

from hexctl.palette import TEXT_COLOR
from hexctl.recording.rrd import load_rerun

#: The timeline of an overview: the number of trials.
TIMELINE = "trial"

#: Line widths and sizes of marks in points of the screen, which Rerun marks by a negative sign.
THIN = -0.5


def trial_column(indices: Sequence[int]) -> Any:
    """Trials as a column of the timeline."""
    return load_rerun().TimeColumn(TIMELINE, sequence=np.asarray(indices, dtype=np.int64))


def draw(stream: Any, path: str, thing: Any, trial: int | None = None) -> None:
    """Send an archetype of Rerun, to be shown from a trial on; `trial` None draws it at all times."""
    if trial is None:
        stream.log(path, thing, static=True)
        return
    batches = thing.as_component_batches()
    columns = [batch.partition([len(batch.as_arrow_array())]) for batch in batches]
    stream.send_columns(path, [trial_column([trial])], columns)


def draw_names(stream: Any, path: str, names: Sequence[tuple[Any, str]], trial: int | None = None) -> None:
    """Send texts with their positions in the picture."""
    places = np.array([place for place, _ in names]).reshape(-1, 2)
    texts = [text for _, text in names]
    look = {"radii": [0.0], "colors": [TEXT_COLOR], "labels": texts, "show_labels": True}
    draw(stream, path, load_rerun().Points2D(places, **look), trial)
