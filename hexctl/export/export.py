"""One function for all exports: sources, format, output."""

import csv
import itertools
import json
import shutil
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from hexctl.adapt.sessions.session_tables import export_session
from hexctl.adapt.sessions.store import RUNS, StoreError
from hexctl.columns import READINGS, RECORDED
from hexctl.control.log import frame_columns
from hexctl.errors import InputError, MissingExtraError, argument, is_of_disk
from hexctl.export.export_options import (
    FORMATS,
    ROBOT_FORMATS,
    TRIAL_FORMATS,
    ExportOptions,
    Format,
    PictureOptions,
)
from hexctl.export.recordings import OnProgress, Trials, is_session, recordings_to_export
from hexctl.files import OnDamage, check_new, file_instead, log_damage, name_new
from hexctl.options import check_names
from hexctl.recording.recorded_trial import RecordedTrial, read_trial
from hexctl.robot.configs import config_names, config_root
from hexctl.robot.formats.mjcf import mjcf_of
from hexctl.robot.formats.urdf import urdf_of
from hexctl.robot.loader import load_robot
from hexctl.robot.model import Robot
from hexctl.scratch import scratch_folder


def trial_columns(trial: RecordedTrial) -> dict[str, Any]:
    """Columns of a trial by name, (T,) each; NaN, masked or an empty text if nothing was recorded."""
    ticks = len(trial)
    columns: dict[str, Any] = {"stamp_ns": trial.stamps_ns}
    known = [one.name for one in RECORDED if one.name in trial.sensors]
    columns |= frame_columns(
        {
            "time_s": trial.time_s,
            "walk_s": trial.walk_s,
            "phase": trial.phases,
            "commanded_rad": trial.commanded_rad,
            "measured_rad": trial.measured_rad,
            "base_position_world": trial.base_position_world,
            "base_quaternion_world": trial.base_quaternion_world,
            "leg_suspicion": trial.leg_suspicion.at_every_tick(ticks),
            **{name: trial.sensors[name].at_every_tick(ticks) for name in known},
        }
    )
    for reading in READINGS:
        if (samples := trial.servos.get(reading.name)) is not None:
            columns |= dict(zip(reading.fields, samples.at_every_tick(ticks).T, strict=True))
    for name, samples in trial.policy.items():
        fields = [f"policy_{name}_{part}" for part in trial.policy_names[name]]
        columns |= dict(zip(fields, samples.at_every_tick(ticks).T, strict=True))
    texts = [""] * ticks
    for event in trial.events:
        texts[event.row] = "; ".join(filter(None, (texts[event.row], event.text)))
    columns["events"] = np.array(texts, dtype=object)
    return columns


def write_csv(trial: RecordedTrial, path: Path) -> None:
    """Write a trial as CSV; numbers have all their digits, unknown ones are empty."""
    columns = trial_columns(trial)
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(columns)
        writer.writerows(zip(*(_texts(column) for column in columns.values()), strict=True))


def write_parquet(trial: RecordedTrial, path: Path) -> None:
    """Write a trial as Parquet; plan and outcome are metadata of the table, as JSON in `hexctl`."""
    try:
        import pyarrow as pa
        import pyarrow.parquet as pq
    except ModuleNotFoundError as error:
        raise MissingExtraError("Parquet export", "data") from error
    arrays = {name: pa.array(column, from_pandas=True) for name, column in trial_columns(trial).items()}
    table = pa.table(arrays).replace_schema_metadata({"hexctl": json.dumps(trial.properties)})
    pq.write_table(table, path, compression="zstd")


def _texts(column: Any) -> list[Any]:
    """Values of a column; `csv` leaves None empty."""
    values = column.astype(int) if column.dtype.kind == "b" else column
    return [None if value != value else value for value in values.tolist()]


#: File suffixes of formats.
SUFFIXES = {
    ".xml": "mjcf",
    **{f".{name}": name for name in FORMATS if name not in ("mjcf", "lerobot", "ros2")},
}
#: Suffixes of default output names; datasets, bags and files for ROS are folders.
ENDINGS = {"mjcf": ".xml", "mcap": "-mcap", "lerobot": "-lerobot", "ros2": "-ros2"}


