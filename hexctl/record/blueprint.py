"""The layout that a recording opens with."""

import math
from typing import Any

import numpy as np

from hexctl.backends.sim.terrain import Floor
from hexctl.control.plan import TrialPlan
from hexctl.palette import BACKGROUND
from hexctl.record import paths, style
from hexctl.record.rrd import load_rerun
from hexctl.robot.model import Robot

#: The eye, as seen along the line of travel, in stance radii: behind, to the right, above.
EYE = (-1.1, -2.1, 1.5)


def make_blueprint(
    robot: Robot,
    plan: TrialPlan,
    floor: Floor,
    *,
    watched: bool = False,
    servos: bool = False,
    live: bool = False,
) -> Any:
    """Blueprint of a trial's recording.

    Args:
        robot: who walks.
        plan: what it is asked to do.
        floor: what it walks on.
        watched: whether its legs are watched; the layout then has the evidence against each.
        servos: whether its servos may report temperatures and voltages; the layout then has them.
        live: whether it is shown while it walks; the time cursor then follows it, and the events are in
            front, as there is no summary yet.
    """
    import rerun.blueprint as rrb

    hidden = rrb.PlotLegend(visible=False)
    # All legs have a lane in a window of 760 points.
    scene = rrb.Vertical(scene_view(robot, plan, floor), _lanes_view(), row_shares=[5, 6])
    evidence = [_plot(paths.SUSPICION, "evidence, alarm at 1")] if watched else []
    reports = [
        _plot(path, name, plot_legend=hidden)
        for path, name in ((paths.TEMPERATURES, "servos (°C)"), (paths.VOLTAGES, "servos (V)"))
        if servos
    ]
    side = rrb.Vertical(
        rrb.Tabs(_summary_view(), _events_view(), active_tab=1 if live else 0),
        _plot(paths.DEVIATION, "deviation from the line (m), left +", plot_legend=hidden),
        _plot(paths.MARGIN, "stability margin (m), unstable below 0", plot_legend=hidden),
        rrb.Tabs(
            *evidence,
            *(_plot(paths.leg_path(leg), f"leg {leg} (rad)") for leg in paths.LEGS),
            _plot(paths.TORQUES, "torques (N m)", plot_legend=hidden),
            _plot(paths.VELOCITY, "commanded velocity"),
            *reports,
        ),
        row_shares=[10, 4, 4, 6],
    )
    return rrb.Blueprint(
        rrb.Horizontal(scene, side, column_shares=[5, 3]),
        rrb.BlueprintPanel(state="hidden"),
        rrb.SelectionPanel(state="hidden"),
        rrb.TimePanel(
            state="collapsed",
            timeline=paths.WALK_TIMELINE,
            play_state="following" if live else "playing",
            loop_mode="off" if live else "all",
        ),
        auto_views=False,
        auto_layout=False,
    )


def scene_view(robot: Robot, plan: TrialPlan, floor: Floor) -> Any:
    """3-D view: the eye follows the robot, trail and ribbon end at the time cursor."""
    import rerun.blueprint as rrb

    cos, sin = math.cos(plan.heading_rad), math.sin(plan.heading_rad)
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
    import rerun.blueprint as rrb

    start, end = rrb.TimeRangeBoundary.infinite(), rrb.TimeRangeBoundary.cursor_relative()
    return rrb.VisibleTimeRanges(
        [
            rrb.VisibleTimeRange(timeline, start=start, end=end)
            for timeline in (paths.WALK_TIMELINE, paths.TIMELINE)
        ]
    )


def _lanes_view() -> Any:
    """Lanes of the trial's phases, the guard and the gait; states whose colour is enough have no label."""
    import rerun.blueprint as rrb

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


def _summary_view() -> Any:
    import rerun.blueprint as rrb

    return rrb.TextDocumentView(origin=paths.SUMMARY, name="trial")


def _events_view() -> Any:
    import rerun.blueprint as rrb

    return rrb.TextLogView(origin=paths.EVENTS, name="events")


def _plot(origin: str, name: str, **more: Any) -> Any:
    import rerun.blueprint as rrb

    return rrb.TimeSeriesView(origin=origin, name=name, axis_x=_linked(), **more)


def _linked() -> Any:
    """Time axis that all views share: zooming into one zooms into all."""
    import rerun.blueprint as rrb

    return rrb.TimeAxis(link="LinkToGlobal")
