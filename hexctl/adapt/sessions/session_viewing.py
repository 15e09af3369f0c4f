"""The overview of a session from its store, and the viewer of sessions and recordings."""

import shlex
import time
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from types import MappingProxyType
from urllib.parse import quote

from hexctl.adapt.sessions.search_session import Session, trials_text
from hexctl.adapt.sessions.store import StoreError, load_session, stored_names
from hexctl.adapt.sessions.walk_records import BASELINE_INDEX, BaselineRecord, TrialRecord, WalkRecord
from hexctl.errors import HexctlError, InputError, RecordingError
from hexctl.files import OnDamage, log_damage
from hexctl.recording.rrd_reader import viewable
from hexctl.recording.sessions.session_figures import write_overview_file
from hexctl.recording.sessions.session_overview import Overview, OverviewTrial, drawable
from hexctl.recording.viewer import (
    FileServer,
    free_port,
    newest_recording,
    open_viewer,
    serve_web,
    web_origin,
    web_page,
)
from hexctl.scratch import scratch_folder

FILE_NAME = "overview.rrd"

#: Paths of the recordings of a session by trial index, or by gait for its baseline.
RecordingPaths = dict[int | str, Path]


def write_overview(
    session: Session,
    folder: Path,
    *,
    into: Path | None = None,
    base: str = "",
    recordings: RecordingPaths | None = None,
) -> Path:
    """Write `overview.rrd`, replacing an earlier one, and return its path.

    Args:
        folder: of the trials' recordings.
        into: the folder to write to; None is the session's.
        base: URL of the recordings, with a slash at its end; empty for files.
        recordings: linked ones; None for all of `recordings_of`.

    Raises InputError for a session without trials or a folder that cannot be written, RecordingError when the
    disk did not take everything, and MissingExtraError without Rerun.
    """
    path = (into or folder) / FILE_NAME
    if recordings is None:
        recordings = recordings_of(session, folder)
    addresses = {
        index: base + quote(recording.name) if base else recording.resolve().as_uri()
        for index, recording in recordings.items()
    }
    write_overview_file(path, make_overview(session, addresses))
    return path


def recordings_of(session: Session, folder: Path) -> RecordingPaths:
    """Existing recordings of a session, by trial index, or by gait for its baseline."""
    walks: dict[int | str, WalkRecord] = {walk.gait: walk for walk in session.baseline}
    walks |= {trial.index: trial for trial in session.trials}
    files = {key: walk.recording_in(folder) for key, walk in walks.items()}
    return {key: path for key, path in files.items() if path is not None and path.is_file()}


def make_overview(session: Session, addresses: Mapping[int | str, str] = MappingProxyType({})) -> Overview:
    """Overview of a session; `addresses` are the URLs of its recordings."""
    ideals_m = [trial.result.ideal_distance_m for trial in session.trials]
    return Overview(
        title=session.name,
        facts=tuple(_facts(session)),
        objective=session.spec.score_label,
        unit=session.spec.objective_unit,
        course_m=max(ideals_m, default=0.0) or 1.0,
        trials=tuple(_shown(trial, addresses.get(trial.index)) for trial in session.trials),
        baseline=tuple(_shown(walk, addresses.get(walk.gait)) for walk in session.baseline),
    )


def _facts(session: Session) -> list[str]:
    spec, best = session.spec, session.best
    asked = f"leg {spec.broken.leg} {spec.broken}, {spec.robot}, {spec.backend}"
    world = f", world {spec.world}" if spec.world is not None else ""
    lines = [
        f"{asked}{world}",
        f"{spec.optimizer}, seed {spec.seed}: {len(session.trials)} of {trials_text(spec.budget)}",
        f"score: {spec.score_label}" + ("" if spec.target_m is None else f", target {spec.target_text}"),
    ]
    if best is not None:
        lines.append(f"**best: trial {best.index}, code {best.code}, score {spec.score_text(best.score)}**")
    if session.baseline:
        walks = [
            f"{walk.gait} {spec.score_text(walk.score) if walk.valid else walk.outcome['status']}"
            for walk in session.baseline
        ]
        lines.append(f"without a search: {', '.join(walks)}")
    if spec.uncertainty_text:
        lines.append(f"the simulation knows the end of a walk to ± {spec.uncertainty_text}")
    return lines


def _shown(walk: TrialRecord | BaselineRecord, address: str | None) -> OverviewTrial:
    result, trial = walk.result, walk if isinstance(walk, TrialRecord) else None
    cause = "" if result.cause is None else f" ({result.cause})"
    return OverviewTrial(
        index=BASELINE_INDEX if trial is None else trial.index,
        code=walk.code or 0,
        gait=walk.gait if isinstance(walk, BaselineRecord) else None,
        slots=walk.slots,
        score_m=walk.score if walk.valid else None,
        deviation_m=None if result.deviation is None else result.deviation.signed,
        distance_m=result.distance_m,
        status=f"{result.status}{cause}{' (repeat)' if trial is not None and trial.confirms else ''}",
        path_m=drawable(result.path_m),
        address=address,
    )