def export(
    *sources: str | Path | Robot,
    to: Format | None = None,
    output: str | Path | None = None,
    folder: str | Path = RUNS,
    on_progress: OnProgress | None = None,
    on_damage: OnDamage = log_damage,
    **options: Any,
) -> Path:
    """Write a robot, a recording or a session in a format of other programs; return its path.

    Args:
        sources: a robot (name, file or `Robot`), recordings (.rrd), or the name of a session. Several
            recordings make one LeRobot dataset, and two of them race in a GIF or MP4.
        to: None takes it from the suffix of `output`.
        output: the new file or folder; None takes the name of the source.
        folder: of sessions.
        on_progress: takes the number of finished items and the total.
        on_damage: takes the error of each missing or damaged part of a session, which is skipped; logged
            by default.
        options: further fields of `ExportOptions`, such as `fps`.

    Raises InputError for a source that cannot be exported, an output that exists, or a full disk;
    MissingExtraError for a format whose library is not installed.
    """
    if not sources:
        raise InputError("export: got nothing; allowed: a robot, recordings, or a session")
    check_names(export, options, ExportOptions)
    asked = ExportOptions(to=to, output=output, **options)
    kind = _format(asked.to, asked.output)
    path = _output(sources[0], kind, asked.output)
    check_new(path, argument("output"))
    table = kind in ("csv", "parquet") and len(sources) == 1 and is_session(sources[0])
    _check_used(asked, kind, table=table)
    if kind in TRIAL_FORMATS:
        _refuse_robots(sources, kind)
    robot = asked.robot if asked.robot is None or isinstance(asked.robot, Robot) else load_robot(asked.robot)
    with _disk_errors(path):
        path.parent.mkdir(parents=True, exist_ok=True)
        if kind in ROBOT_FORMATS:
            _write_robot(sources, kind, path, ros2_control=asked.ros2_control)
        elif table:
            with _draft(path) as draft:
                export_session(str(sources[0]), kind, draft, Path(folder), on_damage=on_damage)
        else:
            trials = recordings_to_export(sources, Path(folder), robot, on_damage)
            _write_trials(trials, kind, path, asked, on_progress or (lambda *_: None), on_damage)
    return path


@contextmanager
def _disk_errors(path: Path) -> Iterator[None]:
    """Raise InputError if the output cannot be written."""
    try:
        yield
    except StoreError:  # an OSError, too: the session's, not the output's
        raise
    except OSError as error:
        reason = file_instead(path.parent) or error.strerror
        allowed = "" if is_of_disk(error) else "; allowed: a new file"
        raise InputError(f"{argument('output')}: {path} cannot be written ({reason}){allowed}") from error


def _check_used(asked: ExportOptions, kind: str, *, table: bool) -> None:
    """Raise InputError for options that the format would ignore; `table` is a table of a session's trials."""
    if kind not in ("gif", "mp4") and asked.given:
        names = ", ".join(map(argument, asked.given))
        raise InputError(f"{names}: got the format {kind}; allowed: gif, mp4")
    if asked.ros2_control and kind != "urdf":
        raise InputError(f"{argument('ros2_control')}: got the format {kind}; allowed: urdf")
    if asked.robot is not None and (kind in ROBOT_FORMATS or table):
        raise InputError(f"{argument('robot')}: got no recording for {kind}; allowed: with a recording")


def _refuse_robots(sources: Sequence[str | Path | Robot], kind: str) -> None:
    for source in sources:
        name = source.name if isinstance(source, Robot) else str(source)
        if isinstance(source, Robot) or name in config_names("robots") or name.endswith((".yaml", ".yml")):
            allowed = f"{', '.join(ROBOT_FORMATS)}, or a recording"
            raise InputError(f"export: got the robot {name} for {kind}; allowed: {allowed}")


def _format(to: str | None, output: str | Path | None) -> str:
    by_name = None if output is None else SUFFIXES.get(Path(output).suffix)
    if to is None and by_name is None:
        recorded = ", ".join(name for name in FORMATS if name not in ROBOT_FORMATS)
        allowed = f"{recorded} for recordings, {', '.join(ROBOT_FORMATS)} for robots"
        suffix = "" if output is None else Path(output).suffix
        got = f"{argument('output')}: got {output}" if suffix else f"{argument('to')}: got none"
        raise InputError(f"{got}; allowed: {allowed}, or {argument('output')} FILE.FORMAT")
    if to is not None and by_name not in (None, to):
        got = f"{argument('output')}: got {output} for {to}"
        raise InputError(f"{got}; allowed: another ending, such as {_ending(to)}")
    return to or str(by_name)


