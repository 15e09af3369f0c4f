"""Open recordings together: a common scene of all walks, and a copy of each recording."""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from urllib.parse import quote

import numpy as np

from hexctl.backends.sim.terrain import Floor
from hexctl.palette import BACKGROUND, LEG_COLORS, TEXT_COLOR
from hexctl.recording import paths, style
from hexctl.recording.blueprint import make_blueprint, plot, two_columns, up_to_cursor
from hexctl.recording.recorded_trial import RecordedTrial, read_trial
from hexctl.recording.recording import APPLICATION_ID
from hexctl.recording.rrd import load_rerun, new_recording
from hexctl.recording.rrd_reader import rerun_chunks
from hexctl.recording.series import DEVIATION
from hexctl.robot.failure import loses_leg

#: Differs from that of trials: a viewer keeps one layout per application.
SIDE_BY_SIDE_ID = "hexctl side by side"

#: Distance between walks, in stance radii of the largest robot.
LANE_SHARE = 2.8

#: Position of the eye as a share of the scene's length: to the right, and above.
EYE = (0.62, 0.42)

#: Entities of each recording in the common scene, besides its result.
SHOWN = (paths.WORLD, DEVIATION.path)


@dataclass(frozen=True, slots=True, kw_only=True)
class _Lane:
    """A walk of the scene; `root` is its entity, `left_m` its lateral offset, negative to the right."""

    root: str
    trial: RecordedTrial
    name: str
    address: str
    left_m: float
    color: tuple[int, int, int]


def write_together(recordings: Sequence[Path], folder: Path, base: str = "") -> list[Path]:
    """Write a recording with all walks in one scene, and a linked copy of each walk.

    All begin at the same moment of `walk_time`, on the floor of the first one. A single walk gets a copy.

    Args:
        folder: of the new files; the common scene is the first one returned.
        base: URL of the folder with a trailing slash; without one, links lead to files.

    Raises what `read_trial` raises, and RecordingError when the disk did not take everything.
    """
    folder.mkdir(parents=True, exist_ok=True)
    trials = [read_trial(recording) for recording in recordings]
    names = names_of(trials)
    copies = [folder / f"{number}-{recording.name}" for number, recording in enumerate(recordings, start=1)]
    for trial, name, copy in zip(trials, names, copies, strict=True):
        _copy(trial, name, copy)
    if len(copies) == 1:
        return copies
    addresses = [base + quote(copy.name) if base else copy.resolve().as_uri() for copy in copies]
    scene = folder / "side-by-side.rrd"
    _write_scene(scene, _lanes(trials, names, addresses))
    return [scene, *copies]


def names_of(trials: Sequence[RecordedTrial]) -> list[str]:
    """Distinct names of walks, such as `recovered: ant tripod, transfer:500`; numbered if equal."""
    names = [_name(trial) for trial in trials]
    return [
        name if names.count(name) == 1 else f"{name} ({number})" for number, name in enumerate(names, start=1)
    ]


def _name(trial: RecordedTrial) -> str:
    """The recovery comes first: lists of recordings cut long names."""
    told = trial.properties
    parts = [str(part) for part in (told.get("title", trial.path.stem), told.get("world")) if part]
    reactions = {one["did"] for one in trial.noticed if loses_leg(one["kind"])}
    if not reactions:
        return ", ".join(parts)
    return f"{'no recovery' if reactions == {'walked on'} else 'recovered'}: {', '.join(parts)}"


def _copy(trial: RecordedTrial, name: str, path: Path) -> None:
    heading_rad = math.radians(float(trial.properties.get("heading_deg", 0.0)))
    flags = {"watched": trial.leg_suspicion.rows.size > 0, "servos": bool(trial.servos)}
    blueprint = make_blueprint(trial.robot, heading_rad, _floor(trial), several=True, **flags)
    with new_recording(path, APPLICATION_ID, name, blueprint) as stream:
        stream.send_chunks(rerun_chunks(trial.path))
        stream.send_recording_name(name)  # after that of the walk


def _floor(trial: RecordedTrial) -> Floor:
    return Floor(trial.floor_quaternion, trial.floor_normal_world, None)


def _lanes(trials: Sequence[RecordedTrial], names: Sequence[str], addresses: Sequence[str]) -> list[_Lane]:
    width_m = LANE_SHARE * max(trial.robot.stance_radius_m for trial in trials)
    return [
        _Lane(
            root=f"lane{number + 1}",
            trial=trial,
            name=name,
            address=address,
            left_m=-number * width_m,
            color=LEG_COLORS[number % len(LEG_COLORS)],
        )
        for number, (trial, name, address) in enumerate(zip(trials, names, addresses, strict=True))
    ]