#: A session, and the folder of its trials' recordings.
StoredSession = tuple[Session, Path]


def view_runs(names: Sequence[str], runs: Path, *, on_damage: OnDamage = log_damage) -> int:
    """Open recordings and sessions in one viewer, wait until it is closed, and return its exit code.

    A session opens as its overview with links to its trials.

    Args:
        names: paths of recordings, and names or folders of sessions; empty is the newest of either.
        runs: the folder of recordings and of the session store.
        on_damage: called for damaged lines and recordings of a session, which are not shown; by default it is
            logged.

    Raises InputError for an unknown name and for a damaged recording in `names`, RecordingError for a viewer
    that cannot start, and MissingExtraError without Rerun.
    """
    with scratch_folder() as spare:
        paths = [
            one if isinstance(one, Path) else _current_overview(*one, spare / str(number), on_damage)
            for number, one in enumerate(_find_runs(names, runs, on_damage))
        ]
        return open_viewer(paths)


def serve_runs(
    names: Sequence[str],
    runs: Path,
    *,
    on_url: Callable[[str], object],
    stop_requested: Callable[[], bool],
    on_damage: OnDamage = log_damage,
) -> None:
    """Serve recordings and sessions to browsers on this computer, until a stop is requested.

    Args:
        names, runs, on_damage: as for `view_runs`.
        on_url: called once, with the address for a browser.
        stop_requested: called ten times a second.

    Raises the errors of `view_runs`.
    """
    chosen = _find_runs(names, runs, on_damage)
    port = free_port()
    with FileServer(web_origin(port)) as files, scratch_folder() as folder:
        urls = [_serve(one, files, folder / str(number), on_damage) for number, one in enumerate(chosen)]
        with serve_web(port, urls) as server:
            on_url(web_page(port, urls))
            while not stop_requested():
                if server.poll() is not None:
                    raise RecordingError(f"the viewer's server ended with {server.returncode}")
                time.sleep(0.1)


def _serve(chosen: Path | StoredSession, files: FileServer, into: Path, on_damage: OnDamage) -> str:
    """URL of a recording, or of a session's overview with links to recordings on the same server."""
    if isinstance(chosen, Path):
        return files.add(into.name, chosen)
    session, folder = chosen
    sound = _sound_ones(recordings_of(session, folder), into, on_damage)
    for recording in sound.values():
        files.add(session.name, recording)
    base = files.base(session.name)
    overview = write_overview(session, folder, into=into, base=base, recordings=sound)
    return files.add(session.name, overview)


def _sound_ones(recordings: RecordingPaths, spare: Path, on_damage: OnDamage) -> RecordingPaths:
    """Recordings that cannot end a viewer that opens them from an overview, or copies in a folder."""
    sound: RecordingPaths = {}
    for key, path in recordings.items():
        try:
            sound[key] = viewable(path, spare)
        except InputError as error:
            on_damage(error)
    return sound


def _find_runs(names: Sequence[str], runs: Path, on_damage: OnDamage) -> list[Path | StoredSession]:
    return [_find_run(name, runs, on_damage) for name in names] if names else [_newest_run(runs, on_damage)]


def _newest_run(runs: Path, on_damage: OnDamage) -> Path | StoredSession:
    # An overview is written whenever its session is viewed: its time says nothing.
    path = newest_recording(runs, leave_out=FILE_NAME)
    name = path.parent.name
    if name in stored_names(runs):
        with suppress(StoreError):  # a damaged session has recordings all the same
            session = load_session(name, runs, on_damage=on_damage)
            if session.trials:
                return session, runs / name
    return path


def _find_run(name: str, runs: Path, on_damage: OnDamage) -> Path | StoredSession:
    path = Path(name)
    above = path.absolute().parent
    if path.name == FILE_NAME and above.parent == runs.absolute() and above.name in stored_names(runs):
        path = runs / above.name  # its overview is written again: an old one may lead to what is damaged
    if path.suffix == ".rrd" or path.is_file():
        return path
    # A folder as the shell completes it: runs/SESSION/
    session = path.name if path.parent == runs else name
    if session not in stored_names(runs):
        known = ", ".join(stored_names(runs)[-5:]) or "none yet, hexctl adapt makes one"
        raise InputError(f"view: got {name!r}; allowed: an .rrd file or a session (newest last): {known}")
    loaded, folder = load_session(session, runs, on_damage=on_damage), runs / session
    if not loaded.trials:
        raise InputError(
            f"session {session}: has no trial yet; hexctl adapt --resume {shlex.quote(session)} continues it"
        )
    return loaded, folder


def _current_overview(session: Session, folder: Path, spare: Path, on_damage: OnDamage) -> Path:
    """Rewrite the overview, which may be old or missing; in the spare folder if the other is read-only."""
    sound = _sound_ones(recordings_of(session, folder), spare, on_damage)
    try:
        return write_overview(session, folder, recordings=sound)
    except (HexctlError, OSError):
        return write_overview(session, folder, into=spare, recordings=sound)
