"""The overview of a session: what `hexctl.record.overview` draws, from what the store keeps."""

from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote

import numpy as np

from hexctl.adapt.session import MILESTONES_M, Session, TrialRecord
from hexctl.record.overview import Overview, OverviewTrial, drawable
from hexctl.record.overview_figures import write_overview_file
from hexctl.record.viewer import is_recording
from hexctl.types import FloatArray

FILE_NAME = "overview.rrd"


def write_overview(session: Session, folder: Path, *, into: Path | None = None, base: str = "") -> Path:
    """Write `overview.rrd`, in place of an earlier one, and return its path.

    Args:
        session: what is shown.
        folder: where the recordings of its trials are.
        into: the folder to write to; None is the session's.
        base: URL under which the recordings are found, with a slash at its end; without one they are files.

    Raises InputError for a session without trials or a folder that cannot be written, RecordingError when the
    disk did not take everything, and MissingExtraError without Rerun.
    """
    path = (into or folder) / FILE_NAME
    addresses = {
        index: base + quote(recording.name) if base else recording.resolve().as_uri()
        for index, recording in recordings_of(session, folder).items()
    }
    write_overview_file(path, make_overview(session, addresses))
    return path


def recordings_of(session: Session, folder: Path) -> dict[int, Path]:
    """Return the recordings in a folder that there are and that can be opened, by trial."""
    files = {trial.index: folder / Path(trial.recording).name for trial in session.trials if trial.recording}
    return {index: path for index, path in files.items() if is_recording(path)}


def make_overview(session: Session, addresses: Mapping[int, str] = MappingProxyType({})) -> Overview:
    """Return a session as its overview shows it, its trials' recordings at some addresses."""
    ideals_m = [trial.outcome["ideal_distance_m"] for trial in session.trials]
    return Overview(
        title=session.name,
        facts=tuple(_facts(session)),
        objective=session.spec.score_label,
        unit=session.spec.objective_unit,
        course_m=max(ideals_m, default=0.0) or 1.0,
        trials=tuple(_trial(trial, addresses.get(trial.index)) for trial in session.trials),
    )


def _facts(session: Session) -> list[str]:
    """Return what was asked for and what came of it."""
    spec, best = session.spec, session.best
    asked = f"leg {spec.failed_leg} {spec.failure}, {spec.robot}, {spec.backend}"
    world = f", world {spec.world}" if spec.world is not None else ""
    lines = [
        f"{asked}{world}",
        f"{spec.optimizer}, seed {spec.seed}: {len(session.trials)} of {spec.budget} trials",
        f"score: {spec.score_label}",
    ]
    if best is not None:
        lines.append(f"**best: trial {best.index}, code {best.code}, score {spec.score_text(best.score)}**")
    for milestone_m in MILESTONES_M if spec.objective_unit == "m" else ():
        reached = session.trials_to(milestone_m)
        lines.append(
            f"within {100 * milestone_m:g} cm " + (f"after {reached} trials" if reached else "not yet")
        )
    return lines


def _trial(trial: TrialRecord, address: str | None) -> OverviewTrial:
    outcome = trial.outcome
    return OverviewTrial(
        index=trial.index,
        code=trial.code,
        slots=trial.slots,
        score_m=trial.score if trial.valid else None,
        deviation_m=outcome["deviation_m"]["signed"],
        distance_m=outcome["distance_m"],
        status=outcome["status"] + (" (repeat)" if trial.confirms else ""),
        path_m=_path(trial),
        address=address,
    )


def _path(trial: TrialRecord) -> FloatArray:
    """Return the kept points and the end itself, (N, 2): the points are taken five times a second."""
    end = trial.outcome["distance_m"], trial.outcome["deviation_m"]["signed"]
    points = [*trial.path_m, *([end] if None not in end else [])]
    return drawable(np.array(points, dtype=float).reshape(-1, 2))