def _write_scene(path: Path, lanes: Sequence[_Lane]) -> None:
    with new_recording(path, SIDE_BY_SIDE_ID, "side by side", _layout(lanes)) as stream:
        stream.log("/", load_rerun().ViewCoordinates.RIGHT_HAND_Z_UP, static=True)
        for lane in lanes:
            stream.send_chunks(list(_walk_chunks(lane, with_floor=lane is lanes[0])))
            _send_looks(stream, lane)


def _walk_chunks(lane: _Lane, *, with_floor: bool) -> Iterator[Any]:
    for chunk in rerun_chunks(lane.trial.path):
        entity = chunk.entity_path.lstrip("/")
        floor = entity == paths.GROUND and not with_floor
        # Labels of legs would cover one another, and the names of the walks.
        if entity.startswith(SHOWN) and not floor and not entity.endswith("/label"):
            yield chunk.with_entity_path(f"/{lane.root}/{entity}")


def _send_looks(stream: Any, lane: _Lane) -> None:
    rr, robot = load_rerun(), lane.trial.robot
    stream.log(lane.root, rr.Transform3D(translation=[0.0, lane.left_m, 0.0]), static=True)
    above = [[0.0, 0.0, 1.2 * robot.standing_height_m]]
    label = rr.Points3D(above, radii=[0.0], colors=[TEXT_COLOR], labels=[lane.name], show_labels=True)
    stream.log(f"{lane.root}/{paths.BODY}/name", label, static=True)
    line = rr.SeriesLines(colors=[lane.color], names=[lane.name], widths=[2.0])
    stream.log(f"{lane.root}/{DEVIATION.path}", line, static=True)
    stream.log(f"{lane.root}/{paths.SUMMARY}", _summary(lane), static=True)


def _summary(lane: _Lane) -> Any:
    told = lane.trial.properties
    rows = [("result", told.get("status", "cut off"))]
    if "distance_m" in told:
        rows.append(("distance", f"{told['distance_m']:.2f} m"))
    if "deviation_final_m" in told:
        rows.append(("deviation", f"{100 * told['deviation_final_m']:.1f} cm at the end"))
    rows += [
        ("noticed", f"{one['at_s']:.1f} s: leg {one['leg']} {one['kind']}, {one['did']}")
        for one in lane.trial.noticed
    ]
    lines = [f"| {name} | {text} |" for name, text in rows]
    link = f"[▶ open this walk]({lane.address}); ← at the top comes back"
    text = "\n".join([link, "", "| | |", "|---|---|", *lines]) + "\n"
    return load_rerun().TextDocument(text, media_type="text/markdown")


def _layout(lanes: Sequence[_Lane]) -> Any:
    rrb = load_rerun().blueprint
    deviations = [f"+ {lane.root}/{DEVIATION.path}" for lane in lanes]
    results = [rrb.TextDocumentView(origin=f"{lane.root}/{paths.SUMMARY}", name=lane.name) for lane in lanes]
    side = rrb.Vertical(
        *results,
        plot(
            "/",
            DEVIATION.title,
            contents=deviations,
            plot_legend=rrb.PlotLegend(corner=rrb.Corner2D.LeftTop),
        ),
        row_shares=[*(3 for _ in results), 4],
    )
    return two_columns(_scene_view(lanes), side, paths.WALK_TIMELINE, several=True)


def _scene_view(lanes: Sequence[_Lane]) -> Any:
    rrb = load_rerun().blueprint
    ends_m = np.concatenate([_ends_m(lane) for lane in lanes])
    low_m, high_m = ends_m.min(axis=0), ends_m.max(axis=0)
    middle_m, length_m = (low_m + high_m) / 2, float(np.linalg.norm(high_m - low_m)) + 0.5
    trails = [f"{lane.root}/{path}" for lane in lanes for path in (paths.TRAIL, paths.RIBBON)]
    return rrb.Spatial3DView(
        origin="/",
        contents=[f"+ {lane.root}/{paths.WORLD}/**" for lane in lanes],
        name="walks side by side",
        background=[*BACKGROUND],
        line_grid=rrb.LineGrid3D(visible=True, spacing=0.5, color=style.GRID_COLOR, stroke_width=0.7),
        spatial_information=rrb.SpatialInformation(target_frame="tf#/", show_axes=False),
        eye_controls=rrb.EyeControls3D(
            kind="orbital",
            position=middle_m + length_m * np.array([0.0, -EYE[0], EYE[1]]),
            look_target=middle_m,
            eye_up=[0.0, 0.0, 1.0],
        ),
        overrides={trail: up_to_cursor() for trail in trails},
    )


def _ends_m(lane: _Lane) -> Any:
    """Start and end of a walk in the common scene, (2, 3); only its start if its place is unknown."""
    known = np.flatnonzero(lane.trial.posed)
    ends = lane.trial.base_position_world[known[[0, -1]]] if known.size else np.zeros((1, 3))
    return ends * [1.0, 1.0, 0.0] + [0.0, lane.left_m, 0.0]