def _ending(kind: str) -> str:
    return ENDINGS.get(kind, f".{kind}")


def _output(source: str | Path | Robot, kind: str, output: str | Path | None) -> Path:
    if output is not None:
        return Path(output)
    ending = _ending(kind)
    if isinstance(source, Robot):
        return Path(f"{source.name}{ending}")
    path = Path(source)
    stem = path.with_suffix("") if path.suffix == ".rrd" else Path(path.stem)
    return stem.with_name(f"{stem.name}{ending}")


def _write_robot(sources: Sequence[str | Path | Robot], kind: str, path: Path, *, ros2_control: bool) -> None:
    (source, *more) = sources
    if more:
        raise InputError(f"export: got {len(sources)} robots; allowed: one")
    if not isinstance(source, Robot) and Path(source).suffix == ".rrd":
        robot = read_trial(source).robot
    else:
        robot = source if isinstance(source, Robot) else load_robot(source)
    if kind == "ros2":
        with _draft(path) as draft:
            write_ros2(robot, draft, _source_of(source, robot))
        return
    text = urdf_of(robot, ros2_control=ros2_control) if kind == "urdf" else mjcf_of(robot)
    with _draft(path) as draft:
        draft.write_text(text, encoding="utf-8")


def _source_of(source: str | Path | Robot, robot: Robot) -> str:
    """Value of --robot for a robot: the absolute path of its file, else its name."""
    own = not isinstance(source, Robot) and Path(source).suffix in (".yaml", ".yml")
    return str(Path(str(source)).resolve()) if own else robot.name


def write_ros2(robot: Robot, folder: Path, source: str) -> None:
    """Write a launch file, layouts of RViz and Foxglove, and the URDF of a robot into a new folder.

    The launch file starts the robot of `source`, a name or a file, by default.
    """
    root = config_root() / "ros"
    for file in root.rglob("*"):  # copytree would hide why a file cannot be written
        if file.is_file() and file.parent.name != "__pycache__":
            target = folder / file.relative_to(root)
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(file, target)
    launch = folder / "robot.launch.py"
    text = launch.read_text(encoding="utf-8").replace('"robot": ("ant",', f'"robot": ({json.dumps(source)},')
    launch.write_text(text, encoding="utf-8")
    (folder / f"{robot.name}.urdf").write_text(urdf_of(robot), encoding="utf-8")


def _write_trials(
    trials: Trials,
    kind: str,
    path: Path,
    picture: PictureOptions,
    on_progress: OnProgress,
    on_damage: OnDamage,
) -> None:
    if kind not in ("lerobot", "gif", "mp4") and len(trials) > 1 and path.suffix:
        given = f"{argument('output')}: got {path} for {len(trials)} recordings"
        raise InputError(f"{given}; allowed: the name of a folder")
    with _draft(path) as draft:
        if kind == "lerobot":
            from hexctl.export.lerobot import write_lerobot

            write_lerobot(trials, draft, on_progress, on_damage)
        elif kind in ("gif", "mp4"):
            from hexctl.export.pictures import write_pictures

            write_pictures(trials, draft, kind, picture, on_progress)
        elif len(trials) == 1:
            _writer(kind)(next(iter(trials)), draft)
        else:
            _write_each(trials, kind, draft, on_progress)


def _write_each(trials: Trials, kind: str, folder: Path, on_progress: OnProgress) -> None:
    folder.mkdir()
    write, ending = _writer(kind), "" if kind == "mcap" else f".{kind}"
    for done, trial in enumerate(trials, start=1):
        write(trial, _unused(folder, trial.path.stem, ending))
        on_progress(done, len(trials))


def _unused(folder: Path, name: str, ending: str) -> Path:
    """Path in a folder; recordings of one name, such as those of two sessions, get numbers."""
    names = itertools.chain([name], (f"{name}-{number}" for number in itertools.count(2)))
    return next(path for one in names if not (path := folder / f"{one}{ending}").exists())


def _writer(kind: str) -> Callable[[RecordedTrial, Path], None]:
    from hexctl.export.mcap import write_mcap

    return {"mcap": write_mcap, "csv": write_csv, "parquet": write_parquet}[kind]


@contextmanager
def _draft(path: Path) -> Iterator[Path]:
    """Path in a hidden sibling folder, from where the complete output is moved."""
    with scratch_folder(path.parent, path.stem) as folder:
        draft = folder / path.name
        yield draft
        name_new(draft, path, argument("output"))
