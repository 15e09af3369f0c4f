"""The layout that a recording opens with."""

import math
from typing import Any

import numpy as np

from hexctl.backends.sim.terrain import Floor
from hexctl.palette import BACKGROUND
from hexctl.recording import paths, style
from hexctl.recording.rrd import load_rerun
from hexctl.recording.series import (
    DEVIATION,
    MARGIN,
    SENSORS,
    SERVOS,
    SUSPICION,
    VECTORS,
    Series,
)
from hexctl.robot.model import Robot
from hexctl.types import JOINT_NAMES

#: The eye along the line of travel, in stance radii: behind, to the right, above.
EYE = (-1.1, -2.1, 1.5)


def make_blueprint(
    robot: Robot,
    heading_rad: float,
    floor: Floor,
    *,
    watched: bool = False,
    servos: bool = False,
    live: bool = False,
) -> Any:
    """Blueprint of a trial's recording, optionally with evidence against legs (`watched`) and `servos`.

    Args:
        live: whether it is shown during the walk: the time cursor follows, and events replace the summary.
    """
    rrb = load_rerun().blueprint
    hidden = rrb.PlotLegend(visible=False)
    summary = rrb.TextDocumentView(origin=paths.SUMMARY, name="trial")
    events = rrb.TextLogView(origin=paths.EVENTS, name="events")
    # All legs have a lane in a window of 760 points.
    scene = rrb.Vertical(scene_view(robot, heading_rad, floor), _lanes_view(), row_shares=[5, 6])
    evidence = [plot_of(SUSPICION)] if watched else []
    numbers = (*SENSORS, *(SERVOS if servos else ()))
    side = rrb.Vertical(
        rrb.Tabs(summary, events, active_tab=1 if live else 0),
        plot_of(DEVIATION, plot_legend=hidden),
        plot_of(MARGIN, plot_legend=hidden),
        rrb.Tabs(
            *evidence,
            *map(_leg_view, paths.LEGS),
            *(plot_of(one, plot_legend=hidden) for one in numbers),
        ),
        row_shares=[10, 4, 4, 6],
    )
    time = {"play_state": "following", "loop_mode": "off"} if live else {}
    return two_columns(scene, side, paths.WALK_TIMELINE, **time)


def two_columns(left: Any, right: Any, timeline: str, **time: Any) -> Any:
    """Blueprint of two columns with a timeline, played in a loop unless `time` has other options."""
    rrb = load_rerun().blueprint
    time = {"play_state": "playing", "loop_mode": "all", **time}
    return rrb.Blueprint(
        rrb.Horizontal(left, right, column_shares=[5, 3]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(state="collapsed", timeline=timeline, **time),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(robot: Robot, heading_rad: float, floor: Floor) -> Any:
    """3-D view: the eye follows the robot, trail and ribbon end at the time cursor."""
    rrb = load_rerun().blueprint
    cos, sin = math.cos(heading_rad), math.sin(heading_rad)
    back, left, up = (robot.stance_radius_m * share for share in EYE)
    position = np.array([cos * back - sin * left, sin * back + cos * left, up])
    plane = load_rerun().encodings.Plane3D(normal=floor.normal_world, distance=0.0)
    return rrb.Spatial3DView(
        origin=paths.WORLD,
        name="robot",
        background=[*BACKGROUND],
        line_grid=rrb.LineGrid3D(
            visible=floor.heights_m is None,
            spacing=0.1,
            plane=plane,
            color=style.GRID_COLOR,
            stroke_width=0.7,
        ),
        spatial_information=rrb.SpatialInformation(target_frame=f"tf#/{paths.WORLD}", show_axes=False),
        eye_controls=rrb.EyeControls3D(
            kind="orbital",
            position=position,
            look_target=[0.0, 0.0, 0.5 * robot.standing_height_m],
            eye_up=[0.0, 0.0, 1.0],
            tracking_entity=paths.FRAME,
        ),
        overrides={
            paths.TRAIL: _up_to_cursor(),
            paths.RIBBON: _up_to_cursor(),
            paths.GROUND: rrb.EntityBehavior(interactive=False),
        },
    )


def _up_to_cursor() -> Any:
    """Time range of everything up to the time cursor."""
    rrb = load_rerun().blueprint
    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(timeline, start=start, end=end)
            for timeline in (paths.WALK_TIMELINE, paths.TIMELINE)
        ]
    )


def _lanes_view() -> Any:
    """Lanes of the trial's phases, the guard and the gait; states in `WORDLESS` have no label."""
    rrb = load_rerun().blueprint
    lanes = load_rerun().StateConfiguration(
        values=list(style.LANE_COLORS),
        colors=list(style.LANE_COLORS.values()),
        labels=[style.label_of(state) for state in style.LANE_COLORS],
    )
    return rrb.StateTimelineView(
        origin="/",
        contents=[f"+ {paths.PHASE}", f"+ {paths.GUARD}", "+ gait/**", "+ failures/**"],
        name="gait: light stance, dark swing, orange no contact, red drags",
        defaults=[lanes],
        time_view=_linked(),
    )


def _leg_view(leg: int) -> Any:
    """View of the angles of a leg, which are among those of all joints."""
    rrb = load_rerun().blueprint
    shown = [name.startswith(f"leg{leg}_") for name in JOINT_NAMES]
    return plot(
        "/",
        f"leg {leg} (rad)",
        contents=[f"+ {series.path}" for series in VECTORS],
        defaults=[load_rerun().SeriesLines.from_fields(visible_series=shown)],
        plot_legend=rrb.PlotLegend(visible=False),
    )


def plot_of(series: Series, **more: Any) -> Any:
    """View of a series over the shared time axis."""
    return plot(series.path, series.title, **more)


def plot(origin: str, name: str, **more: Any) -> Any:
    """View of scalars over the shared time axis."""
    return load_rerun().blueprint.TimeSeriesView(origin=origin, name=name, axis_x=_linked(), **more)


def _linked() -> Any:
    return load_rerun().blueprint.TimeAxis(link="LinkToGlobal")
